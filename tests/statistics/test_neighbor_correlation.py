"""The correlation of neighboring errors: against dense matrices, and whether intervals hold the truth."""

import itertools
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.fft import dct
from scipy.linalg import toeplitz
from scipy.stats import t

import greybox as gb
from greybox.statistics.neighbor_correlation import (
    NeighborCorrelation,
    averaged_meat,
    judged_together,
    neighbor_correlation,
)
from greybox.statistics.neighbor_spectra import error_kinds
from greybox.statistics.student_average import student_of_average


def autoregression(random, rho, n):
    e = random.standard_normal((n, 2)) @ [1, 1j]
    for k in range(1, n):
        e[k] = rho * e[k - 1] + np.sqrt(1 - rho**2) * e[k]
    return e


def design(n):
    """Derivatives of relative errors of a second-order model, (n, 4), by its parameters: smooth functions."""
    s = 1j * np.geomspace(0.1, 10, n)
    den = s**2 + s + 1
    return np.array([np.ones(n), -1 / den, -s / den, -s * 0.05]).T


def stacked(values):
    return np.concatenate([values.real, values.imag])


@pytest.mark.parametrize("inflation", [None, 2.5, 0.4])
def test_weights_are_those_of_the_restricted_likelihood_by_dense_matrices(inflation):
    n = 14
    random = np.random.default_rng(1)
    X = stacked(design(n))
    y = stacked(autoregression(random, 0.7, n))
    y -= X @ np.linalg.lstsq(X, y, rcond=None)[0]
    found = neighbor_correlation(y[:n] + 1j * y[n:], X, inflation)
    scores, squares = [], []
    cosines = dct(np.eye(n), axis=0, norm="ortho")
    _, variances = error_kinds(n)
    for row in variances:
        R = np.kron(np.eye(2), cosines.T @ np.diag(row) @ cosines)
        # Independent numbers of the residuals: what no parameter reaches.
        free = np.linalg.svd(X)[0][:, 4:]
        V = free.T @ R @ free
        squares.append(y @ free @ np.linalg.solve(V, free.T @ y))
        scores.append(np.linalg.slogdet(V)[1])
    squares = np.array(squares) / squares[0]
    if inflation is None:
        size, score = squares, (2 * n - 4) * np.log(squares)
    else:
        size = np.maximum(inflation * squares, 1)
        score = (2 * n - 4) * (np.log(size) + inflation * squares / size)
    score = score + scores
    assert_allclose(found.powers[0], np.eye(1, n)[0], atol=1e-12)
    prior = np.full(len(score), 0.5 / (len(score) - 1))
    prior[0] = 0.5
    weight = prior * np.exp(-(score - score.min()) / 2)
    assert_allclose(found.weight, weight / weight.sum(), rtol=1e-6)
    assert_allclose(found.scale, size / size[0], rtol=1e-8)
    assert found.mean == pytest.approx(found.weight @ found.powers[:, 1])


def test_cosines_are_the_principal_components_of_the_errors():
    """The variances of cosines of errors with these correlations, by dense matrices."""
    n = 60
    cosines = dct(np.eye(n), axis=0, norm="ortho")
    correlations, variances = error_kinds(n)
    for correlation, variance in zip(correlations, variances, strict=True):
        assert variance.mean() == pytest.approx(1, rel=0.05)
        # The whole record, and the one with the longest correlation, are alike.
        found = np.diag(cosines @ toeplitz(correlation) @ cosines.T)
        near = slice(0, 5), slice(5, 20), slice(20, 60)
        if correlation[8] < 0.5:
            assert_allclose(
                [found[part].mean() for part in near],
                [variance[part].mean() for part in near],
                rtol=0.25, atol=0.05,
            )  # fmt: skip


