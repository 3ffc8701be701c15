"""Correlations that errors of neighboring points may have, and their spectra."""

from functools import lru_cache

import numpy as np

from greybox.data.files.arrays import Array

# Slow errors are tried with these correlation lengths, in points; the longest is nearly an error
# that all points share. White errors are added to them. `VARIANCES` are those of the slow errors,
# divided by that of the white ones.
# The fitted parameters absorb most of a slow error beneath white noise: where a random walk has two
# thirds of the variance of 40 points, 95 % intervals contain the truth in 78 % of fits. Without
# slow errors, with means of neighbors alone, it is 66 %.
LENGTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 64.0])[:, None]
VARIANCES = np.array([0.3, 1.0, 3.0, 10.0, 1e4])[:, None, None]


@lru_cache(4)  # members of a study mostly have equal numbers of points
def error_kinds(n: int) -> tuple[Array, Array]:
    """Return m kinds of correlated errors of n points; the first kind is independent errors.

    Returns the correlations (m, n) at lags of 0 to n - 1 points, and the variances (m, n) of the
    coefficients of a cosine series of the n errors.
    """
    omega = np.pi * np.arange(n + 1) / n
    # Means of two to eight neighbors, and means of such means. With slow correlations alone,
    # intervals of 60 points were 1.4 to 1.8 times too wide for means of two and four neighbors and
    # for a Hann window of three.
    count = np.arange(2, 9)
    each_neighbor = np.exp(-1j * np.outer(np.arange(8), omega))
    sums_of_neighbors = np.tri(8)[1:] @ each_neighbor
    power = np.abs(sums_of_neighbors) ** 2
    means = np.vstack([power, power**2])
    widths = np.append(count, 2 * count - 1)  # in points
    # Errors that are alike over half of the points look like a gain.
    means = means[widths <= max(n / 2, 2)]
    # Few points smear the frequencies that a mean takes out.
    means += means.mean(axis=1, keepdims=True) / n
    # A longer correlation is an error of all points, which looks like a gain.
    slow = slow_errors(omega, LENGTHS[LENGTHS[:, 0] <= n])
    variances = np.vstack([slow, means])[:, :n]
    # An inverse Fourier transform gives frequency zero half the weight of the others; here all
    # cosines have the same weight.
    slow[1:, 0] *= 2
    powers = np.fft.irfft(np.vstack([slow, means]))[:, :n]
    return powers / powers[:, :1], variances / variances.mean(axis=1, keepdims=True)


def slow_errors(omega: Array, lengths: Array = LENGTHS) -> Array:
    """Return the spectra (kinds, n) of slow errors with white ones added, at `omega` (n,).

    White errors alone come first. Frequencies are in rad per point.
    """
    # The spectrum of a correlation exp(-lag / length), but for a factor.
    slow = 1 / (np.cosh(1 / lengths) - np.cos(omega))
    slow /= slow.mean(axis=1, keepdims=True)
    return np.vstack([np.ones_like(omega), *(1 + VARIANCES * slow)])
