"""Stiff problems of the Bari test set, simulated to their published reference solutions.

Source: Mazzia and Magherini (2008), Test Set for Initial Value Problem Solvers, release 2.4,
University of Bari: HIRES, OREGO, and VDPOLM (µ = 1000, t = 2000).
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import greybox as gb


class Hires(gb.StateSpace):
    """High irradiance response of a plant: eight reactions."""

    states = outputs = tuple(f"y{k}" for k in range(1, 9))
    inputs = ()

    def derivative(self, x, u, p):
        y1, y2, y3, y4, y5, y6, y7, y8 = (getattr(x, name) for name in self.states)
        fast = 280 * y6 * y8
        return (
            -1.71 * y1 + 0.43 * y2 + 8.32 * y3 + 0.0007,
            1.71 * y1 - 8.75 * y2,
            -10.03 * y3 + 0.43 * y4 + 0.035 * y5,
            8.32 * y2 + 1.71 * y3 - 1.12 * y4,
            -1.745 * y5 + 0.43 * y6 + 0.43 * y7,
            -fast + 0.69 * y4 + 1.71 * y5 - 0.43 * y6 + 0.69 * y7,
            fast - 1.81 * y7,
            -fast + 1.81 * y7,
        )

    def output(self, x, u, p):
        return tuple(getattr(x, name) for name in self.states)


class Oregonator(gb.StateSpace):
    """The Belousov-Zhabotinskii reaction."""

    states = outputs = ("y1", "y2", "y3")
    inputs = ()

    def derivative(self, x, u, p):
        return (
            77.27 * (x.y2 + x.y1 * (1 - 8.375e-6 * x.y1 - x.y2)),
            (x.y3 - (1 + x.y1) * x.y2) / 77.27,
            0.161 * (x.y1 - x.y3),
        )

    def output(self, x, u, p):
        return (x.y1, x.y2, x.y3)


class VanDerPol(gb.StateSpace):
    """An oscillator whose damping changes its sign."""

    states = outputs = ("y", "v")
    inputs = ()
    mu = gb.Parameter(1000.0, fixed=True)

    def derivative(self, x, u, p):
        return (x.v, p.mu * (1 - x.y**2) * x.v - x.y)

    def output(self, x, u, p):
        return (x.y, x.v)


def simulated(model, end, count, initial, values=None, **options):
    """Return the states (n, count) at equal steps to the end."""
    time = np.linspace(0, end, count)
    record = gb.Record(time, {"none": np.zeros(count)})
    motion = gb.simulate(model, values or {}, record=record, initial=initial, **options)
    return np.array([motion[name] for name in model.states])


def test_hires():
    states = simulated(Hires(), 321.8122, 101, {"y1": 1.0, "y8": 0.0057})
    # fmt: off
    expected = [0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4, 0.1175651343283149e-2,
                0.2386356198831331e-2, 0.6238968252742796e-2, 0.2849998395185769e-2, 0.2850001604814231e-2]
    # fmt: on
    assert_allclose(states[:, -1], expected, rtol=1e-7)


def test_oregonator():
    states = simulated(Oregonator(), 360.0, 361, {"y1": 1.0, "y2": 2.0, "y3": 3.0})
    expected = [0.1000814870318523e1, 0.1228178521549917e4, 0.1320554942846706e3]
    assert_allclose(states[:, -1], expected, rtol=1e-6)


def test_van_der_pol_at_a_thousand():
    states = simulated(VanDerPol(), 2000.0, 401, {"y": 2.0})
    assert states[0, -1] == pytest.approx(0.1706167732170469e1, abs=1e-6)
    assert states[1, -1] == pytest.approx(-0.8928097010248125e-3, abs=1e-8)


def test_van_der_pol_at_a_hundred():
    """There is no published solution: SciPy's by Radau, with eleven digits."""
    states = simulated(VanDerPol(), 200.0, 401, {"y": 2.0}, {"mu": 100.0}, integrator=gb.Radau())

    def slope(_, x):
        return [x[1], 100 * (1 - x[0] ** 2) * x[1] - x[0]]

    time = np.linspace(0, 200.0, 401)
    exact = solve_ivp(slope, (0, 200.0), [2.0, 0.0], "Radau", time, rtol=1e-10, atol=1e-11)
    assert_allclose(states[0], exact.y[0], atol=1e-4)
