"""Lines of long records: gaps remain open, and no more points are drawn than can be seen."""

from collections.abc import Sequence

import numpy as np

from greybox.files.arrays import Array, IntArray

COLUMNS = 2000  # pixels of a figure of 10 inches at 200 dpi; each shows two extremes


def drawn_line(
    time: Array,
    values: Array,
    rows: Sequence[IntArray],
    columns: int = COLUMNS,
) -> tuple[Array, Array]:
    """Return the pieces of a line with NaN between them; long ones keep the extremes of columns."""
    # Every n-th sample would hide spikes; the smallest and the largest of each column show them.
    size = -(-sum(map(len, rows)) // columns)
    times: list[Array] = []
    heights: list[Array] = []
    for piece in rows:
        drawn = piece
        if size > 2:  # two samples are their own extremes
            drawn = piece[_extremes(values[piece], size)]
        times += [time[drawn], np.array([np.nan])]
        heights += [values[drawn], np.array([np.nan])]

    return np.concatenate(times)[:-1], np.concatenate(heights)[:-1]


def _extremes(values: Array, size: int) -> IntArray:
    """Return the rows of the smallest and largest of every `size` values (n,), and of both ends."""
    if values.size < size:
        return np.arange(values.size)
    blocks = np.arange(0, values.size - size + 1, size)
    rows = values[blocks[:, None] + np.arange(size)]
    lowest = blocks + np.nan_to_num(rows, nan=np.inf).argmin(axis=1)
    highest = blocks + np.nan_to_num(rows, nan=-np.inf).argmax(axis=1)
    return np.unique(np.concatenate([lowest, highest, [0, values.size - 1]]))
