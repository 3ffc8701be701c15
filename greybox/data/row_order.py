"""Rows of a table in the order of their times, each at a time of its own.

A table may be sorted backward or by something else, single rows may come late, and many rows may
share a coarse stamp. Where times start again, as after a restart of the logger, nothing is sorted.
"""

from collections.abc import Sequence

import numpy as np

from greybox.data.clock import ONE_LOST
from greybox.data.files.arrays import AnyArray, Array, BoolArray, IntArray
from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import counted

# Share of the steps that go back in a table that is sorted by something else. Runs of four rows,
# which all begin at the same time, have fewer.
UNSORTED = 0.25
# Share of the rows that may be late: more show another clock.
LATE = 0.05
# In usual steps: the least distance of a late row from the rows at its place.
APART = 0.5
# In ticks, by which coarse stamps are off a uniform clock at most; they are rounded or cut off.
ROUNDED = 0.75


def ordered_rows(
    time: Array, signals: Sequence[AnyArray] = ()
) -> tuple[Array, IntArray, list[str]]:
    """Return the times of rows, the rows (m,) in their order, and what was done, in words.

    Rows without a time stay where they are.

    Parameters
    ----------
    time : (n,) array, s
    signals : sequence of arrays
        With the samples in rows.
    """
    texts = []
    rows = np.arange(time.size)
    finite = np.flatnonzero(np.isfinite(time))
    if _is_unsorted(time[finite]):
        rows[finite] = finite[np.argsort(time[finite], kind="stable")]
        texts.append("does not increase from row to row: the rows were sorted by it")
        finite = np.flatnonzero(np.isfinite(time[rows]))

    time = time[rows]
    pieces = np.split(finite, np.flatnonzero(np.diff(time[finite]) < 0) + 1)
    if all(np.all(np.diff(time[piece]) > 0) for piece in pieces):
        return time, rows, texts
    twice = _stored_twice(time, rows, signals)
    if twice.any():
        texts.append(f"shows {counted(int(twice.sum()), 'row')} stored twice: one copy was used")
        time, rows = time[~twice], rows[~twice]
        finite = np.flatnonzero(np.isfinite(time))
        pieces = np.split(finite, np.flatnonzero(np.diff(time[finite]) < 0) + 1)
    if _is_of_devices(time[finite], [x[rows[finite]] for x in signals]):
        texts.append("has the same times for several devices: rows of the first one were used")
        return time, rows, texts

    time = time.copy()
    for piece in pieces:
        if piece.size and np.any(np.diff(time[piece]) == 0):
            time[piece], text = _spread(time[piece])
            texts.append(text)
    return time, rows, list(dict.fromkeys(texts))


def _is_unsorted(time: Array) -> bool:
    """Return whether rows at these times (n,) are to be sorted."""
    back = np.diff(time) < 0
    if not back.any():
        return False
    steps = np.diff(np.sort(time))
    if np.mean(back) > UNSORTED:
        # Runs at the same times are several experiments.
        return bool(np.mean(steps == 0) < 0.1)
    late = time < np.maximum.accumulate(time)
    if np.mean(late) > LATE:
        return False
    # A row with a damaged time is in the way of others, or alone far away.
    order = np.argsort(time, kind="stable")
    around = np.concatenate([[np.inf], steps, [np.inf]])
    nearest = np.minimum(around[:-1], around[1:])[late[order]]
    usual = np.median(steps)
    return bool(np.all((nearest >= APART * usual) & (nearest <= ONE_LOST * usual)))


def _stored_twice(time: Array, rows: IntArray, signals: Sequence[AnyArray]) -> BoolArray:
    """Return which rows (m,) are equal to the one before."""
    twice = np.concatenate([[False], (np.diff(time) == 0) & bool(signals)])
    for values in signals:
        before, after = values[rows[:-1]], values[rows[1:]]
        equal = (before == after) | (np.isnan(before) & np.isnan(after))
        twice[1:] &= equal.reshape(len(equal), -1).all(axis=1)
    return twice


def _is_of_devices(time: Array, signals: Sequence[AnyArray]) -> bool:
    """Return whether every time has the same number of rows, and a signal that numbers them."""
    count = np.count_nonzero(time == time[0])
    if count < 2 or time.size % count or time.size < 3 * count:
        return False
    if np.any(np.ptp(time.reshape(-1, count), axis=1)):
        return False
    return any(
        np.unique(values[:count]).size == count
        and np.all(values.reshape(-1, count) == values[:count])
        for values in signals
        if values.ndim == 1
    )


def _spread(time: Array) -> tuple[Array, str]:
    """Return times (n,), none of which is shared, of stamps that do not fall, and words on it."""
    stamps, counts = np.unique(time, return_counts=True)
    if stamps.size < 2:
        return time, "is the same in all rows"
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    tick = float(steps.min())
    words = f"has {counted(int(counts.max()), 'row')} in a stamp of {number(tick, 3)} s at most"

    uniform = time.copy()
    for run in np.split(np.arange(time.size), np.flatnonzero(np.diff(time) > ONE_LOST * usual) + 1):
        # The best line through the stamps.
        places, values = (x - x.mean() for x in (run, time[run]))
        step = places @ values / max(float(places @ places), 1.0)
        if np.abs(values - step * places).max() > ROUNDED * tick:
            break
        uniform[run] = time[run].mean() + step * places
    else:
        if np.all(np.diff(uniform) > 0):
            rate = number(1 / float(np.median(np.diff(uniform))), 4)
            return uniform, f"{words}: the rows are those of a clock of {rate} Hz"

    # Without a uniform clock, rows are evenly between their stamp and the next one.
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    share = (np.arange(time.size) - np.repeat(first, counts)) / np.repeat(counts, counts)
    widths = np.append(np.minimum(steps, usual), usual)
    return time + share * np.repeat(widths, counts), f"{words}: the rows were spread over it"
