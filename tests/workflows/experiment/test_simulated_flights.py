"""Simulated flights against virtual flights, and ringing against an oscillator in closed form."""

import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoop

import greybox as gb
from greybox.workflows.experiment.sampled_loop import sampled_loop
from greybox.workflows.experiment.simulated_flights import FlightTest, fly, is_ringing, simulated

TRUTH = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": 0.023}  # the delay is no multiple of a sample


class Limited(RateLoop):
    """The controller with a limit of the control."""

    def update(self, x, u, p):
        following, (control,) = super().update(x, u, p)
        return following, (gb.maximum(-0.05, gb.minimum(0.05, control)),)


def plants(*values):
    rows = [[*RateDynamics().values(TRUTH | row).values()] for row in values]
    return sampled_loop(RateDynamics(), np.array(rows), RateLoop())


@pytest.mark.parametrize("law", [RateLoop(), Limited()])
def test_a_simulated_flight_is_the_virtual_flight_of_a_linear_plant(law):
    """With and without limits of the controller, for two plants at once."""
    values = {}, {"K": 20.0, "tau": 0.041}
    test = FlightTest(300, {"reference": (0.5, "q"), "u": (0.02, "q")}, {})
    control, unlimited, response = simulated([law], plants(*values), test)
    steps = {"reference": np.full(300, 0.5), "u": np.r_[np.zeros(150), np.full(150, 0.02)]}
    for k, row in enumerate(values):
        flight = gb.virtual_flight(RateDynamics(), TRUTH | row, steps, controller=law)
        np.testing.assert_allclose(response[k, 0], flight["q"], atol=1e-5)
        np.testing.assert_allclose(control[k, 0], flight["u"], atol=1e-5)
    is_limited = isinstance(law, Limited)
    assert (np.abs(control - unlimited).max() > 1e-3) == is_limited


def test_flights_that_reach_a_limit_are_counted():
    loops = plants({}, {"K": 20.0}, {"K": 60.0})
    small, large = (FlightTest(300, {"reference": (size, "q")}, {}) for size in (0.1, 1.0))
    assert fly([Limited()], loops, small).saturating == 0
    assert fly([Limited()], loops, large).saturating == 3
    assert fly([RateLoop()], loops, large).saturating == 0


@pytest.mark.parametrize("damping", [0.05, 0.15, 0.25, 0.5, 1.2])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_step_of_an_oscillator_rings_below_a_damping_of_a_fifth(damping, noise):
    time = np.linspace(0, 30, 3000)
    a, b = np.roots([1, 2 * damping, 1]).astype(complex)
    step = 1 + ((b * np.exp(a * time) - a * np.exp(b * time)) / (a - b)).real
    errors = noise * np.random.default_rng(0).standard_normal(time.size)
    assert is_ringing(step + errors) == (damping < 0.2)
    assert is_ringing(np.full(10, np.nan))


def test_a_loop_rings_once_its_gain_is_near_the_limit():
    loops = plants({})
    limit = 10 ** (gb.margins(RateDynamics(), RateLoop(), TRUTH)["gain margin"].value / 20)
    test = FlightTest(600, {"reference": (0.1, "q"), "u": (0.02, "q")}, {"q": 1e-4})
    for share, rings in ((0.3, 0), (0.9, 1)):
        law = RateLoop({"K_P": 0.15 * limit * share, "K_I": 0.3})
        assert fly([law], loops, test).ringing == rings
    assert RATE == 100
