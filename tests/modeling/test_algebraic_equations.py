"""A model that solves an algebraic equation by Newton steps, as the guide says, against roots."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import greybox as gb


class SeriesSprings(gb.StateSpace):
    """A mass on a linear and a hardening spring in series; nothing has a mass between them."""

    states, inputs, outputs = ("x", "v"), ("F",), ("x", "z")
    k_s = gb.Parameter(15.0, bounds=(1, 100))
    k = gb.Parameter(4.0, bounds=(1, 100))
    k_3 = gb.Parameter(20.0, bounds=(0, 1000))
    d = gb.Parameter(0.5, bounds=(0, 10))

    def between(self, x, p):
        """Return the position between the springs."""
        z = x
        for _ in range(8):
            excess = p.k * z + p.k_3 * z**3 - p.k_s * (x - z)
            z = z - excess / (p.k + 3 * p.k_3 * z**2 + p.k_s)
        return z

    def derivative(self, x, u, p):
        """Return the rates of position and speed."""
        return (x.v, (u.F - p.k_s * (x.x - self.between(x.x, p)) - p.d * x.v) / 0.2)

    def output(self, x, u, p):
        """Return both positions."""
        return (x.x, self.between(x.x, p))


TRUTH = {"k_s": 20.0, "k": 5.0, "k_3": 30.0, "d": 0.4}
TIME = np.arange(0, 10, 0.02)
FORCE = 4 * np.sin(0.3 * TIME**2)


def between(x):
    """Return the only real root of the balance of forces, by hyperbolic functions."""
    # Of z³ + 3 p z = 2 q.
    p = (TRUTH["k"] + TRUTH["k_s"]) / TRUTH["k_3"] / 3
    q = TRUTH["k_s"] * x / TRUTH["k_3"] / 2
    return 2 * np.sqrt(p) * np.sinh(np.arcsinh(q / p**1.5) / 3)


def independent():
    """Return both positions (2, samples) by SciPy."""

    def slope(t, x):
        force = np.interp(t, TIME, FORCE) - TRUTH["k_s"] * (x[0] - between(x[0]))
        return (x[1], (force - TRUTH["d"] * x[1]) / 0.2)

    x = solve_ivp(slope, (0, TIME[-1]), (0, 0), "RK45", TIME, rtol=1e-8, atol=1e-10, max_step=0.02)
    return np.array([x.y[0], between(x.y[0])])


def test_a_constraint_is_simulated_fitted_and_linearized():
    exact = independent()
    record = gb.Record(TIME, {"F": FORCE})
    simulated = gb.simulate(SeriesSprings(), TRUTH, record)
    assert_allclose([simulated["x"], simulated["z"]], exact, atol=2e-4 * np.abs(exact).max())

    measured = exact + 0.01 * np.random.default_rng(1).normal(size=exact.shape)
    flown = gb.Record(TIME, {"F": FORCE, "x": measured[0], "z": measured[1]})
    fit = gb.fit(gb.Problem(SeriesSprings(), flown), starts=1, profiles=False)
    for name, value in TRUTH.items():
        assert abs(fit.estimate[name] - value) < 4 * fit.standard_error[name]

    # At rest both springs are linear, of the stiffness k_s k / (k_s + k).
    omega = np.array([1.0, 5.0, 20.0])
    linear = gb.modeling.linearize(SeriesSprings(), TRUTH)
    stiffness = TRUTH["k_s"] * TRUTH["k"] / (TRUTH["k_s"] + TRUTH["k"])
    expected = 1 / (-0.2 * omega**2 + 1j * omega * TRUTH["d"] + stiffness)
    s = 1j * omega[:, None, None]
    response = np.linalg.solve(s * np.eye(2) - linear.A, linear.B[None].astype(complex))[:, 0, 0]
    assert_allclose(response, expected, rtol=1e-9)
