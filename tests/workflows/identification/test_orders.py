"""Of rational transfer functions of rising order the one that made the data is chosen, and not a larger one."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from declared_models import measured
from unfolded import unfolded

import greybox as gb
from greybox.models.filters import LowPass
from greybox.models.polynomial import Polynomial
from greybox.workflows.identification import select_orders
from greybox.workflows.identification.orders import Orders, best_response, linear_fits, orders_of


class Plant(gb.TransferFunction):
    """An integrator with lag and delay, of a gain far from one."""

    K = gb.Parameter(-900.0, bounds=(-1e6, 1e6))

    def response(self, s, p):
        return p.K / (s * (0.2 * s + 1)) * gb.exp(-0.05 * s)


OMEGA = np.geomspace(0.5, 30, 20)


@pytest.fixture(scope="module")
def data():
    return measured(Plant(), OMEGA, noise=0.02, seed=1)


@pytest.fixture(scope="module")
def found(data):
    return select_orders(data)


def test_the_structure_of_the_truth_is_chosen(found, data):
    assert found.chosen.label == "n = 2, m = 0, 1 integrator, delay"
    for name, truth in {"b0": -4500.0, "a1": 5.0, "T_delay": 0.05}.items():
        assert abs(found.fit.estimate[name] - truth) < 3 * found.fit.standard_error[name], name
    assert found.explains
    assert found.chosen.about.startswith("-9")
    assert "exp(-0.05" in found.chosen.about
    # Bounds leave room for ten times the largest gain, and poles at ten times the last frequency.
    largest = 10 * np.abs(data.response).max() * (10 * OMEGA[-1]) ** 2
    assert found.fit.by_name["b0"].bounds == pytest.approx((-largest, largest))
    assert found.fit.by_name["T_delay"].bounds == pytest.approx((0, 3 * 8 / OMEGA[-1]))


def test_other_starts_of_the_chosen_structure_reach_its_minimum(found, data):
    assert found.fit.agreeing > 1
    assert not any("one start only" in text for text in found.fit.warnings)
    others = [candidate.fit for candidate in found.candidates if candidate is not found.chosen]
    more = select_orders(data, starts=5, seed=1)
    assert (len(found.fit.runs), len(more.fit.runs)) == (1 + 20, 1 + 5)
    # The others decide on the structure alone.
    assert {fit.agreeing for fit in others} == {1}


def test_the_table_has_every_structure_that_was_fitted(found):
    lines = str(found).splitlines()
    assert sum(line.endswith("  chosen") or "  chosen;" in line for line in lines) == 1
    # A turn and a quarter at the highest frequency, 30 rad/s: 8 rad.
    assert "delays from 0 to 0.27 s were tried" in str(found)
    assert unfolded(found).endswith(found.verdict)
    least = min(found.bic)
    for candidate, bic in zip(found.candidates, found.bic, strict=True):
        unstable = any("unstable" in remark for remark in candidate.remarks)
        plain = 2 * candidate.fit.cost + (len(candidate.fit.free) + 1) * math.log(40)
        assert bic == pytest.approx(plain + 6 * unstable)
        assert bic - least >= 0
    sizes = [len(candidate.fit.free) for candidate in found.candidates]
    assert sizes == sorted(sizes)
    # By the BIC of least squares, structures of more than two parameters more are not fitted again.
    assert max(sizes) == 5


def test_structures_and_values_can_be_stated(data):
    stated = select_orders(data, n=(2,), m=(0,), integrators=(1,), fixed={"T_delay": 0.04})
    assert [c.label for c in stated.candidates] == ["n = 2, m = 0, 1 integrator, delay"]
    assert stated.fit.estimate["T_delay"] == 0.04
    without = select_orders(data, n=(2, 3), m=(0,), integrators=(1,), delay=False)
    assert all("delay" not in c.label for c in without.candidates)
    with pytest.raises(TypeError, match="there is no option 'radius'"):
        select_orders(data, n=(2,), radius={})


def test_two_responses_are_fitted_together_and_a_filter_is_taken_out(data):
    known = LowPass(4.0)
    omega = OMEGA[::2]
    filtered = gb.frequency_response(known, None, omega).response
    plant = gb.frequency_response(Plant(), None, omega).response
    noise = 1 + 0.02 * np.random.default_rng(2).normal(size=omega.size)
    response = gb.FrequencyResponse(omega, plant * filtered * noise)
    responses = [response, response.where(omega > 1)]
    linear = linear_fits(responses, [known], [Orders(2, 0, 1), Orders(3, 1, 1)])
    np.testing.assert_allclose(best_response(linear, omega), plant, rtol=0.05)
    found = select_orders(responses, through=[known], linear=linear)
    assert found.chosen.label == "n = 2, m = 0, 1 integrator, delay"
    assert abs(found.fit.estimate["a1"] - 5.0) < 3 * found.fit.standard_error["a1"]


def test_a_filter_is_taken_out_of_responses_with_variances():
    """Dividing by its gain leaves the weights: relative errors are those of the measured response."""
    known = LowPass(4.0)
    plant = measured(Plant(), OMEGA, noise=0.02, seed=3)
    gain = gb.frequency_response(known, None, OMEGA).response
    relative = np.geomspace(0.01, 0.3, OMEGA.size)
    variance = (relative * np.abs(plant.response)) ** 2
    alone = replace(plant, variance=variance)
    behind = replace(plant, response=plant.response * gain, variance=variance * np.abs(gain) ** 2)
    grid = [Orders(2, 0, 1), Orders(2, 0, 0)]
    expected, found = linear_fits([alone], structures=grid), linear_fits([behind], [known], grid)
    for orders in grid:
        assert found[orders].bic == pytest.approx(expected[orders].bic)
        assert found[orders].start == pytest.approx(expected[orders].start, rel=1e-5)


def test_structures_by_default_have_up_to_four_poles_two_zeros_and_two_integrators():
    """Every strictly proper one of them, once."""
    structures = [(o.n, o.m, o.integrators) for o in orders_of()]
    expected = {
        (poles + integrators, zeros, integrators)
        for poles, zeros, integrators in product(range(5), range(3), range(3))
        if zeros < poles + integrators
    }
    assert len(structures) == len(expected)
    assert set(structures) == expected


def test_residuals_many_times_the_noise_are_no_model():
    """Ten lags are more than the grid has: none of the structures explains points of 0.01 % noise."""
    omega = np.geomspace(0.1, 100, 60)
    resonances = sum(1 / (1 - (omega / w) ** 2 + 0.02j * omega / w) for w in (0.5, 2, 7, 20, 50))
    data = gb.FrequencyResponse(omega, resonances, variance=1e-8 * np.abs(resonances) ** 2)
    found = select_orders(data, n=(2,), integrators=(0,))
    assert not found.explains
    assert "No structure explains the data" in found.verdict
    assert "does not explain the data" in found.fit.warnings[0]


def test_polynomials_have_several_integrators_and_a_delay():
    omega = np.array([0.5, 3.0])
    s = 1j * omega
    model = Polynomial(3, 1, 2, delay=0.2)
    assert model.label == "Polynomial(3, 1, 2 integrators, delay)"
    made = gb.frequency_response(
        model, {"b0": 2.0, "b1": 3.0, "a2": 4.0, "T_delay": 0.1}, omega
    ).response
    np.testing.assert_allclose(made, (3 * s + 2) / (s**2 * (s + 4)) * np.exp(-0.1 * s), rtol=1e-12)
    with pytest.raises(
        ValueError, match=r"integrator = 4 and delay = 0\.0: give from 0 to n = 3 integrators"
    ):
        Polynomial(3, 1, 4)


def test_a_grid_without_a_structure_is_refused():
    data = measured(Plant(), np.array([1.0, 2.0]))
    with pytest.raises(
        ValueError, match="no structure of the grid has fewer unknowns than 4 real numbers: lower n"
    ):
        select_orders(data, n=(4,))


def test_a_delay_that_ends_at_zero_is_left_out_and_named():
    class Lag(gb.TransferFunction):
        K = gb.Parameter(3.0)

        def response(self, s, p):
            return p.K / (0.2 * s + 1) * gb.exp(0.01 * s)  # early, so that no delay is left

    found = select_orders(measured(Lag(), OMEGA, noise=0.02, seed=2), n=[1], m=[0], integrators=[0])
    assert found.chosen.label == "n = 1, m = 0"
    assert "ended at zero" in unfolded(found)


def test_a_stable_plant_is_preferred_to_an_unstable_one_with_more_delay():
    """Below 12 rad/s, a lag of 9 rad/s hardly differs from a pole of 20 rad/s and 0.1 s more."""

    class Vehicle(gb.TransferFunction):
        K = gb.Parameter(0.02)

        def response(self, s, p):
            return p.K / (s * (s / 9 + 1) * (s**2 / 50 + s / 4 + 1)) * gb.exp(-0.02 * s)

    found = select_orders(
        measured(Vehicle(), np.geomspace(0.4, 12, 30), noise=0.04, seed=6),
        n=[4],
        m=[0],
        integrators=[1],
    )
    unstable, stable = sorted(found.candidates, key=lambda c: c.fit.cost)
    assert unstable.unstable
    assert found.chosen is stable
    assert not stable.unstable
    assert abs(found.fit.estimate["T_delay"] - 0.02) < 3 * found.fit.standard_error["T_delay"]
