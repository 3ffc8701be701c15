"""One iteration of many searches, number by number.

What is taken, how far the next step may go, when it ends.
"""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.engine.solve.barrier_levels import LAST
from greybox.engine.solve.newton_iteration import (
    COST,
    END,
    IS_NEWTON,
    ITERATIONS,
    LEVEL,
    RADIUS,
    SWITCHED,
    advanced,
    bounded,
    layout,
)

P, LOOSE = 2, 1e-3
ROWS = layout(P)
HESSIAN = np.array([[4.0, 1.0], [1.0, 3.0]])
BEST = np.array([0.5, -0.25])
INF = np.full(P, np.inf)


@cache
def iteration():
    return advanced(P, LOOSE), bounded(P)


def cost_of(z):
    """A quadratic with its gradient."""
    return 7 + 0.5 * (z - BEST) @ HESSIAN @ (z - BEST), HESSIAN @ (z - BEST)


def search(z, trial, *, lower=-INF, upper=INF, **single):
    """The numbers of a search at z that tries another point."""
    numbers = np.zeros(ROWS.size)
    cost, gradient = cost_of(np.asarray(z))
    for row, value in {COST: cost, RADIUS: 1.0, LEVEL: LAST, ITERATIONS: 4, **single}.items():
        numbers[row if isinstance(row, int) else globals()[row]] = value
    numbers[ROWS.z], numbers[ROWS.trial], numbers[ROWS.gradient] = z, trial, gradient
    numbers[ROWS.hessian] = HESSIAN.ravel()
    numbers[ROWS.lower], numbers[ROWS.upper] = lower, upper
    return numbers


def begun(z, level=LAST, **more):
    """The numbers of a search that is taken over to a level."""
    return search(z, z, SWITCHED=1, LEVEL=level - 1, **more)


def after(numbers, cost=None, gradient=None, hessian=HESSIAN, barrier=0.0, tolerance=1e-9):
    """The numbers after the trial was judged, and the Hessian of the variables that no bound holds."""
    found, slope = cost_of(numbers[ROWS.trial])
    cost = found if cost is None else cost
    gradient = slope if gradient is None else gradient
    # Of the Hessian the upper triangle counts.
    numbers, of_free = iteration()[0](
        numbers, barrier, tolerance, cost, gradient, np.triu(hessian).ravel(order="F")
    )
    return numbers.full().ravel(), of_free.full().reshape(P, P)


def test_a_good_step_is_taken_and_the_next_one_is_newtons():
    z, trial = np.zeros(2), np.array([0.3, 0.0])
    numbers, of_free = after(search(z, trial))
    cost, gradient = cost_of(trial)
    assert numbers[COST] == pytest.approx(cost)
    assert_allclose(numbers[ROWS.z], trial)
    assert_allclose(numbers[ROWS.gradient], gradient)
    assert_allclose(numbers[ROWS.hessian].reshape(P, P), HESSIAN)
    assert_allclose(of_free, HESSIAN)
    assert_allclose(numbers[ROWS.trial], BEST)
    assert [numbers[k] for k in (LEVEL, SWITCHED, IS_NEWTON, END, ITERATIONS)] == [LAST, 0, 1, 0, 5]
    assert_allclose(numbers[ROWS.lower], -INF)
    assert_allclose(numbers[ROWS.upper], INF)


@pytest.mark.parametrize(
    ("radius", "share", "wanted"),
    [
        (1.0, 1.0, 1.0),  # a model that holds: three times the step, no less than it was
        (0.2, 1.0, 0.9),
        (0.2, 0.51, 0.9),
        (0.2, 0.3, 0.2),  # between good and poor it stays
        (0.2, 0.09, 0.15),  # a poor one: half the step
    ],
)
def test_the_radius_follows_how_much_of_the_decrease_came_true(radius, share, wanted):
    z, trial = np.zeros(2), np.array([0.3, 0.0])
    before, gradient = cost_of(z)
    modeled = -gradient @ trial - 0.5 * trial @ HESSIAN @ trial
    numbers, _ = after(search(z, trial, RADIUS=radius), cost=before - share * modeled)
    assert numbers[RADIUS] == pytest.approx(wanted)
    assert_allclose(numbers[ROWS.z], trial)


def test_a_radius_grows_to_ten_at_most():
    far = BEST + np.array([30.0, 0.0])
    numbers, _ = after(search(far, BEST + np.array([1.0, 0.0]), RADIUS=8.0))
    assert numbers[RADIUS] == 10


