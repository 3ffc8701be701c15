"""A calibration of a sensor.

A straight line and a parabola through rows that have no order in time.
"""

import numpy as np

import greybox as gb


class Line(gb.StateSpace):
    """y = a + b x."""

    inputs = ("x",)
    outputs = ("y",)
    a = gb.Parameter(1.0, starts=(-5, 5), unit="V")
    b = gb.Parameter(0.5, starts=(-5, 5))

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)


class Parabola(Line):
    """y = a + b x + c x²."""

    c = gb.Parameter(0.0, starts=(-5, 5))

    def output(self, x, u, p):
        return (p.a + p.b * u.x + p.c * u.x**2,)


class Lag(gb.StateSpace):
    """y' = x - a y."""

    states = ("y",)
    inputs = ("x",)
    outputs = ("y",)
    a = gb.Parameter(1.0, starts=(0, 5))

    def derivative(self, x, u, p):
        return (u.x - p.a * x.y,)

    def output(self, x, u, p):
        return (x.y,)


def rows(number=14, seed=0, c=0.0, noise=0.1, time=None):
    """Return rows of y = 2 + 3 x + c x² with normal errors, in no order."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, number)
    y = 2 + 3 * x + c * x**2 + noise * rng.standard_normal(number)
    return gb.Record(time, {"x": x, "y": y}, {"y": "V"}, name="calibration")


def least_squares(record, degree=1):
    """Return estimates, their standard errors and the sum of squares, by the formulas of linear
    regression."""
    A = np.vander(record["x"], degree + 1, increasing=True)
    q, _, _, _ = np.linalg.lstsq(A, record["y"], rcond=None)
    squares = float(np.sum((record["y"] - A @ q) ** 2))
    left = max(len(record) - degree - 1, 1)
    return q, np.sqrt(np.diag(np.linalg.inv(A.T @ A)) * squares / left), squares
