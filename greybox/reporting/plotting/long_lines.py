"""Lines of long records: gaps remain open, and no more points are drawn than can be seen."""

import math
from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.record import runs_between_gaps

# Pixels of a figure of 10 inches at 200 dpi; each column of pixels shows two extremes.
COLUMNS = 2000


def drawn_line(
    time: Array,
    values: Array,
    rows: Sequence[IntArray],
    columns: int = COLUMNS,
) -> tuple[Array, Array]:
    """Return the pieces of a line with NaN between them; long ones keep the extremes of columns."""
    # Every n-th sample would hide spikes; the smallest and the largest of each column show them.
    samples_per_column = math.ceil(sum(map(len, rows)) / columns)
    pieces: list[IntArray] = []
    for run in rows:
        finite = run[np.isfinite(values[run])]
        usual_distance = float(np.median(np.diff(finite))) if finite.size > 1 else 1.0
        if usual_distance > 1:
            # An output that is sampled in every tenth row is a line through these, up to its gaps.
            for places in runs_between_gaps(finite, 2 * usual_distance):
                pieces.append(finite[places])
        else:
            pieces.append(run)
    # Two samples are their own extremes.
    size = samples_per_column
    if size > 2:
        pieces = [piece[_extremes(values[piece], size)] for piece in pieces]

    def joined(numbers: Array) -> Array:
        return np.concatenate([np.append(numbers[piece], np.nan) for piece in pieces])[:-1]

    return joined(time), joined(values)


def _extremes(values: Array, size: int) -> IntArray:
    """Return the rows of the smallest and largest of every `size` values (n,), and of both ends."""
    if values.size < size:
        return np.arange(values.size)
    blocks = np.arange(0, values.size - size + 1, size)
    rows = values[blocks[:, None] + np.arange(size)]
    lowest = blocks + np.nan_to_num(rows, nan=np.inf).argmin(axis=1)
    highest = blocks + np.nan_to_num(rows, nan=-np.inf).argmax(axis=1)
    return np.unique(np.concatenate([lowest, highest, [0, values.size - 1]]))
