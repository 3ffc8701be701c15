"""Numbers beside the points of a diagram, wherever there is room for one."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox

from greybox.files.arrays import Array
from greybox.plotting.figure import Figure
from greybox.plotting.matplotlib_figure import MARKER_SIZE, AxesArray

NUMBERED = 12  # points of one series up to which all have their number


def number_points(axes: AxesArray, figures: Sequence[Figure]) -> None:
    """Write the labels of the points, frequencies in rad/s, into axes that have been drawn."""
    axes[0].figure.figure.draw_without_rendering()  # the layout must be known
    for ax, figure in zip(axes, figures, strict=True):
        lines = [s for s in figure.panels[0].series if s.kind == "line"]
        labeled = [s for s in figure.panels[0].series if s.labels]
        obstacles = np.vstack([_dense(ax, s.x, s.y) for s in (*lines, *labeled)])
        written: list[tuple[str, Bbox]] = []
        for series in labeled:
            spots = ax.transData.transform(np.column_stack([series.x, series.y]))
            chosen = _spread(spots)
            for k in [*chosen[:1], *chosen[:0:-1]]:  # the ends first
                outward = spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0)
                _write(ax, series.labels[k], spots[k], outward, obstacles, written)


def _dense(ax: Axes, x: Array, y: Array) -> Array:
    """Return points (n, 2) on a line in pixels, so close that no text fits between them."""
    spots = ax.transData.transform(np.column_stack([x, y]))
    at = np.arange(len(spots))
    fine = np.linspace(0, max(len(spots) - 1, 0), 20 * len(spots))
    return np.column_stack([np.interp(fine, at, column) for column in spots.T])


def _spread(spots: Array) -> list[int]:
    """Choose points along the line through `spots` (n, 2): all, or `NUMBERED` at similar distances."""
    if len(spots) <= NUMBERED:
        return list(range(len(spots)))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spots, axis=0).T))])
    nearest = np.abs(length[:, None] - np.linspace(0, length[-1], NUMBERED)).argmin(axis=0)
    return np.unique([0, *nearest, len(spots) - 1]).tolist()


def _write(
    ax: Axes,
    text: str,
    spot: Array,
    outward: Array,
    obstacles: Array,
    written: list[tuple[str, Bbox]],
) -> None:
    """Write `text` beside the point at `spot` (2,) in pixels, best in the direction `outward` (2,)."""
    pixel = ax.figure.figure.dpi / 72  # pixels per point
    near = Bbox([spot - 45 * pixel, spot + 45 * pixel])
    if any(text == label and near.overlaps(box) for label, box in written):
        return

    x, y = ax.transData.inverted().transform(spot)
    note = ax.annotate(
        text if written else f"{text} rad/s",
        (x, y),
        (0, 0),
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=8.5,
        color="0.25",
        path_effects=[withStroke(linewidth=2, foreground="white")],
    )
    half = np.array(note.get_window_extent().size) / 2
    angles = np.radians(np.arange(0, 360, 30))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    for direction in directions[np.argsort(-directions @ outward, kind="stable")]:
        distance = MARKER_SIZE * pixel + np.min(half / np.maximum(np.abs(direction), 1e-9))
        middle = spot + direction * distance
        low, high = middle - half, middle + half
        box = Bbox([low, high])
        is_inside = np.all(box.min >= ax.bbox.min) and np.all(box.max <= ax.bbox.max)
        covers = np.all((obstacles > low - pixel) & (obstacles < high + pixel), axis=1)
        if is_inside and not covers.any() and not any(box.overlaps(b) for _, b in written):
            note.set_position(tuple((middle - spot) / pixel))
            written.append((text, box))
            return
    note.remove()