def test_the_meat_of_one_correlation_is_that_of_dense_matrices():
    n = 11
    random = np.random.default_rng(2)
    scores = random.standard_normal((n, 3)) + 1j * random.standard_normal((n, 3))
    J = stacked(scores)
    root = np.linalg.inv(np.linalg.cholesky(J.T @ J)).T
    known = NeighborCorrelation(
        0.6 ** np.arange(n)[None], np.ones(1), np.array([1.7]), np.ones((1, n))
    )
    meat, dof = averaged_meat(scores @ root, known, lambda c: c, 18.0)
    R = np.kron(np.eye(2), toeplitz(0.6 ** np.arange(n)))
    assert_allclose(meat, 1.7 * root.T @ J.T @ R @ J @ root, rtol=1e-9, atol=1e-9)
    assert dof == 18.0


def test_the_meat_of_several_correlations_is_that_of_the_averaged_variances():
    n = 11
    scores = np.random.default_rng(2).standard_normal((n, 3, 2)) @ [1, 1j]
    J = stacked(scores)
    root = np.linalg.inv(np.linalg.cholesky(J.T @ J)).T
    rho, weight, scale = np.array([0.0, 0.5, 0.8]), np.array([0.2, 0.5, 0.3]), np.array([1, 1.4, 3])
    known = NeighborCorrelation(rho[:, None] ** np.arange(n), weight, scale, np.ones((3, n)))

    def dense(correlation):
        return J.T @ np.kron(np.eye(2), toeplitz(correlation)) @ J

    meats = scale[:, None, None] * np.array([dense(row) for row in known.powers])
    variances = np.trace(root.T @ meats @ root, axis1=1, axis2=2)
    variance, few = student_of_average(weight, variances, 18.0)
    meat, dof = averaged_meat(scores @ root, known, lambda c: c, 18.0)
    mean = root.T @ np.tensordot(weight, meats, 1) @ root
    assert_allclose(meat, mean * variance / (weight @ variances), rtol=1e-9, atol=1e-9)
    assert dof == pytest.approx(few, rel=1e-9)


def test_an_average_of_distributions_has_the_same_intervals_at_both_levels():
    weight, variance = np.array([0.5, 0.3, 0.2]), np.array([1.0, 2.0, 9.0])
    found, dof = student_of_average(weight, variance, 40.0)
    for level in (0.6827, 0.95):
        half = t.ppf((1 + level) / 2, dof) * np.sqrt(found)
        inside = weight @ (1 - 2 * t.sf(half / np.sqrt(variance), 40))
        assert inside == pytest.approx(level, abs=1e-6)
    assert dof < 10


def test_scores_of_the_sum_of_magnitudes_are_correlated_as_the_directions_of_errors():
    random = np.random.default_rng(0)
    for rho in (0.3, 0.8):
        a, b = (random.standard_normal((2, 400_000, 2)) @ [1, 1j]).reshape(2, -1)
        b = rho * a + np.sqrt(1 - rho**2) * b
        seen = np.mean((a / np.abs(a) * (b / np.abs(b)).conj()).real)
        assert gb.RelativeError().score_correlation(np.array([rho]))[0] == pytest.approx(
            seen, abs=0.004
        )
    assert_allclose(
        gb.RelativeError().score_correlation(np.array([0.0, 1e-6, 1.0])),
        [0, np.pi / 4e6, 1],
        atol=1e-12,
    )
    assert gb.SquaredRelativeError().score_correlation(np.array([0.3])) == 0.3


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_intervals_hold_the_truth_and_those_of_independent_errors_are_left_alone(rho):
    """150 linear fits of 24 points, four parameters each; the full table is in benchmarks."""
    n, repeats = 24, 150
    random = np.random.default_rng(5)
    J = design(n)
    X = stacked(J)
    inverse = np.linalg.inv(X.T @ X)
    root = np.linalg.cholesky(inverse)
    hits, bare, untouched = [], [], 0
    for _ in range(repeats):
        y = stacked(autoregression(random, rho, n))
        estimate = inverse @ X.T @ y
        left = y - X @ estimate
        s2 = left @ left / (2 * n - 4)
        [known] = judged_together([neighbor_correlation(left[:n] + 1j * left[n:], X)])
        covariance, dof = s2 * inverse, 2 * n - 4
        bare.append(np.abs(estimate) < t.ppf(0.975, dof) * np.sqrt(np.diag(covariance)))
        untouched += known is None
        if known is not None:
            meat, dof = averaged_meat(J @ root, known, lambda c: c, dof)
            covariance = s2 * root @ meat @ root.T
        hits.append(np.abs(estimate) < t.ppf(0.975, dof) * np.sqrt(np.diag(covariance)))
    # Of 150 fits the share of one parameter is known to 2 %.
    assert np.all(np.mean(hits, axis=0) > 0.89)
    assert 0.92 < np.mean(hits) < 0.985
    assert (untouched > 0.7 * repeats) == (rho == 0)
    assert np.mean(bare) < {0.0: 0.98, 0.6: 0.82}[rho]


