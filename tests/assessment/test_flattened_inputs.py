"""An input of a limited band, which lines between samples flatten: warning, and its cure."""

import numpy as np
import pytest

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

RATE, SAMPLES = 10.0, 1000  # Hz


class Mass(gb.StateSpace):
    """A mass on a spring, with a gain."""

    states, inputs, outputs = ("x", "v"), ("F",), ("x",)
    k = gb.Parameter(20.0, bounds=(1, 200))
    d = gb.Parameter(1.0, bounds=(0.01, 10))
    b = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        """Return the rates of position and speed."""
        return (x.v, p.b * u.F - p.k * x.x - p.d * x.v)

    def output(self, x, u, p):
        """Return the position."""
        return (x.x,)


TRUTH = {"k": 40.0, "d": 2.0, "b": 1.5}


def steady(lines, seed=0):
    """Return time, force and position of sines at these shares of the rate, from closed forms."""
    random = np.random.default_rng(seed)
    time = np.arange(SAMPLES) / RATE
    phases = random.uniform(0, 2 * np.pi, len(lines))
    s = 2j * np.pi * RATE * np.asarray(lines)
    response = TRUTH["b"] / (s**2 + TRUTH["d"] * s + TRUTH["k"])
    turning = np.exp(s[:, None] * time + 1j * phases[:, None])
    force, position = turning.real.sum(axis=0), (response[:, None] * turning).real.sum(axis=0)
    return time, force, position + 0.01 * random.normal(size=SAMPLES)


def fitted(time, force, position):
    record = gb.Record(time, {"F": force, "x": position})
    return gb.fit(gb.Problem(Mass(), record), starts=1, progress=False, profiles=False)


def shift(fit):
    """Return the largest error in standard errors."""
    return max(abs(fit.estimate[n] - TRUTH[n]) / fit.standard_error[n] for n in TRUTH)


def is_warned(fit):
    return any("lines between its samples" in text for text in fit.warnings)


def test_a_multisine_is_named_and_its_interpolation_recovers_the_truth():
    lines = np.arange(4, 200, 4) / SAMPLES  # whole periods, up to 0.2 of the rate
    time, force, position = steady(lines)
    fit = fitted(time, force, position)
    assert is_warned(fit)
    assert shift(fit) > 5

    # Four times the rate by the band: sines between the samples, and no outputs there.
    spectrum = np.fft.rfft(force)
    finer = 4 * np.fft.irfft(spectrum, 4 * SAMPLES)
    sparse = np.full(4 * SAMPLES, np.nan)
    sparse[::4] = position
    cured = fitted(np.arange(4 * SAMPLES) / (4 * RATE), finer, sparse)
    assert not is_warned(cured)
    assert shift(cured) < 4


@pytest.mark.parametrize("kind", ["sweep", "steps", "stick"])
def test_ordinary_inputs_are_not_named(kind):
    time = np.arange(SAMPLES) / RATE
    random = np.random.default_rng(1)
    force = {
        "sweep": np.sin(np.pi * 0.1 * RATE * time**2 / time[-1]),  # up to a tenth of the rate
        "steps": np.repeat(random.choice([-1.0, 1.0], SAMPLES // 20), 20),
        "stick": np.convolve(random.normal(size=SAMPLES + 29), np.hanning(30), "valid"),
    }[kind]
    record = gb.Record(time, {"F": force})
    position = gb.simulate(Mass(), TRUTH, record)["x"] + 0.002 * random.normal(size=SAMPLES)
    assert not is_warned(fitted(time, force, position))
