"""Correlations that errors of neighboring points may have, and their spectra."""

from functools import lru_cache

import numpy as np

from greybox.data.files.arrays import Array

# Lengths of a slow correlation in points, the longest of which is mostly an error common to all
# points, and variances over that of the white errors above it. Parameters take most of a slow
# effect beneath noise: where two thirds of the variance of 40 points are a random walk, intervals
# cover 78 % (66 % with white errors beside means of neighbors alone).
LENGTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 64.0])[:, None]
VARIANCES = np.array([0.3, 1.0, 3.0, 10.0, 1e4])[:, None, None]


@lru_cache(4)  # members of a study mostly have equal numbers of points
def error_kinds(n: int) -> tuple[Array, Array]:
    """Return the correlations (m, n) of n errors, and the variances (m, n) of their cosines.

    Independent errors come first.
    """
    omega = np.pi * np.arange(n + 1) / n
    # Means of two to eight neighbors, and means of such means. With slow correlations alone,
    # intervals of 60 points were 1.4 to 1.8 times too wide for means of two and four neighbors and
    # for a Hann window of three.
    count = np.arange(2, 9)
    power = np.abs(np.tri(8)[1:] @ np.exp(-1j * np.outer(np.arange(8), omega))) ** 2
    # Errors that are alike over half of the points look like a gain.
    means = np.vstack([power, power**2])[np.append(count, 2 * count - 1) <= max(n / 2, 2)]
    # Few points smear the frequencies that a mean takes out.
    means += means.mean(axis=1, keepdims=True) / n
    # A longer correlation is an error of all points, which looks like a gain.
    slow = slow_errors(omega, LENGTHS[LENGTHS[:, 0] <= n])
    variances = np.vstack([slow, means])[:, :n]
    # The mean counts as one of the cosines, and as half of one in a Fourier series.
    slow[1:, 0] *= 2
    powers = np.fft.irfft(np.vstack([slow, means]))[:, :n]
    return powers / powers[:, :1], variances / variances.mean(axis=1, keepdims=True)


def slow_errors(omega: Array, lengths: Array = LENGTHS) -> Array:
    """Return the spectra (kinds, n) of white errors above slow ones.

    White errors alone come first. Frequencies `omega` are in rad for a point.
    """
    slow = 1 / (np.cosh(1 / lengths) - np.cos(omega))
    slow /= slow.mean(axis=1, keepdims=True)
    return np.vstack([np.ones_like(omega), *(1 + VARIANCES * slow)])
