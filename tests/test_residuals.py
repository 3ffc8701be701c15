"""The color of residuals: coefficients recovered, information against dense covariance matrices, missing samples."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from greybox.residuals import autocovariance, autoregression, colored_information, filtered, inverse

AR2 = np.array([1.0, -1.5, 0.7])


def colored(coefficients, n, seed=0, sigma=1.0):
    white = sigma * np.random.default_rng(seed).normal(size=n + 500)
    return lfilter([1.0], coefficients, white)[500:]


def covariances(coefficients, lags):
    """Of the process with unit innovations, from its impulse response."""
    spectrum = np.abs(np.fft.rfft(lfilter([1.0], coefficients, np.eye(1, 20000)[0]), 40000)) ** 2
    return np.fft.irfft(spectrum)[: lags + 1]


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


def test_filters_are_those_of_scipy():
    x = np.random.default_rng(1).normal(size=300)
    assert_allclose(filtered(AR2, x), lfilter(AR2, [1.0], x), atol=1e-12)
    assert_allclose(filtered(inverse(AR2), x), lfilter([1.0], AR2, x), atol=1e-8)
    slow = np.array([1.0, -0.999])
    assert_allclose(filtered(inverse(slow), x), lfilter([1.0], slow, x), rtol=1e-6)


def test_information_is_that_of_the_dense_covariance():
    n, p = 4000, 3
    random = np.random.default_rng(2)
    J = lfilter([1.0], [1, -0.8], random.normal(size=(1, p, n)))
    e = colored(AR2, n, seed=7)
    found = colored_information([J], [e[None]])
    covariance = toeplitz(covariances(AR2, n - 1))
    wanted = J[0] @ covariance @ J[0].T
    assert_allclose(found, wanted, rtol=0.1, atol=0.05 * np.abs(wanted).max())
    assert np.linalg.eigvalsh(found).min() > 0


def test_two_outputs_that_share_their_errors():
    """Vector errors with one color: cross-covariance as the product of both filters."""
    n, p = 4000, 2
    random = np.random.default_rng(4)
    mix = np.array([[1.0, 0.0], [0.8, 0.3]])
    white = mix @ random.normal(size=(2, n + 500))
    e = lfilter([1.0], [1, -0.9], white)[:, 500:]
    J = random.normal(size=(2, p, n)) + 1
    covariance = toeplitz(covariances([1, -0.9], n - 1))
    wanted = sum((mix @ mix.T)[i, j] * J[i] @ covariance @ J[j].T for i in range(2) for j in range(2))
    assert_allclose(colored_information([J], [e]), wanted, rtol=0.2, atol=0.1 * np.abs(wanted).max())


@pytest.mark.parametrize("kind", ["few", "every fourth", "block"])
def test_missing_samples_do_not_hide_the_color(kind):
    """What is missing has neither residual nor sensitivity; what is there keeps its correlation."""
    n, random = 8000, np.random.default_rng(9)
    there = {
        "few": random.random(n) < 0.95,
        "every fourth": np.arange(n) % 4 == 0,
        "block": np.abs(np.arange(n) - n / 2) > n / 5,
    }[kind]
    e = colored([1, -0.9], n, seed=5) * there
    J = (1 + random.normal(size=(1, 2, n))) * there
    found = colored_information([J], [e[None]])
    wanted = J[0] @ toeplitz(covariances([1, -0.9], n - 1)) @ J[0].T
    assert_allclose(np.diag(found), np.diag(wanted), rtol=0.25)
