"""Finds the samples of a signal at its limits."""

import math

import numpy as np

from greybox.data.files.arrays import Array, BoolArray


def at_limit(values: Array) -> BoolArray:
    """Return which of the values (n,) are at a limit.

    A limit is a flat top: the signal rests at an extreme value for at least three samples and three
    times as long as it usually rests elsewhere (a control may be held for several samples
    throughout).
    """
    low, high = values.min(), values.max()
    reach = high - low
    # Runs of equal values.
    starts = np.flatnonzero(np.r_[True, np.abs(np.diff(values)) > 1e-9 * reach])
    lengths = np.diff(np.r_[starts, values.size])
    levels = values[starts]
    # Steps, doublets and binary sequences have fewer levels. They rest at their extremes
    # by design, and a limit looks like an amplitude there.
    if np.unique(levels).size < 12:
        return np.zeros(values.size, dtype=bool)

    # A single-precision number in a log has 24 bits, 6e-8.
    extreme = (levels <= low + 1e-6 * reach) | (levels >= high - 1e-6 * reach)
    usual = float(np.median(lengths[~extreme])) if not extreme.all() else math.inf
    return np.repeat(extreme & (lengths >= max(3, 3 * usual)), lengths)
