"""Newton's method from many points at once.

Where searches begin, what each is given, when they end.
"""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from greybox.engine.compiled.vectorized import second_order
from greybox.engine.solve.barrier_levels import SMOOTHINGS
from greybox.engine.solve.batched_newton import BatchedNewton
from greybox.engine.solve.interruption import limited

FAR = np.full(2, 9.0)


def newton(cost, lower=-FAR, upper=FAR, given=0):
    """Of a cost (z, smoothing, given) of two variables."""
    inputs = [ca.SX.sym("z", 2), ca.SX.sym("smoothing"), ca.SX.sym("given", given)]
    return BatchedNewton(second_order(inputs, cost(*inputs[: 3 if given else 2])), lower, upper)


def bowl(z, smoothing):
    return (z[0] - 1) ** 2 + 3 * (z[1] + 0.5) ** 2 + 0.5 * z[0] * z[1] + 4


LOWEST = -np.linalg.solve([[2, 0.5], [0.5, 6]], [-2, 3])


def test_searches_begin_a_hundredth_of_the_interval_inside_the_bounds():
    lower, upper = np.array([-3.0, -np.inf]), np.array([5.0, 7.0])
    z = np.array([[-4.0, 5.0, 1.0], [2.0, 6.0, -90.0]])
    begun = newton(bowl, lower, upper).minimize(z, max_iterations=0, tolerance=1e-9)
    assert_allclose(begun.z, [[-2.92, 4.92, 1.0], [2.0, 6.0, -90.0]])
    assert_array_equal(begun.iterations, 0)
    assert not begun.at_minimum.any()
    near = newton(bowl, lower, upper).minimize(z, max_iterations=0, tolerance=1e-9, from_near=True)
    assert_allclose(near.z, [[-3.0, 5.0, 1.0], [2.0, 6.0, -90.0]])


def test_one_step_leads_to_the_minimum_of_a_quadratic_nearby():
    """Within the first radius of one; farther away more of them do, each as it would alone."""
    near, far = LOWEST + np.array([0.3, -0.4]), LOWEST + np.array([6.0, 5.0])
    points = np.transpose([near, far, LOWEST])
    ends = newton(bowl).minimize(points, max_iterations=50, tolerance=1e-9, from_near=True)
    assert_allclose(ends.z, np.tile(LOWEST[:, None], 3), atol=1e-9)
    assert ends.at_minimum.all()
    # Steps of one, of three times that, and the rest.
    assert ends.iterations.tolist() == [1, 3, 0]
    alone = newton(bowl).minimize(far[:, None], max_iterations=50, tolerance=1e-9, from_near=True)
    assert alone.iterations.tolist() == [3]
    cut = newton(bowl).minimize(points, max_iterations=2, tolerance=1e-9, from_near=True)
    assert cut.at_minimum.tolist() == [True, False, True]
    assert cut.iterations.tolist() == [1, 2, 0]
    assert np.linalg.norm(cut.z[:, 1] - far) > 1


@pytest.mark.parametrize("count", [1, 3, 8, 150])
def test_every_search_has_what_is_given_for_it_however_many_are_left(count):
    """Powers of unlike curvature end at unlike times.

    The places of the others must not change with them.
    """
    random = np.random.default_rng(count)
    given = np.array(
        [random.uniform(-3, 3, count), random.uniform(-3, 3, count), random.uniform(0, 8, count)]
    )

    def cost(z, smoothing, given):
        x, y = z[0] - given[0], z[1] - given[1]
        return ca.cosh(given[2] * x) + 0.5 * y**2 + 0.1 * x * y

    solver = newton(cost, given=3)
    begin = given[:2] + random.uniform(-0.9, 0.9, (2, count))
    ends = solver.minimize(begin, max_iterations=100, tolerance=1e-10, from_near=True, given=given)
    convex = given[2] ** 2 > 0.01  # elsewhere it falls without end
    assert ends.at_minimum[convex].all()
    assert_allclose(ends.z[:, convex], given[:2, convex], atol=1e-7)
    if count > 3:
        assert len(set(ends.iterations.tolist())) > 3
    for k in (0, count - 1):
        own = solver.minimize(
            begin[:, k : k + 1],
            max_iterations=100,
            tolerance=1e-10,
            from_near=True,
            given=given[:, k : k + 1],
        )
        assert_allclose(own.z[:, 0], ends.z[:, k], atol=1e-8)
        assert own.iterations[0] == ends.iterations[k]


