"""Drag models, records of drag at a few m/s, and fits to them."""

import dataclasses

import numpy as np
from scipy.signal import lfilter

import greybox as gb
from greybox.models.tilt import PAPER_G


class Drag(gb.StateSpace):
    """Horizontal velocity from the tilt angle, (4.23) and (4.24) together."""

    states, inputs, outputs = ("v",), ("theta",), ("v",)
    a5 = gb.Parameter(0.2, bounds=(-2, 5), unit="1/s")
    C_x = gb.Parameter(0.05, bounds=(-1, 2), unit="1/m")

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - p.C_x * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)


class LinearDrag(gb.StateSpace):
    """Its linear term alone."""

    states, inputs, outputs = ("v",), ("theta",), ("v",)
    a5 = Drag.a5

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v,)

    def output(self, x, u, p):
        return (x.v,)


class QuadraticDrag(LinearDrag):
    """Its quadratic term alone."""

    a5 = gb.Parameter(0.0, fixed=True)
    C_x = dataclasses.replace(Drag.C_x, bounds=(0.001, 2))

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.a5 * x.v - p.C_x * abs(x.v) * x.v,)


QUADRATIC, LINEAR = {"a5": 0.0, "C_x": 0.08}, {"a5": 0.3, "C_x": 0.0}


def flight(values, seed, duration=30.0, noise=0.05, color=0.0, amplitude=0.1):
    """A record of the drag at a few m/s, with errors that follow one another by `color`."""
    time = np.arange(round(20 * duration)) / 20
    random = np.random.default_rng(seed)
    theta = amplitude * sum(np.sin(w * time + random.uniform(0, 6)) for w in (0.3, 0.7, 1.3, 2.9))
    clean = gb.simulate(Drag(), values, gb.Record(time, {"theta": theta}))["v"]
    error = lfilter([np.sqrt(1 - color**2)], [1, -color], noise * random.normal(size=time.size))
    return gb.Record(
        time,
        {"theta": theta, "v": clean + error},
        {"theta": "rad", "v": "m/s"},
        name=f"flight {seed}",
    )


def fitted(model, record, method=None, **options):
    problem = gb.Problem(model, record, **options)
    start = [{name: p.start for name, p in problem.parameters.items() if not p.fixed}]
    return gb.fit(problem, starts=start, method=method, progress=False, profiles=False)
