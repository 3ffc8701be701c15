"""Numbers beside the points of a diagram, wherever there is room for one."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from greybox.plotting.figure import Figure, Series
from greybox.plotting.matplotlib_figure import MARKER_SIZE, ORIGIN, AxesArray

REPEAT_DISTANCE = 45.0  # points (1/72 inch) within which a number is not repeated
NUMBERED = 12  # points of one series up to which all have their number


def number_points(axes: AxesArray, figures: Sequence[Figure]) -> None:
    """Write the labels of the points, frequencies in rad/s, into axes that have been drawn."""
    axes[0].figure.figure.draw_without_rendering()  # the layout must be known
    for ax, figure in zip(axes, figures, strict=True):
        labeled = [series for series in figure.panels[0].series if series.labels]
        room = _Room(ax, labeled)
        for series in labeled:
            spots = ax.transData.transform(np.column_stack([series.x, series.y]))
            chosen = _spread(spots)
            for k in [*chosen[:1], *chosen[:0:-1]]:  # the ends first
                outward = spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0)
                room.write(series.labels[k], spots[k], outward)


def _spread(spots: NDArray) -> list[int]:
    """Choose points along the line through `spots` (n, 2): all, or `NUMBERED` at similar distances."""
    if len(spots) <= NUMBERED:
        return list(range(len(spots)))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spots, axis=0).T))])
    nearest = np.abs(length[:, None] - np.linspace(0, length[-1], NUMBERED)).argmin(axis=0)
    return np.unique([0, *nearest, len(spots) - 1]).tolist()


class _Room:
    """The places of a panel that are taken. Lengths are in pixels."""

    def __init__(self, ax: Axes, labeled: Sequence[Series]) -> None:
        self._ax = ax
        self._pixel = ax.figure.figure.dpi / 72  # pixels per point
        spots = [np.column_stack([series.x, series.y]) for series in labeled]
        self._points = ax.transData.transform(np.vstack([np.zeros((0, 2)), *spots]))
        self._curves: list[Path] = []
        self._lines: list[Path] = []  # with the lines through the origin
        for line in ax.get_lines():
            if line.get_linestyle() == "None":
                continue
            path = line.get_path().transformed(line.get_transform())
            self._lines.append(path)
            if line.get_gid() != ORIGIN:
                self._curves.append(path)
        self._written: list[tuple[str, NDArray, Bbox]] = []

    def write(self, text: str, spot: NDArray, outward: NDArray) -> None:
        """Write `text` beside the point at `spot` (2,), best in the direction `outward` (2,)."""
        for other, place, _ in self._written:
            if text == other and np.hypot(*(spot - place)) < REPEAT_DISTANCE * self._pixel:
                return
        shown = text if self._written else f"{text} rad/s"
        look = {
            "fontsize": 8.5,
            "color": "0.25",
            "path_effects": [withStroke(linewidth=2, foreground="white")],
        }
        x, y = self._ax.transData.inverted().transform(spot)
        note = self._ax.annotate(
            shown, (x, y), (0, 0), textcoords="offset points", ha="center", va="center", **look
        )
        half = np.array(note.get_window_extent().size) / 2
        offsets = self._offsets(half, outward)
        # Where nothing else is free, on the lines through the origin.
        for offset, lines in [
            *((d, self._lines) for d in offsets),
            *((d, self._curves) for d in offsets),
        ]:
            box = Bbox(np.array([spot + offset - half, spot + offset + half]))
            if self._is_free(box, lines):
                note.set_position(tuple(offset / self._pixel))
                self._written.append((text, spot, box))
                return
        note.remove()

    def _offsets(self, half: NDArray, outward: NDArray) -> list[NDArray]:
        """Return places around a point for the middle of a text of half the size `half` (2,), outward ones first."""
        angles = np.radians(np.arange(0, 360, 30))
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        directions = directions[np.argsort(-directions @ outward, kind="stable")]
        return [
            d * (MARKER_SIZE * self._pixel + np.min(half / np.maximum(np.abs(d), 1e-9)))
            for d in directions
        ]

    def _is_free(self, box: Bbox, lines: Sequence[Path]) -> bool:
        wide = box.padded(self._pixel * MARKER_SIZE / 2)
        near = box.padded(self._pixel)
        frame = self._ax.bbox
        within = np.all(box.min >= frame.min) and np.all(box.max <= frame.max)
        covers = np.any(np.all((self._points > wide.min) & (self._points < wide.max), axis=1))
        crossed = any(path.intersects_bbox(near, filled=False) for path in lines)
        return bool(within and not covers and not crossed) and not any(
            near.overlaps(b) for *_, b in self._written
        )