def test_nothing_is_searched_from_nowhere():
    ends = newton(bowl).minimize(np.zeros((2, 0)), max_iterations=9, tolerance=1e-9)
    assert (ends.z.shape, ends.at_minimum.shape, ends.iterations.shape) == ((2, 0), (0,), (0,))


def test_a_search_from_afar_is_kept_off_its_bounds_until_the_last_level():
    """A cost that falls toward a bound, and rises beyond a ridge of the width of the barrier.

    Both ends are its.
    """
    lower, upper = np.array([0.0, -1.0]), np.array([1.0, 1.0])
    solver = newton(lambda z, smoothing: z[0] + (z[1] - 0.25) ** 2, lower, upper)
    ends = solver.minimize(np.array([[0.9, 0.2], [0.5, -0.5]]), max_iterations=60, tolerance=1e-9)
    assert ends.at_minimum.all()
    assert_allclose(ends.z, [[0, 0], [0.25, 0.25]], atol=1e-9)
    assert np.all(ends.iterations > 4)  # four levels


def test_the_smoothing_of_the_last_level_is_that_of_every_solver():
    """At a minimum of |z - 1| rounded off, and another unrounded one.

    Where it is tells the smoothing.
    """
    solver = newton(
        lambda z, smoothing: ca.sqrt((z[0] - 1) ** 2 + smoothing) + 0.6 * z[0] + (z[1] - z[0]) ** 2
    )
    ends = solver.minimize(np.array([[3.0, -2.0], [0.0, 0.0]]), max_iterations=200, tolerance=1e-10)
    # The slope u / sqrt(u² + s) is -0.6 where u = -0.75 sqrt(s).
    assert_allclose(ends.z[0] - 1, -0.75 * np.sqrt(1e-8), rtol=1e-3)


def test_a_search_passes_through_the_levels_one_after_the_other():
    """Of a quadratic whose minimum tells the smoothing.

    A step leads there, and the next one takes the next level.
    """
    solver = newton(
        lambda z, smoothing: 100 * (z[0] - 0.5 * smoothing) ** 2 + 90 * (z[1] - smoothing) ** 2,
        np.full(2, -np.inf),
        np.full(2, np.inf),
    )
    reached = [
        solver.minimize(np.array([[0.9], [0.3]]), max_iterations=most, tolerance=1e-10).z[:, 0]
        for most in range(1, 8)
    ]
    wanted = [SMOOTHINGS[level] * np.array([0.5, 1.0]) for level in (0, 0, 1, 1, 2, 2, 3)]
    assert_allclose(reached, wanted, atol=1e-12)
    last = solver.minimize(
        np.array([[0.9], [0.3]]), max_iterations=1, tolerance=1e-10, from_near=True
    )
    assert_allclose(last.z[:, 0], SMOOTHINGS[3] * np.array([0.5, 1.0]), atol=1e-12)
    for level in range(3):
        ends = solver.minimize(
            np.array([[0.9], [0.3]]), max_iterations=50, tolerance=1e-10, last=level
        )
        assert_allclose(ends.z[:, 0], SMOOTHINGS[level] * np.array([0.5, 1.0]), atol=1e-12)
        assert ends.iterations.tolist() == [2 * level + 1]


def test_when_time_is_up_searches_stay_where_they_are():
    begin = LOWEST[:, None] + np.array([[0.2], [0.2]])
    with limited(0.0):
        ends = newton(bowl).minimize(begin, max_iterations=50, tolerance=1e-9, from_near=True)
    assert_array_equal(ends.z, begin)
    assert (ends.at_minimum.tolist(), ends.iterations.tolist()) == ([False], [0])
