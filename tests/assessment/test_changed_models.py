"""A saved fit, and a model class whose formulas are no longer those of the fit."""

import numpy as np
import pytest

import greybox as gb
from greybox.modeling.model_reference import reference, resolve


def declared(derivative, delays=None):
    """A class `Pendulum` with this equation of its rate."""

    class Pendulum(gb.StateSpace):
        states, inputs, outputs = ("angle", "rate"), ("u",), ("angle",)
        k = gb.Parameter(4.0, bounds=(0.1, 100))
        c = gb.Parameter(0.4, bounds=(0, 10))
        tau = gb.Parameter(0.0, bounds=(0, 1), fixed=True)

        def derivative(self, x, u, p):
            return x.rate, derivative(x, u, p)

        def output(self, x, u, p):
            return (x.angle,)

    return type("Pendulum", (Pendulum,), {"delays": delays or {}})


def fitted_equation(x, u, p):
    return u.u - p.k * gb.sin(x.angle) - p.c * x.rate


def rewritten(x, u, p):
    """The same in other words."""
    damping = p.c * x.rate
    return -(damping + p.k * gb.sin(x.angle)) + u.u * 1.0


CHANGED = {
    "sign": lambda x, u, p: u.u - p.k * gb.sin(x.angle) + p.c * x.rate,
    "constant": lambda x, u, p: 1.01 * u.u - p.k * gb.sin(x.angle) - p.c * x.rate,
    "form": lambda x, u, p: u.u - p.k * x.angle - p.c * x.rate,
    "branch": lambda x, u, p: fitted_equation(x, u, p) - 0.1 * gb.maximum(x.rate, 0.0),
}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    omega = np.geomspace(0.5, 10, 20)
    response = 1 / (4 - omega**2 + 0.4j * omega) * (1 + 0.01 * np.exp(1j * 7 * omega**1.3))
    data = gb.FrequencyResponse(omega, response, "u", "angle")
    problem = gb.Problem(declared(fitted_equation)(), data)
    path = tmp_path_factory.mktemp("fits") / "pendulum.h5"
    gb.save(gb.fit(problem, starts=2, progress=False), path)
    return path


@pytest.mark.parametrize("derivative", [fitted_equation, rewritten])
def test_the_model_of_a_saved_fit_may_be_written_in_other_words(path, derivative):
    fit = gb.load(path, models=[declared(derivative)])
    at = fit.response([2.0]).response[0]
    k, c = (fit.estimate[name] for name in "kc")
    assert at == pytest.approx(1 / (k - 4 + 2j * c))


@pytest.mark.parametrize("derivative", CHANGED.values(), ids=CHANGED)
def test_a_model_with_other_formulas_than_the_fitted_one_is_refused(path, derivative):
    with pytest.raises(ValueError, match=r"formulas of the model .*Pendulum are not those of the"):
        gb.load(path, models=[declared(derivative)])
    assert gb.load(path).estimate["k"] == pytest.approx(4.0, rel=0.1)  # its numbers need no model


def test_other_delays_are_other_formulas(path):
    with pytest.raises(ValueError, match="are not those of the fitted one"):
        gb.load(path, models=[declared(fitted_equation, {"u": "tau"})])


def test_a_file_of_an_earlier_version_has_no_formulas_to_compare():
    fitted, changed = declared(fitted_equation), declared(CHANGED["form"])
    stored = reference(fitted())
    with pytest.raises(ValueError, match="are not those of the fitted one"):
        resolve(stored, [changed])
    del stored["formula"]
    assert isinstance(resolve(stored, [changed]), changed)
