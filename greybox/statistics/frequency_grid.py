"""Frequencies of a Fourier transform, and the bands over which spectra are compared."""

import math
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import Array, ComplexArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.statistics.residual_autocorrelation import HIGHEST_ORDER

LOWEST = 256  # lowest frequencies; each one is a band
LONG = 100_000  # samples beyond which transforms have single precision
COLUMNS = 16384  # frequencies at once in memory: 6 MB for three outputs and eight parameters


@frozen
class FrequencyGrid:
    """Frequencies of a transform of `size` samples, and the bands (b,) of spectra.

    Attributes
    ----------
    starts : (b,) array
        First frequency of every band.
    weight : (frequencies,) array
        Weights of the positive frequencies in the mean over all frequencies.
    band_weight, omega : (b,) arrays
        Sum of the weights, and mean frequency, rad/sample.
    longest : int
        Samples of the longest stretch.
    """

    size: int
    longest: int
    starts: IntArray
    weight: Array
    band_weight: Array
    omega: Array

    @classmethod
    def of(cls, longest: int) -> "FrequencyGrid":
        """Return the grid of transforms of up to `longest` samples, padded with zeros."""
        # Products of both ends would otherwise wrap around. Errors stay correlated for less than a
        # quarter of a long record. After records of up to 200 000 samples
        # 50 000 zeros suffice, after longer ones a quarter.
        size = fast_length(longest + min(longest, max(50_000, longest // 4)))
        count = size // 2 + 1
        # Zero and half of the sampling rate occur once, all others with both signs.
        weight = np.where(np.arange(count) % (size // 2) == 0, 1.0, 2.0) / size
        # Bands above have a relative width of 1.5 %.
        bands = max(math.ceil(math.log(max(count / LOWEST, 1.0)) / 0.015), 1)
        edges = np.geomspace(LOWEST, max(count, LOWEST), bands + 1).astype(int)
        starts = np.concatenate([np.arange(min(LOWEST, count)), edges[edges < count]])
        # Low edges coincide. np.unique would import masked arrays, which takes 8 ms.
        starts = starts[np.flatnonzero(np.diff(starts, prepend=-1))]
        band_weight = np.add.reduceat(weight, starts)
        omega = np.add.reduceat(weight * math.tau * np.arange(count) / size, starts) / band_weight

        return cls(size, longest, starts, weight, band_weight, omega)

    def banded(self, values: NDArray) -> NDArray:
        """Return means over the bands of values (..., frequencies): (..., b)."""
        return np.add.reduceat(values * self.weight, self.starts, axis=-1) / self.band_weight

    def spread_out(self, values: NDArray, part: slice = slice(None)) -> NDArray:
        """Interpolate values (..., b) of the bands at the frequencies of a part: (..., f)."""
        omega = math.tau * np.arange(len(self.weight))[part] / self.size
        return np.apply_along_axis(lambda row: np.interp(omega, self.omega, row), -1, values)

    @cached_property
    def delays(self) -> ComplexArray:
        """Responses (l, b) of delays of 0 to `HIGHEST_ORDER` samples."""
        return np.exp(-1j * np.outer(np.arange(HIGHEST_ORDER + 1), self.omega))

    def mean(self, values: NDArray) -> NDArray:
        """Return the mean over all frequencies of values (..., b) of the bands."""
        return values @ self.band_weight

    def transform(self, weighted: Array, directions: Array, deviation: Array) -> list[ComplexArray]:
        """Return the transforms (r, f) of sensitivities times deviations (k,), for every output.

        The sensitivities (k, p, n) are turned into the columns of `directions` (p, r).
        """
        # Of a spectrum, seven digits are plenty: those of long records fill the memory.
        precision = np.float32 if self.longest > LONG else float
        # Row by row: turned or padded rows would fill the memory again.
        return [
            np.array(
                [
                    np.fft.rfft((size * direction @ rows).astype(precision), self.size)
                    for direction in directions.T
                ]
            )
            for size, rows in zip(deviation, weighted, strict=True)
        ]

    def covariances(self, factors: Iterable[Any], order: int = -1) -> tuple[Array, ComplexArray]:
        """Return autocovariances (order + 1, k) and band means (k, k, b) of a periodogram.

        It is the sum of the products a bᴴ of its factors, (p, frequencies) for each of k outputs,
        and of their adjoints. By default there are no autocovariances.
        """
        lags: Any = 0.0
        banded: Any = 0.0
        for a, b in factors:
            k = len(a)
            of_lags = np.zeros((order + 1, k))
            product = np.empty((k, k, len(self.starts)), dtype=complex)
            # One by one: all products together would fill the memory of long records.
            for i, j in np.ndindex(k, k):
                terms = (x * y.conj() for x, y in zip(a[i], b[j], strict=True))
                values: Any = sum(terms, np.zeros(len(self.weight), complex))
                product[i, j] = self.banded(values)
                if i == j and order >= 0:
                    of_lags[:, i] = np.fft.irfft(2 * values.real, self.size)[: order + 1]
            lags, banded = lags + of_lags, banded + product + product.swapaxes(0, 1).conj()

        return lags, banded

    def score_covariance(self, transforms: Iterable[Any], density: NDArray) -> Array:
        """Return Σ J' Σ_e J (p, p) by the transforms (k, p, frequencies) of all stretches."""
        parts = []
        for transform in transforms:
            for start in range(0, len(self.weight), COLUMNS):
                part = slice(start, start + COLUMNS)
                spread = self.spread_out(density, part) * self.weight[part]
                columns = np.array([rows[:, part] for rows in transform], dtype=complex)
                # As pairs of reals, whose product is the real part of the complex product.
                parts.append(products(columns.view(float), filtered(spread, columns).view(float)))

        total = np.sum(parts, axis=0)
        return (total + total.T) / 2

    def correlation_times(self, spectra: Array) -> Array:
        """Return the correlation times (k,) of spectra (k, b), samples."""
        # An exponential has this share of its sum within its time constant.
        share = 1 - math.exp(-1)
        covariances = np.abs(np.fft.irfft(self.spread_out(spectra), self.size))
        total = np.cumsum(covariances[:, : min(self.longest, self.size // 2)], axis=1)
        return np.sum(total < share * total[:, -1:], axis=1)


def filtered(density: NDArray, transform: NDArray) -> NDArray:
    """Return the product of a density (k, k, f) and transforms (k, p, f) at each frequency.

    One column of a density, (k, k, 1), is that of white errors.
    """
    return np.einsum("ijf,jpf->ipf", density, transform)


def products(a: Array, b: Array) -> Array:
    """Return the sums (p, q) over k and n of the products of arrays (k, p, n) and (k, q, n)."""
    return (a @ b.mT).sum(axis=0)


def fast_length(count: int) -> int:
    """Return an even length of at least `count` whose Fourier transform is fast."""
    lengths = []
    # The factors of a fast length are twos, one at least, threes and fives.
    for odd in (1, 3, 5, 9, 15):
        least_power = math.ceil(count / odd)
        twos = max((least_power - 1).bit_length(), 1)
        lengths.append(odd * 2**twos)
    return min(lengths)
