"""Finds the samples of a signal at its limits."""

import itertools
import math

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray

# Share of the height of a ramp by which it may bend. A sine that is cut at a fifth of its amplitude
# bends by 1e-3 between the limits.
STRAIGHT = 1e-4


def at_limit(values: Array) -> BoolArray:
    """Return which of the values (n,) are at a limit.

    A limit is a flat top: the signal rests at an extreme value for at least three samples and three
    times as long as it usually rests elsewhere (a control may be held for several samples
    throughout). A manoeuvre that ramps between its values, such as a 3-2-1-1, has none.
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
    is_rest = lengths >= max(3, 3 * usual)
    if _is_ramped(starts, levels, lengths, is_rest):
        return np.zeros(values.size, dtype=bool)
    return np.repeat(extreme & is_rest, lengths)


def _is_ramped(starts: IntArray, levels: Array, lengths: IntArray, is_rest: BoolArray) -> bool:
    """Return whether runs (r,) of equal values are steps with ramps, which rest by design.

    These move straight from one rest to another, and rest for longer. A cut signal turns between
    its limits, or bends, or moves for longer.
    """
    rests = np.flatnonzero(is_rest)
    ramps = [slice(a + 1, b) for a, b in itertools.pairwise(rests.tolist()) if b > a + 1]
    for ramp in ramps:
        at, height = starts[ramp], levels[ramp]
        moves = np.diff(levels[ramp.start - 1 : ramp.stop + 1])
        line = np.interp(at, at[[0, -1]], height[[0, -1]])
        bend = np.max(np.abs(height - line)) / (np.ptp(height) or 1.0)
        if np.unique(np.sign(moves)).size > 1 or bend > STRAIGHT:
            return False
    # Without ramps, it has too many levels for steps.
    moving = [lengths[ramp].sum() for ramp in ramps]
    return bool(ramps and np.median(lengths[rests]) > np.median(moving))
