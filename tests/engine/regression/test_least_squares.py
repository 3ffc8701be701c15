"""Least squares over several equations, against the formulas written out with full matrices."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from greybox.engine.regression.least_squares import Rows, undetermined

TRUTH = np.array([2.0, -30.0, 0.004])
WIDE = np.full(3, np.inf)


def rows(noise=0.0, sizes=(65, 60), seed=0):
    """Two equations; the columns differ in size by five decades."""
    random = np.random.default_rng(seed)
    n = sum(sizes)
    slopes = random.normal(size=(n, 3)) * [1.0, 0.01, 1e3]
    base = random.normal(size=n)
    target = base + slopes @ TRUTH + noise * random.normal(size=n)
    return Rows(np.repeat([0, 1], sizes), target, base, slopes)


def stacked(made, weights):
    each = weights[made.equation]
    return each[:, None] * made.slopes, each * (made.target - made.base)


def test_the_solution_is_that_of_the_stacked_equations():
    made, weights = rows(noise=0.5), np.array([1.0, 7.0])
    X, y = stacked(made, weights)
    wanted = np.linalg.lstsq(X, y, rcond=None)[0]
    assert_allclose(made.solution(weights, -WIDE, WIDE), wanted, rtol=1e-10)
    assert_allclose(rows().solution(weights, -WIDE, WIDE), TRUTH, rtol=1e-12)


def test_bounds_hold_and_the_rest_is_the_best_within_them():
    made, weights = rows(noise=0.5), np.ones(2)
    low, high = np.array([-np.inf, -20.0, -np.inf]), np.array([1.5, np.inf, np.inf])
    solution = made.solution(weights, low, high)
    X, y = stacked(made, weights)
    scale = np.array([1.0, 100.0, 1e-3])
    best = minimize(
        lambda z: np.sum((X @ (z * scale) - y) ** 2),
        np.array([1.0, 0.0, 0.0]),
        bounds=list(zip(low / scale, high / scale, strict=True)),
        tol=1e-14,
    )
    assert_allclose(solution[:2], [1.5, -20.0])
    assert_allclose(solution, best.x * scale, rtol=1e-4)
    # What ends at a bound is not beyond it by rounding, and a single bound holds as both do.
    assert np.all((solution >= low) & (solution <= high))
    for least, most in ((low, WIDE), (-WIDE, high)):
        solution = made.solution(weights, least, most)
        assert np.all((solution >= least) & (solution <= most))
        assert np.any((solution == least) | (solution == most))


def test_a_column_of_zeros_has_the_unknown_zero():
    made, weights = rows(noise=0.5), np.array([1.0, 7.0])
    wider = replace(made, slopes=np.insert(made.slopes, 1, 0.0, axis=1))
    wanted = np.insert(made.solution(weights, -WIDE, WIDE), 1, 0.0)
    solution = wider.solution(weights, np.full(4, -np.inf), np.full(4, np.inf))
    assert_allclose(solution, wanted, rtol=1e-10, atol=1e-9)
    none = replace(made, slopes=made.slopes[:, :0])
    assert none.solution(weights, np.zeros(0), np.zeros(0)).shape == (0,)


def test_what_has_no_effect_is_named_alone_and_in_combination():
    slopes = rows().slopes
    assert undetermined(slopes) == []
    assert undetermined(np.column_stack([slopes, 0 * slopes[:, 0]])) == [(3,)]
    combination = 3e-5 * slopes[:, 2] - slopes[:, 0]
    assert undetermined(np.column_stack([slopes, combination])) == [(0, 2, 3)]


def test_spread_is_the_rms_of_an_equation():
    made = rows(noise=0.5)
    errors = made.errors(TRUTH)
    assert_allclose(errors, made.target - made.base - made.slopes @ TRUTH)
    wanted = [np.sqrt(np.mean(errors[made.equation == k] ** 2)) for k in (0, 1)]
    assert_allclose(made.spread(errors, 2), wanted)
    exact = made.spread(0 * errors, 2)
    assert np.all((exact > 0) & (exact < 1e-10))
    # Without target or rows, any number would do.
    empty = Rows(np.zeros(5, int), np.zeros(5), np.zeros(5), np.ones((5, 1)))
    assert empty.spread(np.zeros(5), 2).tolist() == [1.0, 1.0]


@pytest.mark.parametrize(("angle", "is_undetermined"), [(1.8e-7, True), (2.2e-7, False)])
def test_columns_nearer_than_the_root_of_the_rounding_are_one(angle, is_undetermined):
    """Of two unit columns at an angle, the singular values are the roots of 1 ± cos: their ratio is half of it."""
    first = np.array([3.0, 4.0, 0.0])
    second = 70 * (np.cos(angle) * first + np.sin(angle) * np.array([-4.0, 3.0, 0.0]))
    slopes = np.column_stack([first, [0.0, 0.0, 1e-3], second])
    assert undetermined(slopes) == ([(0, 2)] if is_undetermined else [])
