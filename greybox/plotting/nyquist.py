"""The Nyquist diagram: panels for signals of different size, and numbers beside points where there is room."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.plotting.style import MARKER_SIZE, Series, finish, legend, ratio

UNLIKE = 5.0  # ratio of magnitudes above which the smaller one would vanish beside the larger
NEAR = 45.0  # points on the page, within which a number is not repeated
MANY = 12  # points of one data set that are all annotated


def panels(series: Sequence[Series]) -> list[list[Series]]:
    """Return the series of each panel: one for each input-output pair if their magnitudes differ, else one for all."""
    known = dict.fromkeys(one.pair for one in sorted(series, key=lambda one: not one.measured))  # in the data's order
    pairs = [[one for one in series if one.pair == pair] for pair in known]
    sizes = [size for size in map(_size, pairs) if size > 0]
    return pairs if sizes and max(sizes) > UNLIKE * min(sizes) else [list(series)]


def grid(count: int) -> tuple[int, int]:
    """Return the rows and columns of `count` panels."""
    columns = int(np.ceil(np.sqrt(count)))
    return -(-count // columns), columns


def draw_nyquist(figure: Figure | SubFigure, series: Sequence[Series], title: str) -> list[Axes]:
    """Draw all panels and a legend; return the axes of the `panels`."""
    groups = panels(series)
    places = figure.subplots(*grid(len(groups)), squeeze=False).ravel().tolist()
    for spare in places[len(groups) :]:
        spare.remove()
    alone = len(groups) == 1
    for axes, members in zip(places, groups, strict=False):
        _draw_panel(axes, members, [title] if alone else [])
    if not alone:
        figure.suptitle(title, fontsize=12)
    legend(figure, series)
    return places[: len(groups)]


def _draw_panel(axes: Axes, series: Sequence[Series], title: Sequence[str]) -> None:
    axes.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    axes.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    for one in series:
        axes.plot(one.response.alpha, one.response.beta, **one.look)
    axes.margins(0.12)
    axes.set_aspect("equal", adjustable="datalim")
    finish(axes, f"Real part of {ratio(series)}", f"Imaginary part of {ratio(series)}")
    axes.set_title("\n".join([*title, *_keep_data_visible(axes, series)]), fontsize=12)


def _size(series: Sequence[Series]) -> float:
    """Return the largest magnitude that was measured; without data, that of the curves."""
    measured = [one for one in series if one.measured] or series
    return max((float(np.abs(one.response.response).max()) for one in measured), default=0.0)


def _keep_data_visible(axes: Axes, series: Sequence[Series]) -> list[str]:
    """Cut off curves that would make the data a dot, and return a line that says so."""
    data, reach = [one.response for one in series if one.measured], _size([k for k in series if not k.measured])
    size = _size(series)
    if not data or not 0 < UNLIKE * size < reach:
        return []
    spots = np.vstack([np.zeros((1, 2)), *(np.column_stack([one.alpha, one.beta]) for one in data)])
    corners = np.array([spots.min(axis=0), spots.max(axis=0)])
    axes.dataLim.set_points(corners + np.array([[-0.5], [0.5]]) * size)
    axes.autoscale_view()
    return [f"cut off: curves reach a magnitude of {reach:.3g}"]


def number_points(figure: Figure, drawn: Sequence[Axes], series: Sequence[Series]) -> None:
    """Write the frequencies beside the points of the panels, wherever there is room for one."""
    figure.draw_without_rendering()  # lays the axes out, so that places on the page are known
    for axes, members in zip(drawn, panels(series), strict=True):
        _number_panel(axes, [one.response for one in members if one.measured])


def _number_panel(axes: Axes, measured: Sequence[FrequencyResponse]) -> None:
    places = [axes.transData.transform(np.column_stack([data.alpha, data.beta])) for data in measured]
    room = Room(axes, [np.zeros((0, 2)), *places])
    for data, place in zip(measured, places, strict=True):
        order = np.argsort(data.omega)
        omega, spots = data.omega[order], place[order]
        chosen = _spread(spots)
        for k in [*chosen[:1], *chosen[:0:-1]]:  # the ends first
            unit = "" if room.used else " rad/s"
            room.write(_brief(omega[k]) + unit, spots[k], spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0))


def _spread(spots: NDArray) -> list[int]:
    """Choose points along the way through `spots` (n, 2): all, or `MANY` of about the same distance."""
    if len(spots) <= MANY:
        return list(range(len(spots)))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spots, axis=0).T))])
    places = np.abs(way[:, None] - np.linspace(0, way[-1], MANY)).argmin(axis=0)
    return np.unique([0, *places, len(spots) - 1]).tolist()


def _brief(omega: float) -> str:
    """Return a frequency with three digits, without exponent where that is readable."""
    return f"{float(f'{omega:.3g}'):g}"


class Room:
    """The page around the points: knows what is taken, and writes where nothing is. Lengths are in pixels."""

    def __init__(self, axes: Axes, points: Sequence[NDArray]) -> None:
        self._axes, self._pixel, self._points = axes, axes.figure.dpi / 72, np.vstack(points)
        lines = [line for line in axes.get_lines() if line.get_linestyle() != "None"]
        self._lines = [line.get_path().transformed(line.get_transform()) for line in lines]
        self._written: list[tuple[str, NDArray, Bbox]] = []

    @property
    def used(self) -> bool:
        """True when something is written."""
        return bool(self._written)

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
