"""Lines of long records: gaps stay open, and no more points are drawn than can be seen."""

from collections.abc import Sequence

import numpy as np

from greybox.files.arrays import Array, IntArray

COLUMNS = 2000  # a figure 10 inches wide has these many pixels at 200 dpi; each shows a smallest and a largest value


def pieces(time: Array, gap: float) -> list[IntArray]:
    """Return the rows between the gaps: the steps of `time` (n,) that are longer than `gap`, in s."""
    cuts = np.flatnonzero(np.diff(time) > gap) + 1
    return np.split(np.arange(time.size), cuts)


def drawn_line(
    time: Array,
    values: Array,
    rows: Sequence[IntArray],
    *,
    thin: bool = True,
    columns: int = COLUMNS,
) -> tuple[Array, Array]:
    """Return the pieces of a line, one after the other with a NaN between.

    Of a long line only the extremes of what falls into one of so many columns are returned, unless
    `thin` is False.
    """
    size = -(-sum(map(len, rows)) // columns) if thin else 1
    times: list[Array] = []
    kept_values: list[Array] = []

    for piece in rows:
        kept = (
            piece[_extremes(values[piece], size)] if size > 2 else piece
        )  # two samples are their own extremes
        times += [time[kept], np.array([np.nan])]
        kept_values += [values[kept], np.array([np.nan])]

    return np.concatenate(times)[:-1], np.concatenate(kept_values)[:-1]


def _extremes(values: Array, size: int) -> IntArray:
    """Return the rows of the smallest and largest of every `size` values (n,), and of both ends."""
    if values.size < size:
        return np.arange(values.size)
    blocks = np.arange(0, values.size - size + 1, size)
    rows = values[blocks[:, None] + np.arange(size)]
    lowest = blocks + np.nan_to_num(rows, nan=np.inf).argmin(axis=1)
    highest = blocks + np.nan_to_num(rows, nan=-np.inf).argmax(axis=1)
    return np.unique(np.concatenate([lowest, highest, [0, values.size - 1]]))