@pytest.mark.parametrize(
    ("rise", "share"), [(1.0, None), (100.0, 0.1), (0.0, 0.5), (np.inf, 0.1), (np.nan, 0.1)]
)
def test_a_failed_step_is_shortened_to_the_minimum_of_the_parabola(rise, share):
    """Through both costs with the slope at the first, between a tenth and half of the step."""
    z, trial = np.zeros(2), np.array([0.3, 0.0])
    before, gradient = cost_of(z)
    promised = -gradient @ trial
    if share is None:
        share = 0.5 * promised / (promised + rise)
    numbers, _ = after(search(z, trial), cost=before + rise, gradient=np.ones(2), hessian=np.eye(2))
    assert numbers[RADIUS] == pytest.approx(share * 0.3)
    assert_allclose(numbers[ROWS.z], z)
    assert numbers[COST] == before
    assert_allclose(numbers[ROWS.gradient], gradient)
    assert_allclose(numbers[ROWS.hessian].reshape(P, P), HESSIAN)
    assert numbers[ITERATIONS] == 5


@pytest.mark.parametrize(("fall", "taken"), [(-0.1, False), (0.1, True)])
def test_a_step_beyond_the_minimum_of_the_model(fall, taken):
    """Uphill it is refused.

    Where the model rises again and the cost falls all the same it is poor.
    """
    z, trial = (
        np.zeros(2),
        np.array([1.1, 0.0]),
    )  # the model falls by 1.93 on the way and rises by 2.42
    before, _ = cost_of(z)
    numbers, _ = after(search(z, trial), cost=before - fall)
    assert_allclose(numbers[ROWS.z], trial if taken else z)
    assert numbers[RADIUS] == pytest.approx(0.55 if taken else 0.5 * 1.925 / 2.025 * 1.1)
    uphill, _ = after(search(z, -trial))
    assert_allclose(uphill[ROWS.z], z)


def test_what_rounding_hides_is_taken():
    """A decrease of a part in 1e12 of the cost cannot be seen in it."""
    z = BEST + np.array([1e-7, 0.0])
    before, _ = cost_of(z)
    numbers, _ = after(search(z, BEST), cost=before * (1 + 1e-15))
    assert_allclose(numbers[ROWS.z], BEST)
    assert numbers[END] == 1


def test_the_barrier_and_its_derivatives():
    """Of one bound below and one above, the others infinite; against differences."""
    lower, upper = np.array([-1.0, -np.inf]), np.array([np.inf, 0.8])
    z, barrier = np.array([0.2, 0.3]), 0.1

    def whole(z):
        return cost_of(z)[0] - barrier * (np.log(z[0] + 1) + np.log(0.8 - z[1]))

    numbers, _ = after(begun(z, 1, lower=lower, upper=upper), barrier=barrier)
    assert numbers[COST] == pytest.approx(whole(z))
    steps = 1e-5 * np.eye(2)
    assert_allclose(
        numbers[ROWS.gradient], [(whole(z + h) - whole(z - h)) / 2e-5 for h in steps], rtol=1e-7
    )
    added = numbers[ROWS.hessian].reshape(P, P) - HESSIAN
    assert_allclose(added, np.diag([barrier / 1.2**2, barrier / 0.5**2]))
    assert (numbers[LEVEL], numbers[SWITCHED], numbers[RADIUS]) == (
        1,
        0,
        1.0,
    )  # taken over, whatever it is


@pytest.mark.parametrize(("level", "reached"), [(0, 0.99), (LAST, 1.0)])
def test_a_step_stops_at_a_bound_and_before_it_where_there_is_a_barrier(level, reached):
    lower, upper = np.array([-2.0, -0.1]), np.array([0.4, 2.0])
    z = np.array([0.3, 0.0])
    numbers, _ = after(begun(z, level, lower=lower, upper=upper))
    assert_allclose(numbers[ROWS.trial], z + reached * np.array([0.1, -0.1]))


def test_a_variable_that_a_bound_holds_stays_and_the_others_go_on_without_it():
    lower, upper = np.array([0.9, -5.0]), np.array([5.0, 5.0])
    z = np.array([0.9, 0.5])  # the cost falls beyond the lower bound
    numbers, of_free = after(begun(z, lower=lower, upper=upper))
    assert_allclose(of_free, np.diag([1.0, 3.0]))
    gradient = cost_of(z)[1]
    assert gradient[0] > 0
    assert_allclose(numbers[ROWS.trial], [0.9, 0.5 - gradient[1] / 3])
    mirrored, of_free = after(begun(z, lower=np.array([-5.0, -5.0]), upper=np.array([0.9, 5.0])))
    assert_allclose(of_free, HESSIAN)
    assert_allclose(mirrored[ROWS.trial], BEST)


