"""The color of residuals: coefficients recovered, information against dense covariance matrices, missing samples."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm, solve_discrete_lyapunov, toeplitz
from scipy.signal import lfilter

from greybox.statistics.residual_autocorrelation import (
    autocovariance,
    autoregression,
    colored_information,
    vector_autoregression,
)

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


def test_a_vector_autoregression_is_found():
    """A mass on a spring pushed by noise: position and velocity, exact in discrete time."""
    F = expm(0.1 * np.array([[0.0, 1.0], [-4.0, -0.8]]))
    white = np.array([[0.02, 0.0], [0.3, 0.1]]) @ np.random.default_rng(0).normal(size=(2, 20000))
    e = np.zeros((2, 20000))
    for t in range(1, 20000):
        e[:, t] = F @ e[:, t - 1] + white[:, t]
    found = vector_autoregression([e[:, :9000], e[:, 9000:]])
    assert_allclose(found.coefficients, [-F], atol=0.02)
    assert_allclose(found.innovation, white @ white.T / 20000, rtol=0.02)
    response = found.response()
    assert_allclose(response[:4], [np.eye(2), F, F @ F, F @ F @ F], atol=0.05)
    scaled = vector_autoregression([e * [[1e-6], [1e6]]])
    assert_allclose(scaled.innovation / np.outer([1e-6, 1e6], [1e-6, 1e6]), found.innovation, rtol=0.02)


def test_one_output_has_the_same_autoregression_alone_and_as_a_vector():
    e = colored(AR2, 3000, seed=6)
    assert_allclose(vector_autoregression([e[None]]).coefficients[:, 0, 0], autoregression([e])[1:], atol=1e-6)


def test_an_output_without_errors_changes_nothing():
    e = np.vstack([colored(AR2, 3000, seed=6), np.zeros(3000)])
    assert_allclose(vector_autoregression([e]).coefficients[:2, 0, 0], AR2[1:], atol=0.05)
    J = np.random.default_rng(0).normal(size=(2, 2, 3000))
    assert_allclose(colored_information([J], [e]), colored_information([J[:1]], [e[:1]]), rtol=0.05)


def test_information_of_outputs_that_hand_their_errors_on():
    """Errors in a position come from those in its velocity: the dense covariance of both."""
    n, random = 1500, np.random.default_rng(3)
    F, C = np.array([[1.0, 0.1], [-0.3, 0.85]]), np.diag([1e-4, 1.0])
    P = solve_discrete_lyapunov(F, C)
    lags, power = [], np.eye(2)
    for _ in range(n):
        lags.append(power @ P)  # E e(t + l) e(t)ᵀ
        power = F @ power
    lags = np.array(lags)
    blocks = [[toeplitz(lags[:, i, j], lags[:, j, i]) for j in range(2)] for i in range(2)]
    J = lfilter([1.0], [1, -0.95], random.normal(size=(2, 2, n)))
    wanted = sum(J[i] @ blocks[i][j] @ J[j].T for i in range(2) for j in range(2))
    found = []
    for seed in range(8):
        white = np.sqrt(np.diag(C))[:, None] * np.random.default_rng(seed).normal(size=(2, n + 300))
        e = np.zeros((2, n + 300))
        for t in range(1, n + 300):
            e[:, t] = F @ e[:, t - 1] + white[:, t]
        found.append(colored_information([J], [e[:, 300:]]))
    assert_allclose(np.diag(np.mean(found, axis=0)), np.diag(wanted), rtol=0.15)


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


@pytest.mark.parametrize("kind", ["few", "random", "every fourth", "block"])
def test_missing_samples_do_not_hide_the_color(kind):
    """What is missing has neither residual nor sensitivity; what is there keeps its correlation."""
    n, random = 8000, np.random.default_rng(9)
    there = {
        "random": random.random(n) < 0.5,
        "few": random.random(n) < 0.95,
        "every fourth": np.arange(n) % 4 == 0,
        "block": np.abs(np.arange(n) - n / 2) > n / 5,
    }[kind]
    e = colored([1, -0.9], n, seed=5) * there
    J = (1 + random.normal(size=(1, 2, n))) * there
    found = colored_information([J], [e[None]])
    wanted = J[0] @ toeplitz(covariances([1, -0.9], n - 1)) @ J[0].T
    assert_allclose(np.diag(found), np.diag(wanted), rtol=0.25)