def test_too_few_numbers_an_exact_fit_and_alternating_errors_count_as_independent():
    e = autoregression(np.random.default_rng(0), 0.9, 12)
    assert neighbor_correlation(e, np.zeros((24, 1))) is not None
    assert neighbor_correlation(1e-9 * e, np.zeros((24, 1))) is None
    assert neighbor_correlation(e[:3], stacked(design(3))) is None
    alternating = neighbor_correlation(np.abs(e) * (-1) ** np.arange(12), np.zeros((24, 1)))
    assert judged_together([alternating]) == [None]


def test_the_meat_does_not_depend_on_units_and_without_scores_there_is_none():
    n = 11
    scores = np.random.default_rng(2).standard_normal((n, 2, 3)) @ [1, 1j, 0]
    known = NeighborCorrelation(
        np.array([[0.0], [0.6]]) ** np.arange(n),
        np.array([0.3, 0.7]),
        np.array([1.0, 1.7]),
        np.ones((2, n)),
    )
    root = np.eye(2) * 0.01
    scores = np.column_stack([scores[:, 0], 3 * scores[:, 1]])
    meat, dof = averaged_meat(scores @ root, known, lambda c: c, 18.0)
    again = averaged_meat(1e4 * scores @ root, known, lambda c: c, 18.0)
    assert_allclose(again[0], 1e8 * meat)
    assert again[1] == pytest.approx(dof)
    nothing = averaged_meat(0 * scores @ root, known, lambda c: c, 18.0)
    assert not nothing[0].any()
    assert nothing[1] == 18.0


def test_the_mean_and_the_powers_of_weighted_correlations():
    known = NeighborCorrelation(
        np.array([[0.0], [0.5], [0.9]]) ** np.arange(10),
        np.array([0.2, 0.3, 0.5]),
        np.ones(3),
        np.ones((3, 10)),
    )
    assert known.mean == pytest.approx(0.6)
    assert known.independent == pytest.approx(0.2)
    assert_allclose(known.powers[2], 0.9 ** np.arange(10))


def test_one_variance_or_none_is_its_own_average():
    found = student_of_average(np.ones(1), np.array([3.0]), 7.0)
    assert found == pytest.approx((3.0, 7.0), rel=1e-6)
    assert student_of_average(np.array([0.25, 0.75]), np.array([0.0, 4.0]), 7.0) == (3.0, 7.0)
    variance, dof = student_of_average(np.array([0.25, 0.75]), np.array([4.0, 4.0]), 7.0)
    assert (variance, dof) == pytest.approx((4.0, 7.0), rel=1e-6)


def test_an_average_of_normal_distributions_has_their_standard_error_and_is_normal():
    weight, variance = np.array([0.5, 0.3, 0.2]), np.array([1.0, 2.0, 9.0])
    found, dof = student_of_average(weight, variance, np.inf)
    random = np.random.default_rng(0)
    errors = random.choice(np.sqrt(variance), 200_000, p=weight) * random.standard_normal(200_000)
    assert np.mean(np.abs(errors) < np.sqrt(found)) == pytest.approx(0.6827, abs=0.005)
    assert dof == np.inf


