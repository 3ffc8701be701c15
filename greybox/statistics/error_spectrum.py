"""The spectrum of errors in time, with which residuals are whitened and errors are drawn.

Blocks of correlated residuals cut off the correlation at their ends, so that the variance of a mean
comes out too small: by a fifth with 23 samples of an autoregression of coefficient 0.8. Whitened
residuals have no correlation that a block could cut off. Sources: Davison and Hinkley (1997),
Bootstrap Methods and their Application, section 8.2.3 (post-blackening); Kirch and Politis (2011),
TFT-bootstrap, Annals of Statistics 39 (by the spectrum, back in time).
"""

from functools import cached_property

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.frozen_values import frozen

ROUNDING = 1e-9  # of spectra, in units of an output's variance: lower values are rounding


@frozen
class ErrorSpectrum:
    """A spectrum of the errors of k outputs.

    Attributes
    ----------
    omega : (b,) array
        rad/sample, increasing from zero to pi.
    density : (k, k, b) array
        Its mean over the frequencies is the covariance, in units of the outputs' deviations.
    deviation : (k,) array
    """

    omega: Array
    density: ComplexArray
    deviation: Array

    def mixed(self, mixing: Array) -> "ErrorSpectrum":
        """Return the spectrum of combinations of the errors, `mixing` (k, k) times them."""
        gains = mixing * self.deviation
        deviation = np.linalg.norm(gains, axis=1)
        gains = gains / deviation[:, None]
        density = np.einsum("ij,jlb,ml->imb", gains, self.density, gains)
        return ErrorSpectrum(self.omega, density, deviation)

    def whitened(self, residuals: Array) -> Array:
        """Return residuals (..., k, n) without their correlation; missing ones remain NaN."""
        is_measured = np.isfinite(residuals)
        samples = np.arange(residuals.shape[-1])
        # A straight line across gaps, and mirrored ends below: a jump would be an error of its own.
        filled = np.where(is_measured, residuals, 0.0)
        for row in np.argwhere(is_measured.any(axis=-1) & ~is_measured.all(axis=-1)):
            is_finite, values = is_measured[tuple(row)], residuals[tuple(row)]
            filled[tuple(row)] = np.interp(samples, samples[is_finite], values[is_finite])

        scaled = filled / self.deviation[:, None]
        mirrored = np.concatenate([scaled, scaled[..., ::-1]], axis=-1)
        white = self._filtered(mirrored, -0.5)[..., : len(samples)]
        return np.where(is_measured, white, np.nan)

    def colored(self, white: Array) -> Array:
        """Return white errors (k, m) with this spectrum, stationary on the circle of m samples."""
        return self.deviation[:, None] * self._filtered(white, 0.5)

    def of_draws(self, white: Array) -> "ErrorSpectrum":
        """Return a spectrum that gives draws of whitened residuals (k, n) this one's variances.

        The covariance of whitened residuals is not one, because a fit takes a part of the errors,
        samples are missing, and outputs may be combinations of others.
        """
        is_measured = np.isfinite(white)
        filled = np.nan_to_num(white)
        covariance = filled @ filled.T / white.shape[1]
        np.fill_diagonal(covariance, (filled**2).sum(axis=1) / is_measured.sum(axis=1))
        roots = self._roots(0.5)
        # The trapezoidal rule over uneven frequencies.
        width = np.gradient(self.omega)
        drawn = np.einsum(
            "bij,jk,bik,b->i", roots, covariance, roots.conj(), width, optimize=True
        ).real
        required = np.einsum("bij,bij,b->i", roots, roots.conj(), width, optimize=True).real

        return ErrorSpectrum(self.omega, self.density, np.sqrt(required / drawn) * self.deviation)

    def _roots(self, power: float) -> ComplexArray:
        size, vectors = self._principal
        return (vectors * size[:, None] ** power) @ vectors.conj().mT

    @cached_property
    def _principal(self) -> tuple[Array, ComplexArray]:
        # Outputs that are combinations of others have singular spectra: rounding is their floor.
        size, vectors = np.linalg.eigh(self.density.transpose(2, 0, 1))
        return np.maximum(size, ROUNDING), vectors

    def _filtered(self, values: Array, power: float) -> Array:
        """Return values (..., k, m) on a circle, filtered without delay by the spectrum."""
        m = values.shape[-1]
        # The Hermitian root has no phase, so that nothing moves in time.
        roots = self._roots(power)
        omega = 2 * np.pi * np.arange(m // 2 + 1) / m
        transform = np.fft.rfft(values)
        result = np.zeros_like(transform)
        for i, j in np.ndindex(*roots.shape[1:]):
            root = np.interp(omega, self.omega, roots[:, i, j])
            result[..., i, :] += root * transform[..., j, :]
        return np.fft.irfft(result, m)
