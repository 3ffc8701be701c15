"""Texts on a figure: names as symbols, and numbers beside points where there is room."""

import unicodedata
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

MARKER_SIZE = 5.5  # points
NEAR = 45.0  # points on the page, within which a number is not repeated


def plain(text: str) -> str:
    """Return `text` as matplotlib is to show it: no mathematics, and no underscore that hides it from a legend."""
    return text.lstrip("_").replace("$", r"\$")


def symbol(name: str) -> str:
    """Return a signal's name with Greek letters: theta is θ, u_phi is u_φ."""
    return "_".join(_greek(part) for part in name.split("_"))


def _greek(name: str) -> str:
    size = "SMALL" if name.islower() else "CAPITAL" if name.istitle() else "no"
    try:
        return unicodedata.lookup(f"GREEK {size} LETTER {name}")
    except KeyError:
        return name.replace("$", r"\$")


class Room:
    """The page around the points: knows what is taken, and writes where nothing is. Lengths are in pixels."""

    def __init__(self, axes: Axes, points: Sequence[NDArray]) -> None:
        self._axes, self._pixel, self._points = axes, axes.figure.dpi / 72, np.vstack(points)
        lines = [line for line in axes.get_lines() if line.get_linestyle() != "None"]
        self._lines = [line.get_path().transformed(line.get_transform()) for line in lines]
        self._written: list[tuple[str, NDArray, Bbox]] = []

    def write(self, text: str, spot: NDArray, outward: NDArray) -> None:
        """Write `text` beside the point at `spot` (2,), best in the direction `outward` (2,), if not just said."""
        near = [said for said, there, _ in self._written if np.hypot(*(spot - there)) < NEAR * self._pixel]
        if text.removesuffix(" rad/s") in [said.removesuffix(" rad/s") for said in near]:
            return
        look = {"fontsize": 8.5, "color": "0.25", "path_effects": [withStroke(linewidth=2, foreground="white")]}
        x, y = self._axes.transData.inverted().transform(spot)
        note = self._axes.annotate(text, (x, y), (0, 0), textcoords="offset points", ha="center", va="center", **look)
        half = np.array(note.get_window_extent().size) / 2
        offsets = self._offsets(half, outward)
        for offset, lines in [*((d, self._lines) for d in offsets), *((d, self._lines[2:]) for d in offsets)]:
            box = Bbox(np.array([spot + offset - half, spot + offset + half]))
            if self._is_free(box, lines):  # at last on the axes through zero, which are the first two lines
                note.set_position(tuple(offset / self._pixel))
                self._written.append((text, spot, box))
                return
        note.remove()

    def _offsets(self, half: NDArray, outward: NDArray) -> list[NDArray]:
        """Return places around a point for the middle of a text of half the size `half` (2,), outward ones first."""
        angles = np.radians(np.arange(0, 360, 30))
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        directions = directions[np.argsort(-directions @ outward, kind="stable")]
        return [d * (MARKER_SIZE * self._pixel + np.min(half / np.maximum(np.abs(d), 1e-9))) for d in directions]

    def _is_free(self, box: Bbox, lines: Sequence[Path]) -> bool:
        wide, near, frame = box.padded(self._pixel * MARKER_SIZE / 2), box.padded(self._pixel), self._axes.bbox
        within = np.all(box.min >= frame.min) and np.all(box.max <= frame.max)
        covers = np.any(np.all((self._points > wide.min) & (self._points < wide.max), axis=1))
        crossed = any(path.intersects_bbox(near, filled=False) for path in lines)
        return bool(within and not covers and not crossed) and not any(near.overlaps(b) for *_, b in self._written)