@pytest.mark.parametrize(
    ("size", "tolerance", "ends"),
    [(1.0, 1e-3, True), (1.0, 1e-5, False), (1e4, 1e-7, True), (1e4, 1e-9, False)],
)
def test_a_minimum_is_where_the_slope_is_small_beside_the_cost_or_one(size, tolerance, ends):
    z = BEST + np.array([1e-4, 0.0])  # a slope of 4e-4
    numbers, _ = after(begun(z), cost=size, tolerance=tolerance)
    assert numbers[END] == ends
    earlier, _ = after(begun(z, LAST - 1), cost=size, tolerance=tolerance)
    assert earlier[END] == 0
    assert earlier[SWITCHED] == 1  # the next level, from the same point
    assert_allclose(earlier[ROWS.trial], z)
    assert earlier[IS_NEWTON] == 1


def test_a_steep_slope_does_not_change_the_level():
    numbers, _ = after(begun(BEST + np.array([3e-4, 0.0]), 0))
    assert numbers[SWITCHED] == 0


def test_a_radius_of_rounding_ends_the_search():
    z, trial = np.zeros(2), np.array([1e-15, 0.0])
    numbers, _ = after(search(z, trial, RADIUS=1e-15), cost=np.inf)
    assert numbers[END] == -1
    numbers, _ = after(begun(z, RADIUS=2e-15))
    assert numbers[END] == 0


@pytest.mark.parametrize(
    ("hessian", "radius", "is_newton"),
    [
        (HESSIAN, 0.6, True),
        (HESSIAN, 0.5, False),  # Newton's step has the length 0.56
        (np.array([[1.0, 2.0], [2.0, 1.0]]), 10.0, False),  # a saddle
        (np.diag([-1.0, -1.0]), 10.0, False),
    ],
)
def test_newtons_step_is_taken_of_a_convex_model_within_the_radius(hessian, radius, is_newton):
    z = np.zeros(2)
    numbers, _ = after(begun(z, RADIUS=radius), hessian=hessian)
    assert numbers[IS_NEWTON] == is_newton


def test_the_step_down_a_saddle_takes_both_curvatures_as_positive():
    z = np.zeros(2)
    hessian = np.array([[1.0, 2.0], [2.0, 1.0]])
    numbers, of_free = after(begun(z, RADIUS=10.0), hessian=hessian)
    values, vectors = np.linalg.eigh(of_free)
    trial = iteration()[1](numbers, values, vectors.ravel()).full().ravel()
    gradient = cost_of(z)[1]
    assert_allclose(trial, -vectors @ (vectors.T @ gradient / np.abs(values)))
    near, _ = after(begun(z, RADIUS=0.1), hessian=hessian)
    short = iteration()[1](near, values, vectors.ravel()).full().ravel()
    # Of the model with positive curvatures the least within the radius: its gradient and the step
    # are in line.
    assert np.linalg.norm(short) == pytest.approx(0.1, rel=0.05)
    left = gradient + vectors @ (np.abs(values) * (vectors.T @ short))
    assert left @ short == pytest.approx(-np.linalg.norm(left) * np.linalg.norm(short))


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_three_variables(seed):
    random = np.random.default_rng(seed)
    half, gradient = random.normal(size=(3, 3)), random.normal(size=3)
    hessian = half @ half.T + 0.1 * np.eye(3)
    rows = layout(3)
    numbers = np.zeros(rows.size)
    numbers[rows.z] = numbers[rows.trial] = random.normal(size=3)
    numbers[rows.lower], numbers[rows.upper] = -99, 99
    numbers[[RADIUS, LEVEL, SWITCHED]] = 50, LAST - 1, 1
    found = advanced(3, LOOSE)(numbers, 0, 1e-9, 1.0, gradient, np.triu(hessian).ravel(order="F"))
    numbers, of_free = (value.full().ravel() for value in found)
    assert_allclose(of_free.reshape(3, 3), hessian)
    assert_allclose(numbers[rows.trial], numbers[rows.z] - np.linalg.solve(hessian, gradient))

    values, vectors = np.linalg.eigh(hessian)
    for radius in (0.01, 0.1, 0.5):
        numbers[RADIUS] = radius
        step = bounded(3)(numbers, values, vectors.ravel()).full().ravel() - numbers[rows.z]
        assert np.linalg.norm(step) == pytest.approx(radius, rel=0.051)
        left = gradient + hessian @ step
        assert left @ step == pytest.approx(-np.linalg.norm(left) * np.linalg.norm(step), rel=1e-6)


