"""Constraints of a search from many points: minima by hand and by scipy, on both sides of what parts the box."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from greybox.solve.augmented_lagrangian import FEASIBLE, ConstrainedNewton
from greybox.solve.batched_newton import INSIDE


def constrained(cost, limits, lower=(-4.0, -4.0), upper=(4.0, 4.0), origin=(0.1, 0.2)):
    z, smoothing = ca.SX.sym("z", 2), ca.SX.sym("smoothing")
    program = ca.Function("f", [z, smoothing], [cost(z), ca.vertcat(*limits(z))])
    return ConstrainedNewton(program, np.array(lower), np.array(upper), np.array(origin))


def searched(solver, points, **options):
    return solver.minimize(np.array(points, float).T, max_iterations=200, tolerance=1e-9, **options)


def target(z):
    """Least at (3, -1), without constraints."""
    return (z[0] - 3) ** 2 + 2 * (z[1] + 1) ** 2 + 0.5 * (z[0] - 3) * (z[1] + 1)


POINTS = [(-3, -3), (0.5, 0.1), (2, 3), (-1, 3.5), (3.5, -3.5)]


@pytest.mark.parametrize("scale", [1.0, 1e4, 1e-4])
@pytest.mark.parametrize("from_near", [False, True])
def test_the_minimum_under_constraints_is_that_of_scipy_in_any_unit_of_theirs(scale, from_near):
    """A circle that is active, a line that is not, and a product."""

    def limits(z):
        return scale * (4 - z[0] ** 2 - z[1] ** 2), z[0] - z[1] + 3, 5 - z[0] * z[1]

    wanted = minimize(
        target,
        (1, 0),
        constraints=[
            {"type": "ineq", "fun": lambda z, k=k: limits(z)[k] / scale} for k in range(3)
        ],
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 300},
    ).x
    assert np.hypot(*wanted) == pytest.approx(2)
    ends = searched(constrained(target, limits), POINTS, from_near=from_near)
    assert ends.at_minimum.all()
    assert_allclose(ends.z, np.tile(wanted[:, None], len(POINTS)), atol=2e-6)
    assert np.all(ends.iterations >= 2)


def test_constraints_that_hold_nothing_change_nothing():
    """The multiplier of the barrier goes to zero where its constraint is far, so that the end is exact."""
    ends = searched(constrained(target, lambda z: (z[0] + 5, 9 - z[1])), POINTS)
    assert ends.at_minimum.all()
    assert_allclose(ends.z, np.tile([[3], [-1]], len(POINTS)), atol=1e-7)


def test_a_minimum_between_a_constraint_and_a_bound():
    """Where z0 + 2 z1 >= 3 and z1 <= 0.8: the corner (1.4, 0.8) of a cost that falls toward lower z0 and z1."""
    solver = constrained(
        lambda z: (z[0] + 1) ** 2 + (z[1] + 5) ** 2 / 8,
        lambda z: (z[0] + 2 * z[1] - 3,),
        upper=(4, 0.8),
    )
    ends = searched(solver, [(3.5, 0.7), (-2, -2)])
    assert ends.at_minimum.all()
    assert_allclose(ends.z, np.tile([[1.4], [0.8]], 2), atol=1e-7)


def test_searches_end_on_their_side_of_what_parts_the_box():
    """z0 z1 >= 1 leaves two parts, each with a minimum on its hyperbola; a start between them goes to the nearest."""
    solver = constrained(
        lambda z: z[0] ** 2 + 4 * z[1] ** 2 + z[0], lambda z: (z[0] * z[1] - 1,), origin=(1, 2)
    )
    ends = searched(solver, [(2, 3), (3, 0.5), (-3, -1), (-0.5, -3.5), (0.2, 0.1), (-0.1, -0.3)])
    assert ends.at_minimum.all()
    sides = []
    for sign in (1, -1):
        # On the hyperbola: z0² + 4 / z0² + z0, whose derivative times z0³ / 1 is 2 z0⁴ + z0³ - 8.
        roots = np.roots([2, 1, 0, 0, -8])
        real = roots[np.abs(roots.imag) < 1e-12].real
        z0 = float(real[real * sign > 0][0])
        sides.append([z0, 1 / z0])
    assert_allclose(ends.z.T, [sides[k] for k in (0, 0, 1, 1, 0, 1)], atol=1e-6)


def test_what_cannot_be_met_is_no_minimum():
    solver = constrained(target, lambda z: (z[0] - 1, -1 - z[0]))
    ends = searched(solver, POINTS)
    assert not ends.at_minimum.any()


@pytest.mark.parametrize("level", [0.5, 2.0])
def test_a_constraint_may_be_missed_by_a_hundred_millionth(level):
    """In units of its slope at the origin, which is 5 here."""
    ends = searched(constrained(target, lambda z: (3 * (level - z[0]) - 4 * (z[1] + 1),)), POINTS)
    assert ends.at_minimum.all()
    missed = -(3 * (level - ends.z[0]) - 4 * (ends.z[1] + 1)) / 5
    assert np.all(missed <= FEASIBLE)
    # KKT: the gradient is the normal times a multiplier that is positive.
    x, y = ends.z - np.array([[3.0], [-1.0]])
    gradient = np.array([2 * x + 0.5 * y, 4 * y + 0.5 * x])
    assert_allclose(gradient[0] * 4, gradient[1] * 3, atol=1e-6)
    assert np.all(gradient[0] < 0)


def test_the_function_that_is_minimized_is_the_augmented_lagrangian_or_has_a_barrier():
    """(z0 - 3)² + z1² where 5 (1 - z0) >= 0, whose slope of five is put to one: minima by hand."""
    solver = constrained(lambda z: (z[0] - 3) ** 2 + z[1] ** 2, lambda z: (5 * (1 - z[0]),))

    def least(barrier, penalty, multiplier):
        given = np.array([[barrier], [penalty], [multiplier]])
        begin = np.array([[0.5], [0.3]])
        found = solver._newton.minimize(
            begin, max_iterations=99, tolerance=1e-12, from_near=True, given=given
        )
        assert found.at_minimum.all()
        return found.z[:, 0]

    # 2 (z - 3) + λ - ρ (1 - z) = 0 where the multiplier is not exhausted.
    assert_allclose(least(0, 10, 2), [(6 - 2 + 10) / 12, 0], atol=1e-9)
    assert_allclose(least(0, 7, 0.3), [(6 - 0.3 + 7) / 9, 0], atol=1e-9)
    # 2 (z - 3) + b / (1 - z) = 0, on the side of the constraint, with a multiplier of zero that
    # adds nothing there.
    assert_allclose(least(0.5, 10, 0), [2 - np.sqrt(1 + 0.25), 0], atol=1e-9)


def test_after_the_barrier_multipliers_are_those_that_it_stands_for(monkeypatch):
    """Of a search that began where constraints are met; elsewhere it begins without."""
    solver = constrained(
        lambda z: (z[0] - 3) ** 2 + z[1] ** 2, lambda z: (5 * (1 - z[0]), 2 * (z[1] + 3))
    )
    met = []
    monkeypatch.setattr(
        solver, "_meet", lambda ends, multipliers, *limits: met.append((ends, multipliers))
    )
    searched(solver, [(0.2, 0.5), (0.8, -0.1)])
    ((ends, multipliers),) = met
    inside = 1 - ends.z[0]
    assert np.all(
        (inside > 0) & (inside < 1e-4)
    )  # where the barrier of 1e-4 pulls as much as the slope of 4 pushes
    assert_allclose(multipliers, [1e-4 / inside, 1e-4 / (ends.z[1] + 3)])
    assert_allclose(multipliers[0], 4, rtol=0.05)
    assert np.all(ends.iterations > 2)


def test_points_where_constraints_are_missed_move_to_the_nearest_ones_inside():
    solver = constrained(target, lambda z: (5 * (1 - z[0]), z[0] + z[1] + 3))
    points = np.array([[1.3, 2.0], [1.0, -0.5], [0.5, 0.3], [3.5, -1.0], [-2.5, -2.5]]).T
    moved = solver._moved_inside(points, 50)
    # By a hundredth, in units of the slopes, which are 5 and the root of two.
    assert_allclose(moved[:, 0], [1 - INSIDE, 2.0], atol=1e-6)
    assert_allclose(moved[:, 1], [1 - INSIDE, -0.5], atol=1e-6)
    assert moved[:, 2].tolist() == [0.5, 0.3]
    assert_allclose(moved[:, 3], [1 - INSIDE, -1.0], atol=1e-6)
    assert_allclose(moved[:, 4], np.full(2, (INSIDE * np.sqrt(2) - 3) / 2), atol=1e-6)