def with_probability(independent):
    """Return a distribution with this probability of independent errors."""
    weight = np.array([independent, 0.75 * (1 - independent), 0.25 * (1 - independent)])
    return NeighborCorrelation(np.ones((3, 4)), weight, np.ones(3), np.ones((3, 4)))


@pytest.mark.parametrize("alone", [[0.4], [0.3, 0.8, 0.8, 0.7], [0.45] * 9, [1e-9] + [0.7] * 8])
def test_responses_are_judged_by_the_share_that_all_of_them_show(alone):
    """By the sum over all sets of responses with correlated errors, of which k have Beta(k + 1, n - k + 1)."""
    n = len(alone)
    total, independent = 0.0, np.zeros(n)
    for flags in itertools.product((False, True), repeat=n):
        k = sum(flags)
        share = 1 / (n + 1) / math.comb(n, k)
        p = share * np.prod([1 - q if flag else q for q, flag in zip(alone, flags, strict=True)])
        total, independent = total + p, independent + p * ~np.array(flags)
    for judged, wanted in zip(
        judged_together([with_probability(q) for q in alone]), independent / total, strict=True
    ):
        if wanted > 0.6:
            assert judged is None
        else:
            assert judged.independent == pytest.approx(wanted, rel=1e-3)
            assert judged.weight.sum() == pytest.approx(1)
            assert judged.weight[1] == pytest.approx(3 * judged.weight[2])


def test_two_points_that_are_alike_are_enough_and_what_is_not_finite_tells_nothing():
    e = np.array([1.0 + 1j, 1.01 + 0.99j])
    assert neighbor_correlation(e, np.zeros((4, 0))) is not None
    assert neighbor_correlation(e[:1], np.zeros((2, 0))) is None
    long = autoregression(np.random.default_rng(0), 0.9, 12)
    for spoiled in (np.nan, np.inf):
        design_ = np.zeros((24, 1))
        design_[3] = spoiled
        assert neighbor_correlation(long, design_) is None
        assert (
            neighbor_correlation(np.where(np.arange(12) == 5, spoiled, long), np.zeros((24, 1)))
            is None
        )


def test_slow_errors_beside_white_ones_widen_intervals():
    """Parameters take most of the slow errors: exponential correlations do not show these."""
    n = 40
    random = np.random.default_rng(7)
    J = design(n)
    X = stacked(J)
    inverse = np.linalg.inv(X.T @ X)
    root = np.linalg.cholesky(inverse)
    covered = []
    for _ in range(100):
        white, steps = random.standard_normal((2, n, 2)) @ [1, 1j]
        y = stacked(0.6 * white + 1.2 * np.cumsum(steps) / np.sqrt(n))
        estimate = inverse @ X.T @ y
        left = y - X @ estimate
        s = np.sqrt(left @ left / (2 * n - 4))
        known = neighbor_correlation(left[:n] + 1j * left[n:], X)
        covariance, dof = s**2 * inverse, 2 * n - 4
        if known is not None:
            meat, dof = averaged_meat(s * J @ root, known, lambda c: c, dof)
            covariance = root @ meat @ root.T
        covered.append(np.abs(estimate) < t.ppf(0.975, dof) * np.sqrt(np.diag(covariance)))
    # 0.58 to 0.6 without these correlations.
    assert np.mean(covered) > 0.74


@pytest.mark.parametrize("count", [2, 5, 8])
def test_means_of_neighbors_are_among_the_kinds_of_errors(count):
    correlations, _ = error_kinds(40)
    of_means = np.clip(1 - np.arange(40) / count, 0, 1)
    assert np.abs(correlations - of_means).max(axis=1).min() < 0.03