@pytest.mark.parametrize(("flat", "is_newton"), [(2e-10, True), (0.9e-10, False)])
def test_a_curvature_of_rounding_is_none(flat, is_newton):
    """A part in 1e12 of the largest pivot, which is 100 here."""
    hessian = np.diag([100.0, flat])
    numbers, of_free = after(
        begun(np.zeros(2), RADIUS=10.0), gradient=np.array([3.0, 0.0]), hessian=hessian
    )
    assert numbers[IS_NEWTON] == is_newton
    trial = numbers[ROWS.trial]
    if not is_newton:
        values, vectors = np.linalg.eigh(of_free)
        trial = iteration()[1](numbers, values, vectors.ravel()).full().ravel()
    assert_allclose(trial, [-0.03, 0.0], atol=1e-12)


@pytest.mark.parametrize(("length", "is_newton"), [(1.04, True), (1.06, False)])
def test_newtons_step_may_be_a_twentieth_longer_than_the_radius(length, is_newton):
    gradient = -length * 0.7 * HESSIAN @ [0.6, 0.8]
    numbers, _ = after(begun(np.zeros(2), RADIUS=0.7), gradient=gradient)
    assert numbers[IS_NEWTON] == is_newton


@pytest.mark.parametrize(("share", "taken"), [(1.1e-4, True), (0.9e-4, False)])
def test_a_step_is_taken_for_a_ten_thousandth_of_what_the_gradient_promises(share, taken):
    z, trial = np.zeros(2), np.array([0.2, -0.1])
    before, gradient = cost_of(z)
    numbers, _ = after(search(z, trial), cost=before - share * -gradient @ trial)
    assert_allclose(numbers[ROWS.z], trial if taken else z)


@pytest.mark.parametrize(("promised", "taken"), [(0.9e-12, True), (1.1e-12, False)])
def test_what_promises_less_than_rounding_of_the_cost_is_taken(promised, taken):
    """Of a cost of 500, although it rose."""
    z, slope = BEST, np.array([0.01, 0.0])
    numbers = search(z, z - np.array([promised * 500 / 0.01, 0.0]), COST=500.0)
    numbers[ROWS.gradient] = slope
    found, _ = after(numbers, cost=500.001)
    assert (found[ROWS.z][0] < z[0]) == taken


@pytest.mark.parametrize("has_barrier", [True, False])
def test_a_step_that_eigenvalues_tell_stops_at_the_bounds_too(has_barrier):
    """Of the way to a bound 99 hundredths where there is a barrier."""
    lower, upper = np.array([-0.3, -5.0]), np.array([5.0, 0.2])
    hessian = np.array([[-2.0, 0.5], [0.5, 1.0]])
    numbers, of_free = after(
        begun(np.zeros(2), LAST - 2 if has_barrier else LAST, RADIUS=4.0, lower=lower, upper=upper),
        gradient=np.array([3.0, -2.0]),
        hessian=hessian,
    )
    assert numbers[IS_NEWTON] == 0
    values, vectors = np.linalg.eigh(of_free)
    trial = iteration()[1](numbers, values, vectors.ravel()).full().ravel()
    assert_allclose(trial, np.array([-0.3, 0.2]) * (0.99 if has_barrier else 1.0))


def test_a_step_of_one_variable():
    rows = layout(1)
    numbers = np.zeros(rows.size)
    numbers[[RADIUS, LEVEL, SWITCHED]] = 5, LAST - 1, 1
    numbers[rows.z] = numbers[rows.trial] = 0.7
    numbers[rows.lower], numbers[rows.upper] = -9, 9
    found, of_free = advanced(1, LOOSE)(numbers, 0, 1e-9, 3.0, 2.5, 4.0)
    assert float(found[rows.trial]) == pytest.approx(0.7 - 2.5 / 4)
    assert float(of_free) == 4
    numbers = found.full().ravel()
    numbers[RADIUS] = 0.2
    assert float(bounded(1)(numbers, 4.0, 1.0)) == pytest.approx(0.5, abs=0.01)
