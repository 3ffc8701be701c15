"""The Nyquist diagram: panels for signals of different size, and numbers beside points where there is room."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Circle
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.response_band import radius, require_level
from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.plotting.response_series import (
    BAND_ALPHA,
    MARKER_SIZE,
    ResponseSeries,
    legend_entries,
    ratio,
    response_series,
    title,
)
from greybox.plotting.style import (
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    finish,
    flat_axes,
    legend_below,
    legend_inside,
    new_figure,
)

UNLIKE = 5.0  # ratio of magnitudes above which the smaller one would vanish beside the larger
REPEAT_DISTANCE = 45.0  # points (1/72 inch) within which a number is not repeated
ANNOTATED = 12  # points of one data set up to which all have their number
BAND_REACH = (
    0.5  # of the extent of points and curves, which a band may add to it: a wider one is cut off
)
ZERO = "zero"  # marks the lines through the origin


def nyquist(
    *fits: Fit | FrequencyResponse,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    legend: bool = True,
    level: float | None = 0.95,
) -> AxesArray:
    """Draw the Nyquist diagram: measured points, numbered by their frequency in rad/s, and the fitted curves.

    Around every point of known variance is the region that holds the true response at this level, a
    circle since both components have half of the variance. Shaded around a fitted curve is what the
    confidence ellipses of its points cover (`Fit.response_band`).

    Input-output pairs whose magnitudes differ by more than a factor of 5 have one panel each. A
    curve that extends so far that the data would be a dot is cut off, and the title says so.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        All are drawn into one diagram; data that several fits share are drawn once. A measured
        response is drawn as points, one that was evaluated from a model (`Fit.response`,
        `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.
    axes : Axes or array-like of Axes, optional
        One for everything, or one for each input-output pair. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and inside axes that are given.
    level : float or None
        Of the regions; None draws none.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        One for each panel; the last line of a notebook cell is
        ``gb.plotting.nyquist(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, or for a wrong number of labels or axes.
    """
    if level is not None:
        require_level(level)
    series = response_series(fits, labels, level)
    if axes is not None:
        drawn = flat_axes(axes)
        groups = _groups_for(series, drawn.size)
    else:
        groups = panels(series)
        rows, columns = grid(len(groups))
        figure = new_figure(1.8 + 4.6 * columns, 1.2 + 4.6 * rows)
        drawn = panel_axes(figure, len(groups))

    draw_nyquist(drawn, groups, level)

    if axes is None:
        add_title(drawn[0].figure, drawn, title(fits))
        if legend:
            legend_below(drawn[0].figure, legend_entries(series))
    else:
        for ax, members in zip(drawn, groups, strict=True):
            if legend:
                legend_inside(ax, legend_entries(members))

    number_points(drawn, groups)
    return drawn


def panels(series: Sequence[ResponseSeries]) -> list[list[ResponseSeries]]:
    """Return the series of each panel: one for each input-output pair if their magnitudes differ, else one for all."""
    pairs = _by_pair(series)
    sizes = [size for size in map(_largest_magnitude, pairs) if size > 0]
    return pairs if sizes and max(sizes) > UNLIKE * min(sizes) else [list(series)]


def _by_pair(series: Sequence[ResponseSeries]) -> list[list[ResponseSeries]]:
    known = dict.fromkeys(
        one.pair for one in sorted(series, key=lambda one: not one.measured)
    )  # in the data's order
    return [[one for one in series if one.pair == pair] for pair in known]


def _groups_for(series: Sequence[ResponseSeries], count: int) -> list[list[ResponseSeries]]:
    if count == 1:
        return [list(series)]
    pairs = _by_pair(series)
    if len(pairs) != count:
        raise ValueError(
            f"`axes` has {count} axes for {counted(len(pairs), 'input-output pair')}: give one, or one for each pair."
        )
    return pairs


def grid(count: int) -> tuple[int, int]:
    """Return the rows and columns of `count` panels."""
    columns = int(np.ceil(np.sqrt(count)))
    return -(-count // columns), columns


def panel_axes(figure: Figure | SubFigure, count: int) -> AxesArray:
    """Make the axes of `count` panels in a figure or a part of one."""
    places = figure.subplots(*grid(count), squeeze=False).ravel()
    for spare in places[count:]:
        spare.remove()
    return places[:count]


def add_title(figure: Figure | SubFigure, drawn: AxesArray, text: str) -> None:
    """Write the title over the only panel, or over all."""
    if len(drawn) == 1:
        drawn[0].set_title(
            "\n".join(filter(None, [text, drawn[0].get_title()])), fontsize=TITLE_SIZE
        )
    else:
        figure.suptitle(text, fontsize=TITLE_SIZE)


def draw_nyquist(
    drawn: AxesArray, groups: Sequence[Sequence[ResponseSeries]], level: float | None
) -> None:
    """Draw each group of series into its panel; the title of a panel says if curves are cut off."""
    for ax, members in zip(drawn, groups, strict=True):
        _draw_panel(ax, members, level)


def _draw_panel(ax: Axes, series: Sequence[ResponseSeries], level: float | None) -> None:
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=1, gid=ZERO)
    ax.axvline(0, color="0.6", linewidth=0.8, zorder=1, gid=ZERO)
    for one in series:
        ax.plot(one.response.alpha, one.response.beta, **one.look)
    ax.margins(0.12)
    ax.set_aspect("equal", adjustable="datalim")
    if level is not None:
        _draw_regions(ax, series, level)
    finish(ax, f"Imaginary part of {ratio(series)}")
    ax.set_xlabel(f"Real part of {ratio(series)}", fontsize=11)
    note = _keep_data_visible(ax, series)
    if note:
        ax.set_title(note, fontsize=TITLE_SIZE)


def _draw_regions(ax: Axes, series: Sequence[ResponseSeries], level: float) -> None:
    """Draw the circles around measured points and the ellipses along curves."""
    for one in series:
        if one.band is not None:
            outlines = one.band.ellipses()
            shapes = [np.column_stack([e.real, e.imag]) for e in outlines if np.all(np.isfinite(e))]
            # Opaque, and of a pale color: where ellipses overlap, transparent ones would add up.
            pale = tuple(1 - BAND_ALPHA * (1 - part) for part in to_rgb(one.color))
            ax.add_collection(
                PolyCollection(shapes, facecolors=[pale], linewidths=0, zorder=0.5), autolim=False
            )
            reach = ax.dataLim.expanded(1 + BAND_REACH, 1 + BAND_REACH)
            ax.update_datalim(np.clip(np.vstack([np.zeros((0, 2)), *shapes]), reach.min, reach.max))
        if one.measured and one.response.variance is not None:
            data = one.response
            assert data.variance is not None
            dof = np.full(len(data), np.inf) if data.dof is None else data.dof
            radii = np.sqrt(data.variance / 2) * [radius(level, each) for each in dof]
            circles = [
                Circle(place, r)
                for place, r in zip(zip(data.alpha, data.beta, strict=True), radii, strict=True)
            ]
            look = {
                "facecolors": "none",
                "edgecolors": one.color,
                "linewidths": 0.8,
                "alpha": 0.6,
                "zorder": 2,
            }
            ax.add_collection(PatchCollection(circles, **look), autolim=False)


def _largest_magnitude(series: Sequence[ResponseSeries]) -> float:
    """Return the largest magnitude that was measured; without data, that of the curves."""
    measured = [one for one in series if one.measured] or series
    return max((float(np.abs(one.response.response).max()) for one in measured), default=0.0)


def _keep_data_visible(ax: Axes, series: Sequence[ResponseSeries]) -> str:
    """Cut off curves that would make the data a dot, and return a line that says so, or nothing."""
    data = [one.response for one in series if one.measured]
    size = _largest_magnitude(series)
    curve_size = _largest_magnitude([one for one in series if not one.measured])
    if not data or not 0 < UNLIKE * size < curve_size:
        return ""

    spots = np.vstack([np.zeros((1, 2)), *(np.column_stack([one.alpha, one.beta]) for one in data)])
    corners = np.array([spots.min(axis=0), spots.max(axis=0)])
    ax.dataLim.set_points(corners + np.array([[-0.5], [0.5]]) * size)
    ax.autoscale_view()
    return f"cut off: curves reach a magnitude of {curve_size:.3g}"


def number_points(drawn: AxesArray, groups: Sequence[Sequence[ResponseSeries]]) -> None:
    """Write the frequencies beside the points of the panels, wherever there is room for one."""
    drawn[
        0
    ].figure.figure.draw_without_rendering()  # lays the axes out, so that places on the page are known
    for ax, members in zip(drawn, groups, strict=True):
        _number_panel(ax, [one.response for one in members if one.measured])


def _number_panel(ax: Axes, measured: Sequence[FrequencyResponse]) -> None:
    places = [ax.transData.transform(np.column_stack([data.alpha, data.beta])) for data in measured]
    room = _Room(ax, [np.zeros((0, 2)), *places])
    for data, place in zip(measured, places, strict=True):
        order = np.argsort(data.omega)
        omega = data.omega[order]
        spots = place[order]
        chosen = _spread(spots)
        for k in [*chosen[:1], *chosen[:0:-1]]:  # the ends first
            unit = "" if room.used else " rad/s"
            room.write(
                _brief(omega[k]) + unit,
                spots[k],
                spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0),
            )


def _spread(spots: NDArray) -> list[int]:
    """Choose points along the line through `spots` (n, 2): all, or `ANNOTATED` of about the same distance."""
    if len(spots) <= ANNOTATED:
        return list(range(len(spots)))
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(spots, axis=0).T))])
    nearest = np.abs(length[:, None] - np.linspace(0, length[-1], ANNOTATED)).argmin(axis=0)
    return np.unique([0, *nearest, len(spots) - 1]).tolist()


def _brief(omega: float) -> str:
    """Return a frequency with three digits, without exponent where that is readable."""
    return f"{float(f'{omega:.3g}'):g}"


class _Room:
    """The page around the points: knows what is taken, and writes where nothing is. Lengths are in pixels."""

    def __init__(self, ax: Axes, points: Sequence[NDArray]) -> None:
        self._ax = ax
        self._pixel = ax.figure.figure.dpi / 72  # pixels a point
        self._points = np.vstack(points)
        self._curves: list[Path] = []
        self._lines: list[Path] = []  # with the lines through the origin
        for line in ax.get_lines():
            if line.get_linestyle() == "None":
                continue
            path = line.get_path().transformed(line.get_transform())
            self._lines.append(path)
            if line.get_gid() != ZERO:
                self._curves.append(path)
        self._written: list[tuple[str, NDArray, Bbox]] = []

    @property
    def used(self) -> bool:
        """True when something is written."""
        return bool(self._written)

    def write(self, text: str, spot: NDArray, outward: NDArray) -> None:
        """Write `text` beside the point at `spot` (2,), best in the direction `outward` (2,), if not just said."""
        near = [
            t
            for t, place, _ in self._written
            if np.hypot(*(spot - place)) < REPEAT_DISTANCE * self._pixel
        ]
        if text.removesuffix(" rad/s") in [other.removesuffix(" rad/s") for other in near]:
            return
        look = {
            "fontsize": 8.5,
            "color": "0.25",
            "path_effects": [withStroke(linewidth=2, foreground="white")],
        }
        x, y = self._ax.transData.inverted().transform(spot)
        note = self._ax.annotate(
            text, (x, y), (0, 0), textcoords="offset points", ha="center", va="center", **look
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
