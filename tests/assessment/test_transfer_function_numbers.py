"""Numbers of fitted transfer functions against closed forms and refits of noisy data."""

import numpy as np
import pytest

import greybox as gb
from greybox.assessment.transfer_function_numbers import transfer_function_numbers

TRUTH = {"K": 3.0, "omega": 5.0, "zeta": 0.4, "T": 0.5, "tau": 0.03}


class Mode(gb.TransferFunction):
    """An oscillation behind an integrator, with a zero and a delay."""

    K = gb.Parameter(2.0, bounds=(0.1, 10))
    omega = gb.Parameter(4.0, bounds=(1, 20))
    zeta = gb.Parameter(0.3, bounds=(0.01, 0.99))
    T = gb.Parameter(0.3, bounds=(0.01, 2))
    tau = gb.Parameter(0.02, bounds=(0, 0.2))

    def response(self, s, p):
        mode = s**2 + 2 * p.zeta * p.omega * s + p.omega**2
        return p.K * p.omega**2 * (p.T * s + 1) / (s * mode) * gb.exp(-p.tau * s)


def fitted(seed=0, model=None, **options):
    omega = np.geomspace(0.5, 30, 40)
    exact = gb.frequency_response(Mode(), TRUTH, omega).response
    random = np.random.default_rng(seed)
    errors = 0.02 * (random.normal(size=40) + 1j * random.normal(size=40))
    data = gb.FrequencyResponse(
        omega, exact * (1 + errors), "u", "y", variance=2 * 0.02**2 * np.abs(exact) ** 2
    )
    problem = gb.Problem(model or Mode(), data, gb.MaximumLikelihood(), **options)
    return gb.fit(problem, starts=4, profiles=False, progress=False)


@pytest.fixture(scope="module")
def fit():
    return fitted()


def test_gain_poles_zeros_and_delay_are_those_of_the_parameters(fit):
    numbers = {row.name: row for row in transfer_function_numbers(fit).numbers}
    # Each is a parameter, whose error the fit has; the zero is at -1/T.
    for name, parameter in (
        ("gain", "K"),
        ("poles, natural frequency", "omega"),
        ("poles, damping ratio", "zeta"),
        ("delay", "tau"),
    ):
        assert numbers[name].value == pytest.approx(fit.estimate[parameter], rel=1e-6)
        assert numbers[name].standard_error == pytest.approx(
            fit.standard_error[parameter], rel=1e-3
        )
    zero, T = numbers["zero"], fit.estimate["T"]
    assert zero.value == pytest.approx(-1 / T, rel=1e-6)
    assert zero.standard_error == pytest.approx(fit.standard_error["T"] / T**2, rel=1e-3)
    assert (numbers["pole"].value, numbers["pole"].standard_error) == (0, 0)


def test_the_numbers_of_polynomial_coefficients_are_the_same(fit):
    """Another parametrization of the same response has the same poles with the same errors."""
    from greybox.models.polynomial import Polynomial

    model = Polynomial(3, 1, integrator=1, delay=0.2, output="y")
    other = transfer_function_numbers(fitted(model=model))
    expected = {row.name: row for row in transfer_function_numbers(fit).numbers}
    for row in other.numbers:
        assert row.value == pytest.approx(expected[row.name].value, rel=1e-3, abs=1e-9)
        assert row.standard_error == pytest.approx(expected[row.name].standard_error, rel=0.03)
    # Its bounds are computed, and say nothing.
    text = str(fitted(model=model))
    assert "[-" not in text
    assert "[0.1, 10]" in str(fit)


def test_numbers_that_do_not_vary_have_no_error(fit):
    held = fitted(fixed={"tau": 0.03, "T": 0.5})
    numbers = {row.name: row for row in transfer_function_numbers(held).numbers}
    assert numbers["zero"].value == pytest.approx(-2)
    assert (numbers["zero"].standard_error, numbers["delay"].standard_error) == (0, 0)
    assert "± error" in str(transfer_function_numbers(held))


class Loop(gb.TransferFunction):
    """A loop around a delay, which has no rational form."""

    K = gb.Parameter(1.0, bounds=(0.1, 10))

    def response(self, s, p):
        loop = p.K / s * gb.exp(-0.05 * s)
        return loop / (1 + loop)


def test_a_formula_without_a_rational_form_has_no_numbers():
    omega = np.geomspace(0.5, 10, 20)
    data = gb.FrequencyResponse(
        omega, Loop().response(1j * omega, type("P", (), {"K": 2.0})), "u", "y"
    )
    fit = gb.fit(gb.Problem(Loop(), data), starts=2, profiles=False, progress=False)
    assert transfer_function_numbers(fit) is None
