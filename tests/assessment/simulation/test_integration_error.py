"""Simulations of stiff and of chaotic models: exact, or with a warning that they are not."""

import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb


class VanDerPol(gb.StateSpace):
    """A relaxation oscillation, which jumps within a thousandth of its period."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    mu = gb.Parameter(100.0, bounds=(0.1, 1e5))

    def derivative(self, x, u, p):
        return x.v, p.mu * (1 - x.x**2) * x.v - x.x + u.u

    def output(self, x, u, p):
        return (x.x,)


class Lorenz(gb.StateSpace):
    states, inputs, outputs = ("x", "y", "z"), ("u",), ("x",)
    rho = gb.Parameter(28.0, bounds=(1, 100))

    def derivative(self, x, u, p):
        return 10 * (x.y - x.x) + u.u, x.x * (p.rho - x.z) - x.y, x.x * x.y - 8 / 3 * x.z

    def output(self, x, u, p):
        return (x.x,)


def scipy_motion(time):
    """Return the first state (n,) of the oscillation for µ = 100, from x = 2."""

    def slope(_, x):
        return [x[1], 100 * (1 - x[0] ** 2) * x[1] - x[0]]

    span = (0, time[-1])
    return solve_ivp(slope, span, [2, 0], "Radau", time, rtol=1e-9, atol=1e-11).y[0]


def test_a_relaxation_oscillation_jumps_when_it_does_by_scipy():
    time = np.linspace(0, 170, 1701)
    record = gb.Record(time, {"u": np.zeros(time.size)})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = gb.simulate(VanDerPol(), {"mu": 100.0}, record=record, initial={"x": 2.0})
    exact = scipy_motion(time)
    assert np.abs(exact).min() < 1.5  # it has jumped
    assert np.abs(motion["x"] - exact).max() < 2e-3  # of a range of 4


def test_a_chaotic_motion_is_said_to_depend_on_the_steps():
    time = np.linspace(0, 40, 2001)
    record = gb.Record(time, {"u": np.zeros(time.size)})
    with pytest.warns(UserWarning, match="simulation of Lorenz is not exact: halving its .* steps"):
        gb.simulate(Lorenz(), {"rho": 28.0}, record=record, initial={"x": 1.0, "y": 1.0, "z": 1.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        short = gb.Record(time[:251], {"u": np.zeros(251)})
        gb.simulate(Lorenz(), {"rho": 28.0}, record=short, initial={"x": 1.0, "y": 1.0, "z": 1.0})


def test_a_prediction_jumps_when_it_does_by_scipy_or_says_that_it_does_not():
    time = np.arange(90.0)
    exact = scipy_motion(time)
    record = gb.Record(time, {"u": np.zeros(time.size), "x": exact})

    def predicted(**options):
        return gb.predict(VanDerPol(), {"mu": 100.0}, record, lead=5, horizon=80, **options)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        windows = predicted()
    assert windows.measured("x").min() < -1.5  # it has jumped
    assert np.abs(windows.residual("x")).max() < 1e-6  # of a range of 4

    with pytest.warns(
        UserWarning, match="prediction of VanDerPol is not exact: .* shorter windows"
    ):
        windows = predicted(integrator=gb.RungeKutta())
    assert np.abs(windows.residual("x")).max() > 1e-5
