"""Autoregressions: coefficients recovered, white series left white, several stretches."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from greybox.statistics.residual_autocorrelation import autocovariance, autoregression

AR2 = np.array([1.0, -1.5, 0.7])


def colored(coefficients, n, seed=0, sigma=1.0):
    white = sigma * np.random.default_rng(seed).normal(size=n + 500)
    return lfilter([1.0], coefficients, white)[500:]


def test_the_order_and_coefficients_of_an_autoregression_are_found():
    found = autoregression([colored(AR2, 20000)])
    assert_allclose(found, AR2, atol=0.03)


def test_white_residuals_stay_white():
    orders = [len(autoregression([np.random.default_rng(k).normal(size=800)])) - 1 for k in range(40)]
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
