"""Autoregressions: coefficients recovered, white series left white, several stretches."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from greybox.statistics.residual_autocorrelation import autocovariance, autoregression, levinson

AR2 = np.array([1.0, -1.5, 0.7])


def colored(coefficients, n, seed=0, sigma=1.0):
    white = sigma * np.random.default_rng(seed).normal(size=n + 500)
    return lfilter([1.0], coefficients, white)[500:]


def test_the_order_and_coefficients_of_an_autoregression_are_found():
    found = autoregression([colored(AR2, 20000)])
    assert_allclose(found, AR2, atol=0.03)


def test_white_residuals_stay_white():
    orders = [
        len(autoregression([np.random.default_rng(k).normal(size=800)])) - 1 for k in range(40)
    ]
    assert np.mean(np.array(orders) > 0) < 0.1


def test_several_stretches_count_together():
    e = colored([1.0, -0.9], 6000, seed=3)
    cut = autoregression(np.split(e, 12))
    assert_allclose(cut, [1, -0.9], atol=0.03)


def test_residuals_of_zero():
    assert_allclose(autoregression([np.zeros(100)]), [1.0])
    assert_allclose(autoregression([np.zeros(3)]), [1.0])


def test_autocovariances_are_mean_products():
    e = np.random.default_rng(0).normal(size=30)
    found = autocovariance([e[:20], e[20:]], 4)
    for k in range(5):
        products = e[: 20 - k] @ e[k:20] + e[20 : 30 - k] @ e[20 + k :]
        assert_allclose(found[k], products / 30, rtol=1e-9)


def test_the_recursion_solves_the_equations_of_yule_and_walker():
    r = autocovariance([colored(AR2, 300)], 12)
    rows, variances = levinson(r)
    assert len(rows) == 13
    for order, (row, variance) in enumerate(zip(rows, variances, strict=True)):
        solution = solve_toeplitz(r[:order], -r[1 : order + 1]) if order else []
        assert_allclose(row, np.r_[1, solution, np.zeros(12 - order)], rtol=1e-9)
        assert_allclose(variance, row @ r)


def test_a_series_that_is_predictable_has_no_higher_order():
    """Of a sine, two samples tell all the others: with rounding left over, no coefficient follows from it."""
    rows, variances = levinson(2.0 * np.cos(0.3 * np.arange(9)))
    assert np.count_nonzero(rows, axis=1).tolist() == [1, 2]
    assert_allclose(variances[1], 2 * np.sin(0.3) ** 2)


def test_the_order_is_that_of_least_bic_and_leaves_twenty_samples_a_coefficient():
    e = colored(np.poly([0.95, -0.95, 0.9j, -0.9j]), 4000, seed=5)
    assert len(autoregression([e])) - 1 >= 4
    for n in (19, 39, 59, 79):
        assert len(autoregression([e[:n]])) - 1 <= n // 20
    values = np.r_[e[:150], np.zeros(50)]  # zeros are no data
    r = autocovariance([values], 7)
    assert_allclose(r[0], e[:150] @ e[:150] / 150)
    _, variances = levinson(r)
    scores = 150 * np.log(variances) + np.arange(len(variances)) * np.log(150)
    assert len(autoregression([values])) - 1 == int(np.argmin(scores))


def test_a_series_that_alternates_has_a_positive_coefficient():
    assert_allclose(autoregression([colored([1.0, 0.8], 5000, seed=4)]), [1, 0.8], atol=0.05)
    assert_allclose(autoregression([1e-3 * colored([1.0, 0.8], 5000, seed=4)]), [1, 0.8], atol=0.05)


def test_more_lags_than_samples_have_no_products():
    e = np.array([2.0, -1.0, 3.0])
    assert_allclose(autocovariance([e], 6), [14 / 3, -5 / 3, 2, 0, 0, 0, 0], atol=1e-12)
    assert_allclose(
        autocovariance([e, np.array([0.0, 4.0, 1.0, 1.0])], 2), [32 / 6, 0, 10 / 6], atol=1e-12
    )  # 0: no data


def test_units_do_not_change_what_is_predictable():
    for unit in (1e-12, 1e12):
        rows, _ = levinson(unit * np.cos(0.3 * np.arange(9)))
        assert np.count_nonzero(rows, axis=1).tolist() == [1, 2]
        assert len(levinson(unit * 0.5 ** np.arange(5))[0]) == 5
