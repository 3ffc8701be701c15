"""Finds the period of a signal that repeats itself, such as a multisine."""

import numpy as np

from greybox.data.files.arrays import Array

# Correlation of a signal with itself one period later, and one that it must fall below before:
# noise in the measured input may be a hundredth of its power.
REPEATED, UNLIKE = 0.98, 0.5
# Periods of two samples, or a single period, are no pattern.
SHORTEST = 8  # samples


def period_of(values: Array) -> float:
    """Return the period of values (n,) in samples, to a part of one; NaN if they do not repeat."""
    centered = values - values.mean()
    if not (np.isfinite(values).all() and np.ptp(values) > 0):
        return np.nan
    count = values.size
    spectrum = np.fft.rfft(centered, 2 * count)
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: count // 2]

    # The power of the samples that overlap.
    power = np.r_[0.0, np.cumsum(centered**2)]
    lags = np.arange(products.size)
    first, last = power[count - lags], power[count] - power[lags]
    alike = products / np.sqrt(np.maximum(first * last, np.finfo(float).tiny))

    apart = np.flatnonzero(alike < UNLIKE)
    if not apart.size:
        return np.nan
    peak = (alike[1:-1] >= alike[:-2]) & (alike[1:-1] > alike[2:]) & (alike[1:-1] > REPEATED)
    peaks = np.flatnonzero(peak) + 1
    peaks = peaks[(peaks > apart[0]) & (peaks >= SHORTEST)]
    if not peaks.size:
        return np.nan

    # The last peak is so many periods later, and a sample is a small part of them.
    shortest = int(peaks[0])
    last = int(peaks[-1])
    return last / round(last / shortest)
