"""Outputs that repeat values, as where missing samples were filled, and outputs that are rounded."""

import numpy as np
import pytest

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

RATE, SAMPLES = 20.0, 300  # Hz
TRUTH = {"K": 2.0, "T": 0.4}


class Lag(gb.StateSpace):
    """A first-order lag."""

    states = outputs = ("y",)
    inputs = ("u",)
    K = gb.Parameter(1.0, bounds=(0.1, 20))
    T = gb.Parameter(1.0, bounds=(0.05, 10), unit="s")

    def derivative(self, x, u, p):
        """Return the rate of the output."""
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        """Return the output."""
        return (x.y,)


def measured(seed, noise=0.1):
    """Return input and output of a lag, in closed form, with white errors."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.choice([-1.0, 1.0], SAMPLES // 15), 15)
    y, decay = np.zeros(SAMPLES), np.exp(-1 / RATE / TRUTH["T"])
    for k in range(1, SAMPLES):
        y[k] = decay * y[k - 1] + (1 - decay) * TRUTH["K"] * u[k - 1]
    return u, y + noise * random.normal(size=SAMPLES)


def fitted(u, y):
    record = gb.Record(np.arange(SAMPLES) / RATE, {"u": u, "y": y}, hold={"u": np.inf})
    return gb.fit(gb.Problem(Lag(), record), starts=1, progress=False, profiles=False)


def is_filled(fit):
    return any("repeats its previous value" in text for text in fit.warnings)


def is_rounded(fit):
    return any("rounded more coarsely" in text for text in fit.notes)


@pytest.mark.parametrize("step", [0.0, 0.02], ids=["floats", "rounded"])
def test_filled_samples_are_named_and_the_cure_is_to_leave_them_out(step):
    u, y = measured(1)
    y = np.round(y / step) * step if step else y
    lost = np.random.default_rng(5).random(SAMPLES) < 0.3
    lost[0] = False
    filled = y[np.maximum.accumulate(np.where(lost, 0, np.arange(SAMPLES)))]
    late = fitted(u, filled)
    assert is_filled(late)
    assert abs(late.estimate["T"] - TRUTH["T"]) > 3 * late.standard_error["T"]
    cured = fitted(u, np.where(lost, np.nan, y))
    assert not is_filled(cured)
    assert abs(cured.estimate["T"] - TRUTH["T"]) < 3 * cured.standard_error["T"]


def test_a_sensor_at_a_lower_rate_that_is_held_is_named():
    u, y = measured(2)
    assert is_filled(fitted(u, np.repeat(y[::4], 4)))


@pytest.mark.parametrize("step", [0.05, 0.3, 1.0])
def test_rounding_is_not_taken_for_filled_samples(step):
    u, y = measured(3)
    fit = fitted(u, np.round(y / step) * step)
    assert not is_filled(fit)
    assert is_rounded(fit) == (step > 0.2)


def test_white_noise_and_exact_data_are_neither():
    for noise in (0.0, 0.1):
        fit = fitted(*measured(4, noise))
        assert not is_filled(fit)
        assert not is_rounded(fit)
