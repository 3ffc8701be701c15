"""Least squares over several equations, against the formulas written out with full matrices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from greybox.regression.least_squares import (
    Block,
    residuals,
    solve,
    spread,
    undetermined,
)

TRUTH = np.array([2.0, -30.0, 0.004])
WIDE = np.full(3, np.inf)


def blocks(noise=0.0, sizes=(40, 25, 60), seed=0):
    """Two equations, the first over two stretches; the columns differ in size by five decades."""
    random = np.random.default_rng(seed)
    result = []
    for equation, n in zip((0, 0, 1), sizes, strict=True):
        slopes = random.normal(size=(n, 3)) * [1.0, 0.01, 1e3]
        base = random.normal(size=n)
        result.append(
            Block(equation, base + slopes @ TRUTH + noise * random.normal(size=n), base, slopes)
        )
    return result


def stacked(parts, weights):
    X = np.vstack([weights[b.equation] * b.slopes for b in parts])
    return X, np.concatenate([weights[b.equation] * (b.target - b.base) for b in parts])


def test_the_solution_is_that_of_the_stacked_equations():
    parts, weights = blocks(noise=0.5), np.array([1.0, 7.0])
    X, y = stacked(parts, weights)
    assert_allclose(
        solve(parts, weights, -WIDE, WIDE), np.linalg.lstsq(X, y, rcond=None)[0], rtol=1e-10
    )
    assert_allclose(solve(blocks(), weights, -WIDE, WIDE), TRUTH, rtol=1e-12)


def test_bounds_hold_and_the_rest_is_the_best_within_them():
    parts, weights = blocks(noise=0.5), np.ones(2)
    low, high = np.array([-np.inf, -20.0, -np.inf]), np.array([1.5, np.inf, np.inf])
    found = solve(parts, weights, low, high)
    X, y = stacked(parts, weights)
    scale = np.array([1.0, 100.0, 1e-3])
    best = minimize(
        lambda z: np.sum((X @ (z * scale) - y) ** 2),
        np.array([1.0, 0.0, 0.0]),
        bounds=list(zip(low / scale, high / scale, strict=True)),
        tol=1e-14,
    )
    assert_allclose(found[:2], [1.5, -20.0])
    assert_allclose(found, best.x * scale, rtol=1e-4)
    # What ends at a bound is not beyond it by rounding, and a single bound holds as both do.
    assert np.all((found >= low) & (found <= high))
    for least, most in ((low, WIDE), (-WIDE, high)):
        found = solve(parts, weights, least, most)
        assert np.all((found >= least) & (found <= most))
        assert np.any((found == least) | (found == most))


def test_a_column_of_zeros_has_the_unknown_zero():
    parts, weights = blocks(noise=0.5), np.array([1.0, 7.0])
    wider = [
        Block(b.equation, b.target, b.base, np.insert(b.slopes, 1, 0.0, axis=1)) for b in parts
    ]
    wanted = np.insert(solve(parts, weights, -WIDE, WIDE), 1, 0.0)
    assert_allclose(
        solve(wider, weights, np.full(4, -np.inf), np.full(4, np.inf)),
        wanted,
        rtol=1e-10,
        atol=1e-9,
    )
    none = [Block(b.equation, b.target, b.base, b.slopes[:, :0]) for b in parts]
    assert solve(none, weights, np.zeros(0), np.zeros(0)).shape == (0,)


def test_what_has_no_effect_is_named_alone_and_in_combination():
    parts = [
        Block(b.equation, b.target, b.base, np.column_stack([b.slopes, 0 * b.base]))
        for b in blocks()
    ]
    assert undetermined(parts) == [(3,)]
    doubled = [
        Block(
            b.equation,
            b.target,
            b.base,
            np.column_stack([b.slopes, 3e-5 * b.slopes[:, 2] - b.slopes[:, 0]]),
        )
        for b in blocks()
    ]
    assert undetermined(doubled) == [(0, 2, 3)]
    assert undetermined(blocks()) == []


def test_spread_is_the_rms_of_an_equation():
    parts = blocks(noise=0.5)
    errors = residuals(parts, TRUTH)
    first, second = np.concatenate(errors[:2]), errors[2]
    assert_allclose(
        spread(parts, errors), [np.sqrt(np.mean(first**2)), np.sqrt(np.mean(second**2))]
    )
    exact = spread(parts, [0 * e for e in errors])
    assert np.all((exact > 0) & (exact < 1e-10))
    empty = [Block(0, np.zeros(5), np.zeros(5), np.ones((5, 1)))]
    assert spread(empty, [np.zeros(5)]).tolist() == [1.0]  # of nothing, any would do


@pytest.mark.parametrize(("angle", "is_undetermined"), [(1.8e-7, True), (2.2e-7, False)])
def test_columns_nearer_than_the_root_of_the_rounding_are_one(angle, is_undetermined):
    """Of two unit columns at an angle, the singular values are the roots of 1 ± cos: their ratio is half of it."""
    first = np.array([3.0, 4.0, 0.0])
    second = 70 * (np.cos(angle) * first + np.sin(angle) * np.array([-4.0, 3.0, 0.0]))
    slopes = np.column_stack([first, [0.0, 0.0, 1e-3], second])
    made = [Block(0, np.ones(3), np.zeros(3), slopes)]
    assert undetermined(made) == ([(0, 2)] if is_undetermined else [])
