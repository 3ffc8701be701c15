"""Whitened residuals and drawn errors against processes whose covariances are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import trapezoid
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
            assert_allclose(
                found, np.linalg.matrix_power(F, lag) @ covariance, atol=0.1 * covariance.max()
            )


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


def test_draws_of_correlated_residuals_get_the_variances_of_the_spectrum():
    """Whitened residuals of outputs that are nearly one another, the first with half of its samples missing."""
    random = np.random.default_rng(2)
    spectrum = spectrum_of(F, C)
    white = np.array([[0.7, 0.0], [0.5, 0.2]]) @ random.normal(size=(2, 400))
    drawn = spectrum.of_draws(white)
    assert drawn.omega is spectrum.omega
    assert drawn.density is spectrum.density
    colored = np.array(
        [drawn.colored(white[:, random.integers(400, size=100)]) for _ in range(1000)]
    )
    assert_allclose(colored.std(axis=(0, 2)), spectrum.deviation, rtol=0.02)

    # Missing samples do not count, neither in a variance nor, since they are drawn as zeros, in a
    # covariance.
    white[0, ::2] = np.nan
    found = spectrum.of_draws(white).deviation / spectrum.deviation
    known = np.nan_to_num(white)
    covariance = known @ known.T / 400
    covariance[0, 0] = np.nanmean(white[0] ** 2)
    eigenvalues, vectors = np.linalg.eigh(spectrum.density.transpose(2, 0, 1))
    root = vectors * np.sqrt(eigenvalues)[:, None] @ vectors.conj().transpose(0, 2, 1)
    mean = trapezoid((root @ covariance @ root).transpose(1, 2, 0), OMEGA).real / np.pi
    wanted = trapezoid(spectrum.density, OMEGA).real / np.pi
    assert_allclose(found, np.sqrt(np.diag(wanted) / np.diag(mean)), rtol=1e-3)


def test_combinations_of_errors_have_the_covariance_of_combinations():
    spectrum, mixing = spectrum_of(F, C), np.array([[2.0, 0.0], [-1.0, 3.0]])
    mixed = spectrum.mixed(mixing)

    def covariance(spectrum):
        density = trapezoid(spectrum.density, OMEGA).real / np.pi
        return density * np.outer(spectrum.deviation, spectrum.deviation)

    assert_allclose(covariance(mixed), mixing @ covariance(spectrum) @ mixing.T)


def test_what_is_whitened_is_colored_again():
    """On the circle that a record makes with its mirror image."""
    spectrum = spectrum_of(np.array([[0.6]]), np.eye(1))
    residuals = np.random.default_rng(3).normal(size=(1, 61))
    white = spectrum.whitened(residuals)
    assert_allclose(
        spectrum.colored(np.hstack([white, white[:, ::-1]]))[:, :61], residuals, atol=1e-3
    )


def test_an_output_that_was_not_measured_has_no_whitened_residuals():
    residuals = np.random.default_rng(3).normal(size=(2, 61))
    residuals[1] = np.nan
    white = spectrum_of(F, C).whitened(residuals)
    assert np.isfinite(white[0]).all()
    assert np.isnan(white[1]).all()
