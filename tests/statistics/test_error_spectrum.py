"""Whitened residuals and drawn errors against processes whose covariances are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter

from greybox.statistics.error_spectrum import ErrorSpectrum

OMEGA = np.linspace(0, np.pi, 400)
F, C = np.array([[0.8, 0.15], [-0.3, 0.7]]), np.array([[1.0, 0.5], [0.5, 2.0]])


def spectrum_of(f, c):
    """Of x(t + 1) = F x(t) + w, w of covariance C."""
    response = np.linalg.inv(np.eye(len(f)) - np.exp(-1j * OMEGA)[:, None, None] * f)
    density = (response @ c @ response.conj().transpose(0, 2, 1)).transpose(1, 2, 0)
    deviation = np.sqrt(np.diag(solve_discrete_lyapunov(f, c)))
    return ErrorSpectrum(OMEGA, density / (deviation * deviation[:, None])[:, :, None], deviation)


def test_drawn_errors_hand_on_from_output_to_output():
    """E x(t + l) x(t)ᵀ = Fˡ P, at the ends of a stretch as in its middle."""
    random = np.random.default_rng(0)
    spectrum = spectrum_of(F, C)
    drawn = np.array([spectrum.colored(random.normal(size=(2, 120))) for _ in range(2000)])
    covariance = solve_discrete_lyapunov(F, C)
    for t in (0, 57):
        for lag in (0, 1, 5):
            found = drawn[:, :, t + lag].T @ drawn[:, :, t] / len(drawn)
            assert_allclose(found, np.linalg.matrix_power(F, lag) @ covariance, atol=0.1 * covariance.max())


@pytest.mark.parametrize("gap", [0, 60])
def test_slow_residuals_are_white_up_to_the_ends_and_gaps(gap):
    """Where a random walk is cut, its level is a hundred times its steps, and would be so large an error."""
    spectrum = spectrum_of(np.array([[0.9999]]), np.eye(1))
    walk = 50 + lfilter([1], [1, -0.9999], np.random.default_rng(1).normal(size=300))[None]
    walk[:, 100 : 100 + gap] = np.nan
    white = spectrum.whitened(walk)
    assert np.isnan(white).sum() == gap
    assert np.nanmax(np.abs(white - np.nanmean(white))) < 5
    assert_allclose(np.nanstd(white), 1, rtol=0.15)
