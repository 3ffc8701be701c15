"""Gusts are named where the air moves the vehicle, and errors of a sensor are not taken for them."""

import numpy as np
from scipy.signal import lfilter
from slow_lag import SlowLag

import greybox as gb

STEP = 0.05
COEFFICIENT = np.exp(-STEP / 0.5)  # of gusts that last half a second


class Spring(gb.StateSpace):
    states, inputs, outputs = ("x", "v"), ("u",), ("y",)
    k = gb.Parameter(1.0, bounds=(0.1, 10))
    c = gb.Parameter(1.0, bounds=(0.01, 10))
    b = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return (x.v, p.b * u.u - p.k * x.x - p.c * x.v)

    def output(self, x, u, p):
        return (x.x,)


def moved(model):
    """Return the model with gusts as an input."""

    class Moved(model):
        inputs = ("u", "gust")

        def derivative(self, x, u, p):
            *others, last = super().derivative(x, u, p)
            return (*others, last + u.gust)

    return Moved()


MOVED = {model: moved(model) for model in (Spring, SlowLag)}


def fitted(model, truth, moved_by, sensor, samples, seed):
    """Fit a record with gusts, and noise of a sensor (autoregressive coefficient), of given sizes."""
    random = np.random.default_rng(seed)
    noise = random.normal(size=(2, samples + 400))
    gust = lfilter([(1 - COEFFICIENT**2) ** 0.5], [1, -COEFFICIENT], noise[0])[400:]
    coefficient, size = sensor
    error = lfilter([(1 - coefficient**2) ** 0.5], [1, -coefficient], noise[1])[400:]
    u = np.repeat(np.sign(random.normal(size=samples // 15 + 1)), 15)[:samples]
    hold = {"u": 0.0, "gust": 0.0}
    record = gb.Record(STEP * np.arange(samples), {"u": u, "gust": moved_by * gust}, hold=hold)
    initial = dict.fromkeys(model.states, 0.0)
    y = gb.simulate(MOVED[model], truth, record, initial=initial)["y"]
    measured = gb.Record(record.time, {"u": u, "y": y + size * np.std(y) * error}, hold={"u": 0.0})
    return gb.fit(gb.Problem(model(), measured), starts=1, progress=False, profiles=False)


def named(fits):
    return sum(any("look like gusts" in text for text in fit.warnings) for fit in fits)


def test_errors_of_a_sensor_in_a_short_record_are_not_gusts():
    """Of 20 such fits, 12 named gusts, and one had 0.06 degrees of freedom."""
    truth = {"k": 1.0, "c": 0.6, "b": 1.0}
    fits = [fitted(Spring, truth, 0.0, (0.8, 0.05), 100, seed) for seed in range(8, 18)]
    assert named(fits) <= 1
    assert min(fit.dof for fit in fits) >= 1


def test_gusts_in_a_slow_vehicle_are_named():
    """Of 20 such fits, 7 named them."""
    truth = {"K": 2.0, "tau": 2.0}
    fits = [fitted(SlowLag, truth, 0.3, (0.0, 0.01), 300, seed) for seed in range(10)]
    assert named(fits) >= 7


class Tracked(Spring):
    outputs = ("y", "speed")

    def output(self, x, u, p):
        return (x.x, x.v)


def test_errors_of_a_sensor_that_misses_half_of_the_record_are_not_gusts():
    """All four such fits named gusts: both outputs counted as whole."""
    fits = []
    for seed in range(4):
        random = np.random.default_rng(seed)
        u = np.repeat(np.sign(random.normal(size=20)), 15)
        record = gb.Record(STEP * np.arange(u.size), {"u": u}, hold={"u": 0.0})
        truth = {"k": 9.0, "c": 3.0, "b": 9.0}
        exact = gb.simulate(Tracked(), truth, record, initial={"x": 0.0, "v": 0.0})
        errors = lfilter([0.6], [1, -0.8], random.normal(size=(2, u.size + 400)))[:, 400:]
        y, speed = [
            exact[k] + 0.05 * exact[k].std() * e
            for k, e in zip(Tracked.outputs, errors, strict=True)
        ]
        speed[150:] = np.nan
        measured = record.with_signals(y=y, speed=speed)
        fits.append(gb.fit(gb.Problem(Tracked(), measured), starts=1, progress=False))
    assert named(fits) <= 1
