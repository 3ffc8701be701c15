"""Implicit steps against exact solutions, and against collocation solved as one program."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from sample_steps import stepped
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from spring_lag_tilt import HELD, SPRING, Spring, fit, spring

import greybox as gb
from greybox.modeling.implicit_integrators import Radau
from greybox.modeling.realization import dynamics
from greybox.modeling.symbolic_reading import dense_jacobian


class Decay(gb.StateSpace):
    """A stiff nonlinear decay with an input that is linear in time."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    a = gb.Parameter(2.0, bounds=(0, 1e6))

    def derivative(self, x, u, p):
        return (-p.a * (x.x - u.u) ** 3 - x.x,)

    def output(self, x, u, p):
        return (x.x,)


def step(degree, substeps=1):
    return stepped(dynamics(Decay()), Radau(substeps, degree), substeps)


def exact(h):
    rule = lambda t, x: -2.0 * (x - 0.3 - 0.4 * (t / h - 0.5)) ** 3 - x  # noqa: E731
    return solve_ivp(rule, (0, h), [1.5], rtol=1e-12, atol=1e-13).y[0, -1]


@pytest.mark.parametrize(("degree", "order"), [(1, 1), (2, 3), (3, 5)])
def test_the_error_falls_with_the_order(degree, order):
    errors = [abs(float(step(degree, n)(1.5, 0.3, 0.4, 2.0, 1.0)) - exact(1.0)) for n in (8, 16)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_its_derivatives_are_exact():
    x = ca.MX.sym("x")
    function = step(3)
    slope = ca.Function("slope", [x], [ca.jacobian(function(x, 0.3, 0.4, 2.0, 0.5), x)])
    eps = 1e-6
    difference = (
        float(function(1.5 + eps, 0.3, 0.4, 2.0, 0.5))
        - float(function(1.5 - eps, 0.3, 0.4, 2.0, 0.5))
    ) / (2 * eps)
    assert float(slope(1.5)) == pytest.approx(difference, rel=1e-7)


def test_stages_that_newton_does_not_solve_give_nan():
    assert np.isnan(float(step(1)(1e200, 0.3, 0.4, 1e6, 1.0)))


@pytest.mark.parametrize("degree", [1, 3])
def test_a_collocation_is_judged_as_it_was_solved(degree):
    """The cost is that of IPOPT's solution and of `gb.cost` with the same method, not of Runge-Kutta."""
    method = gb.Collocation(degree=degree)
    problem = gb.Problem(Spring(), spring(100), HELD)
    found = fit(problem, [SPRING], method=method)
    assert found.converged
    estimate = {name: found.estimate[name] for name in found.free}
    assert gb.cost(problem, estimate, method) == pytest.approx(found.cost, abs=1e-3)
    told = [text for text in found.warnings if "integration is too coarse" in text]
    assert bool(told) == (degree == 1)
    if told:
        assert "method=Collocation(degree=2)" in told[0]
        assert gb.cost(problem, estimate) > found.cost + 10
    residual = np.concatenate([found.records[0].residual(name) for name in ("x", "v")])
    assert_allclose(
        np.sqrt(np.mean(residual[:100] ** 2)), np.sqrt(found.records[0].noise[0, 0]), rtol=1e-6
    )


class Relaxing(gb.StateSpace):
    """Van der Pol's oscillator of mu = 50, which jumps within a fiftieth of a second."""

    states, outputs = ("x", "v"), ("x",)
    inputs = ("u",)
    mu = gb.Parameter(50.0)

    def derivative(self, x, u, p):
        return (x.v, p.mu * (1 - x.x**2) * x.v - x.x)

    def output(self, x, u, p):
        return (x.x,)


@pytest.mark.parametrize("end", [40.0, 48.0])
def test_steps_follow_a_jump_and_their_derivatives_are_their_own(end):
    """Newton's method also converges in long steps, which jump at another time."""
    rule = lambda t, x: (x[1], 50 * (1 - x[0] ** 2) * x[1] - x[0])  # noqa: E731
    wanted = solve_ivp(rule, (0, end), (2, 0), "LSODA", rtol=1e-11, atol=1e-13).y[:, -1]
    mu = ca.MX.sym("mu")
    reached = stepped(dynamics(Relaxing()), Radau(), 8)((2, 0), 0, 0, mu, end)
    run = ca.Function("run", [mu], [reached, ca.jacobian(reached, mu)])
    assert_allclose(run(50)[0].full().ravel(), wanted, rtol=1e-4)
    difference = (run(50 + 1e-5)[0] - run(50 - 1e-5)[0]) / 2e-5
    assert_allclose(run(50)[1].full(), difference.full(), rtol=1e-5, atol=1e-7)


def test_a_chosen_number_of_steps_stays():
    """As many as a collocation has, whose equations they solve."""
    chosen, automatic = (
        stepped(dynamics(Relaxing()), Radau(n), 1)((2, 0), 0, 0, 50, 39.0) for n in (1, None)
    )
    assert float(ca.norm_inf(chosen - automatic)) > 1e-3


class Rod(gb.StateSpace):
    """A rod of 70 cells, heated at one end."""

    states = tuple(f"T{k}" for k in range(70))
    inputs, outputs = ("power",), ("T69",)
    k = gb.Parameter(100.0)

    def derivative(self, x, u, p):
        T = [x[name] for name in self.states]
        wide = zip([T[0], *T[:-1]], T, [*T[1:], T[-1]], strict=True)
        flows = [p.k * (before - 2 * here + after) for before, here, after in wide]
        return (flows[0] + 10 * u.power, *flows[1:])

    def output(self, x, u, p):
        return (x.T69,)


def test_a_front_from_rest_is_followed_and_so_are_many_derivatives():
    """Far from the heater the states grow from zero by dozens of decades."""
    # The states, the power, and what it changes by.
    linear = np.zeros((72, 72))
    linear[:70, :70] = 100 * (np.eye(70, k=1) + np.eye(70, k=-1) - 2 * np.eye(70))
    linear[0, 0] = linear[69, 69] = -100
    linear[0, 70], linear[70, 71] = 10, 1
    exact = expm(linear)[:70, 71]
    rest, warm, k, start = np.zeros(70), np.eye(70, 1), ca.MX.sym("k"), ca.MX.sym("start", 70)
    end = stepped(dynamics(Rod()), Radau(), 1)(start, 0.5, 1.0, k, 1.0)
    run = ca.Function("run", [start, k], [end, dense_jacobian(end, ca.vertcat(start, k))])
    ends, slopes = (value.full() for value in run(rest, 100.0))
    assert_allclose(ends[:, 0], exact, rtol=1e-6, atol=1e-8 * ends.max())
    # The model is linear in its states.
    assert_allclose(slopes[:, :1], run(warm, 100.0)[0].full() - ends, atol=1e-8)
    difference = (run(rest, 100.01)[0] - run(rest, 99.99)[0]).full() / 0.02
    assert_allclose(slopes[:, 70:], difference, atol=1e-8)


class Draining(gb.StateSpace):
    """A tank that is empty after a finite time, beyond which its formula has no value."""

    states, inputs, outputs = ("level",), ("u",), ("level",)

    def derivative(self, x, u, p):
        return (-gb.sqrt(x.level) - 0.1,)

    def output(self, x, u, p):
        return (x.level,)


def test_a_step_out_of_the_domain_of_a_formula_gives_nan():
    drained = stepped(dynamics(Draining()), Radau(), 4)
    assert np.isnan(float(drained(0.5, 0.0, 0.0, [], 20.0)))
