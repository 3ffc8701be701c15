"""Constraints of fits in time.

Starts that miss them, curved ones, and every method the same answer.
"""

import casadi as ca
import numpy as np
import pytest
from unfinished_runs import without_continued_runs

import greybox as gb
from greybox.engine.compiled.compiled_problem import compile_problem
from greybox.engine.solve.constraints import Limits, constraints_of
from greybox.engine.solve.gauss_newton.driver import GaussNewton

pytestmark = pytest.mark.usefixtures("unjudged_file")


class Lag(gb.StateSpace):
    """First-order lag."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.01, 50), unit="1/s", about="pole")
    b = gb.Parameter(1.0, bounds=(-50, 50), unit="1/s", about="gain")

    def derivative(self, x, u, p):
        return (-p.a * x.x + p.b * u.u,)

    def output(self, x, u, p):
        return (x.x,)


HELD = gb.OutputError(inputs="held")
METHODS = [
    gb.MultipleShooting(),
    gb.MultipleShooting(ipopt=True),
    gb.MultipleShooting(hessian="exact"),
    gb.SingleShooting(),
    gb.Collocation(),
]


def record(samples=80, step=0.05, a=2.0, b=3.0, noise=0.1):
    """Return a record of the lag, its response to held inputs in closed form."""
    random = np.random.default_rng(0)
    u = np.repeat(random.normal(size=samples // 10 + 1), 10)[:samples]
    y, decay = np.zeros(samples), np.exp(-a * step)
    for k in range(samples - 1):
        y[k + 1] = decay * y[k] + b / a * (1 - decay) * u[k]
    return gb.Record(
        np.arange(samples) * step, {"u": u, "y": y + noise * random.normal(size=samples)}
    )


@pytest.fixture(scope="module")
def tied():
    problem = gb.Problem(Lag(), record(), HELD, tied={"b": lambda p: 1.6 * p.a})
    return gb.fit(problem, starts=1, profiles=False)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
def test_a_start_that_misses_the_constraint_is_led_back_to_it(method, tied):
    """The declared start misses b >= 1.6 a, and so does the truth.

    The tie b = 1.6 a has the same minimum.
    """
    fit = gb.fit(
        gb.Problem(Lag(), record(), HELD, constraints=[lambda p: p.b - 1.6 * p.a]),
        starts=2,
        method=method,
        profiles=False,
    )
    assert fit.agreeing == 2
    assert fit.estimate["b"] >= 1.6 * fit.estimate["a"] - 1e-6
    assert fit.estimate["a"] == pytest.approx(tied.estimate["a"], rel=1e-4)
    assert fit.cost == pytest.approx(tied.cost, abs=1e-4)
    assert fit.standard_error["a"] == pytest.approx(tied.standard_error["a"], rel=1e-3)


def test_a_curved_constraint_is_kept():
    """On the circle a² + b² = 9 the cost is minimized by hand, over the angle."""
    data = record(1200)
    fit = gb.fit(
        gb.Problem(Lag(), data, HELD, constraints=[lambda p: 9 - p.a**2 - p.b**2]),
        starts=2,
        profiles=False,
    )
    angle = np.arctan2(fit.estimate["b"], fit.estimate["a"])
    assert fit.agreeing == 2
    assert np.hypot(fit.estimate["a"], fit.estimate["b"]) == pytest.approx(3, rel=1e-6)
    problem = gb.Problem(Lag(), data, HELD)
    beside = [
        gb.cost(problem, {"a": 3 * np.cos(t), "b": 3 * np.sin(t)})
        for t in (angle - 1e-3, angle, angle + 1e-3)
    ]
    assert beside[1] <= min(beside[0], beside[2])


def test_constraints_that_contradict_one_another_are_no_answer():
    """Nothing can be converged where the constraints leave no point."""
    nothing = [lambda p: p.a - 3, lambda p: 2 - p.a]
    # Two thousand more iterations would find no point either.
    problem = gb.Problem(Lag(), record(), HELD, constraints=nothing)
    with without_continued_runs():
        fit = gb.fit(problem, starts=1)
    assert not fit.converged


def test_an_end_that_violates_the_constraints_is_no_answer_however_it_was_reached():
    solver = GaussNewton(compile_problem(gb.Problem(Lag(), record(), HELD)))
    z = ca.SX.sym("z", 2)
    never = ca.Function("never", [z], [ca.SX(1.0)])  # which would have to be zero
    reached = solver.run(np.array([1.0, 1.0]))
    end = solver.within(solver.limits.low, solver.limits.high, never).run(reached.estimate)
    assert (reached.status, reached.converged) == ("converged", True)
    assert not end.converged


def test_the_nearest_point_keeps_bounds_and_constraints():
    """Of (2, 2) on the line x + y = 1 within the unit square, and a point that keeps all stays."""
    z = ca.SX.sym("z", 2)
    constraint = 1 - z[0] - z[1]
    limits = Limits(
        np.zeros(2),
        np.ones(2),
        constraints_of(constraint, z),
    )
    assert limits.nearest(np.array([2.0, 2.0])) == pytest.approx([0.5, 0.5])
    assert limits.nearest(np.array([0.2, 0.3])) == pytest.approx([0.2, 0.3])
    assert limits.violation(np.array([1.0, 1.0])) == pytest.approx(1.0)


def test_steps_are_limited_by_bounds_and_constraints_but_of_variables_that_are_held():
    """x + y <= 1, 0 <= x, y <= 1.

    Rows of x and y upward, downward, and the constraint, from (0.25, 1.5).
    """
    z = ca.SX.sym("z", 2)
    constraint = 1 - z[0] - z[1]
    limits = Limits(
        np.zeros(2),
        np.array([1.0, np.inf]),
        constraints_of(constraint, z),
    )
    normals, least = limits.linearized(np.array([0.25, 1.5]))
    assert normals.tolist() == [[1, 0], [0, 1], [-1, 0], [-1, -1]]
    assert least == pytest.approx([-0.25, -1.5, -0.75, 0.75])
    normals, least = limits.linearized(np.array([0.25, 1.5]), np.array([False, True]))
    assert normals.tolist() == [[1, 0], [0, 1], [-1, 0], [0, -1], [-1, -1]]
    assert least == pytest.approx([-0.25, 0.0, -0.75, 0.0, 0.75])
    # What is beyond a bound by rounding is not moved back to it.
    _, least = limits.linearized(np.array([1.0 + 1e-9, -1e-9]))
    assert least[:3] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-8)
    assert least[1] == least[2] == 0


def test_a_step_ends_within_the_bounds_and_on_one_that_it_nearly_reaches():
    z = ca.SX.sym("z", 3)
    limits = Limits(np.zeros(3), np.ones(3), constraints_of(ca.SX(0, 1), z))
    there = limits.after(np.array([0.5, 0.5, 0.5]), np.array([-0.5 + 1e-17, 0.9, 0.25]))
    assert there.tolist() == [0.0, 1.0, 0.75]
    assert limits.after(np.array([0.5, 0.5, 0.5]), np.array([-0.4, 0.4, 0.0])) == pytest.approx(
        [0.1, 0.9, 0.5]
    )
    # Rounding in the last steps does not leave a bound, either.
    held = limits.after(np.array([0.0, 0.5, 0.5]), np.array([4e-17, 1e-9, 0.0]))
    assert held[0] == 0.0
