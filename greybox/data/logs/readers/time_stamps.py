"""Cleans time stamps of clock restarts, implausible values, and times that do not increase."""

from bisect import bisect_left
from itertools import pairwise

import numpy as np

from greybox.data.files.arrays import Array, IntArray

# s by which stamps fall at a clock restart; between messages of one boot they fall by up to 4 ms.
BACK = 1.0

# The medians of this many earlier and later messages show a restart despite 24 damaged ones.
WINDOW = 50

PAUSE = 10.0  # s between two boots on the common clock: the real pause is unknown
SLACK = 600.0  # s outside of the first and last stamps: farther ones are damaged


def restarts(stamps: Array) -> tuple[int, ...]:
    """Return where the clock restarted: indices into the stamps, s, in the order of the file.

    A single damaged stamp is not a restart: the median of the later stamps must be below that of
    the earlier ones.
    """
    drops = np.flatnonzero(np.diff(stamps) < -BACK) + 1
    starts: list[int] = []
    for drop in drops:
        start = starts[-1] if starts else 0
        earlier, later = stamps[max(start, drop - WINDOW) : drop], stamps[drop : drop + WINDOW]
        # Both: a damaged stamp raises the last one, and a long window lowers the median.
        if np.median(later) < np.median(earlier) - BACK and np.median(later) < earlier[-1] - BACK:
            starts.append(int(drop))
    return tuple(starts)


def one_clock(stamps: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the stamps, s, on one clock, NaN for implausible ones, and findings.

    After a restart the clock is set to `PAUSE` after the last stamp of the previous boot, so that a
    gap separates the boots of a record.
    """
    shifted = stamps.copy()
    finite = np.flatnonzero(np.isfinite(stamps))
    ticks = stamps[finite]
    findings = []
    end = 0.0
    for boot, (start, stop) in enumerate(pairwise([0, *restarts(ticks), ticks.size])):
        if start == stop:
            continue
        piece = _plausible(ticks[start:stop])
        # The first boot keeps its clock, to which the texts of the log refer.
        shift = end + PAUSE - float(np.nanmin(piece)) if boot else 0.0
        shifted[finite[start:stop]] = piece + shift
        if boot:
            findings.append(
                f"the clock restarted at {end:.1f} s (another boot): later times were shifted by "
                f"{shift:+.1f} s, to {PAUSE:g} s after it; the real pause is not known."
            )
        end = float(np.nanmax(piece)) + shift

    return shifted, tuple(findings)


def _plausible(stamps: Array) -> Array:
    """Return the stamps of one boot, NaN if far outside those at its start and its end."""
    # A damaged stamp would stretch the record over years. Stamps mostly increase evenly, and a
    # quarter may be damaged: the edge is twice as far from the median as the quartile.
    low, early = np.percentile(stamps[:WINDOW], (25, 50))
    late, high = np.percentile(stamps[-WINDOW:], (50, 75))
    first, last = early - 2 * (early - low), late + 2 * (high - late)
    plausible = (stamps >= first - SLACK) & (stamps <= last + SLACK)
    return np.where(plausible, stamps, np.nan) if plausible.any() else stamps


def increasing(time: Array) -> IntArray:
    """Return the largest choice of rows in which the time strictly increases, without NaN."""
    rows = np.flatnonzero(np.isfinite(time))
    finite = time[rows]
    if np.all(np.diff(finite) > 0):
        return rows
    return rows[_longest_increase(finite)]


def _longest_increase(values: Array) -> IntArray:
    """Return the longest strictly increasing subsequence, by patience sorting, O(n log n)."""
    # Patience sorting: the smallest last value of an increasing sequence of every length.
    tails: list[float] = []
    last: list[int] = []
    link = np.full(values.size, -1)
    for i, value in enumerate(values.tolist()):
        at = bisect_left(tails, value)
        link[i] = last[at - 1] if at else -1
        if at == len(tails):
            tails.append(value)
            last.append(i)
        elif value < tails[at]:
            tails[at] = value
            last[at] = i
    chain = last[-1:]
    while link[chain[-1]] >= 0:
        chain.append(int(link[chain[-1]]))

    return np.array(chain[::-1], dtype=np.intp)
