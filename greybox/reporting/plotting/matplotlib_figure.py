"""The matplotlib renderer: draws a `Figure` value into new axes or into those of a user."""

import io
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure as MatplotlibFigure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from greybox.data.files.arrays import Array
from greybox.reporting.plotting.figure import (
    CROSS,
    GRAY,
    INK,
    Figure,
    Panel,
    Series,
    in_hertz,
    outlined,
)

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too
# pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
NAMED = {GRAY: "#999999", INK: "#222222"}
DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
MARKER_SIZE = 5.5  # points
# Number of points of one series above which markers shrink and lie below the curves.
CROWD = 100
# Number of samples above which a line is thinner.
LONG_LINE = 400
BAND_ALPHA = 0.2
# Kinds of series in the order of a legend.
ORDER = ("points", "line", "rule", "band", "regions")

AxesArray = NDArray[np.object_]
"""Matplotlib Axes, in one dimension."""

GivenAxes = Axes | Sequence[Axes] | AxesArray
"""Axes that a user made: a single one, or an array-like of them."""


class _NotebookFigure(MatplotlibFigure):
    """A figure that a notebook shows although pyplot is not imported, which registers figures."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def new_figure(width: float, height: float, title: str) -> MatplotlibFigure:
    """Return an empty figure of this size in inches."""
    # Not pyplot, which keeps every figure in memory until it is closed.
    page = _NotebookFigure(
        figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    )
    if title:
        page.suptitle(plain(title), fontsize=13)
    return page


# --- whole figures


def draw(
    figures: Sequence[Figure],
    axes: GivenAxes | None = None,
    *,
    legend: bool = True,
    columns: int = 1,
    size: tuple[float, float] = (6.4, 2.5),
    title: str = "",
    hz: bool = False,
) -> AxesArray:
    """Draw figures into the given axes, one for each panel, or into a new matplotlib figure.

    Panels of a single figure are stacked over one horizontal axis. Several figures stand side by
    side, each over its own axis. `size` of a panel in inches, `columns` and `title` are those of a
    new figure. With `hz`, frequencies in rad/s are in Hz.

    Raises
    ------
    TypeError, ValueError
        For anything but Axes, or a wrong number of them.
    """
    if axes is None:
        page = new_figure(size[0] * columns, height_of(figures, size[1], columns), title)
        return draw_into(page, figures, columns, legend, hz=hz)

    drawn = flat_axes(axes)
    names = [panel.title or panel.label for panel in _panels(figures)]
    if drawn.size != len(names):
        raise ValueError(
            f"{figures[0].title} has {len(names)} panels ({'; '.join(names)}), but `axes` has "
            f"{drawn.size}: give one for each."
        )
    for figure_axes, figure in _draw_panels(drawn, figures, hz):
        # Rows with names leave no free place: the legend stands above them.
        look = {"loc": "lower left", "bbox_to_anchor": (0, 1)} if figure.panels[0].ticks else {}
        if legend:
            _draw_legend(figure_axes[0], [figure], fontsize=9, **look)
    return drawn


def draw_into(
    place: MatplotlibFigure | SubFigure,
    figures: Sequence[Figure],
    columns: int,
    legend: bool = True,
    *,
    hz: bool,
) -> AxesArray:
    """Draw figures into an empty matplotlib figure or a part of one, with their legend below."""
    panels = _panels(figures)
    if len(figures) == 1:
        # The panels share one horizontal axis: zooming one panel zooms all.
        heights = [panel.height for panel in panels]
        axes = place.subplots(
            len(panels), 1, squeeze=False, sharex=True, height_ratios=heights
        ).ravel()
    else:
        rows = math.ceil(len(panels) / columns)
        axes = place.subplots(rows, columns, squeeze=False).ravel()
        for unused in axes[len(panels) :]:
            unused.remove()

    axes = axes[: len(panels)]
    _draw_panels(axes, figures, hz)
    place.align_ylabels(axes)
    if legend:
        # Below all panels, where it covers no data.
        width = place.bbox.width / place.dpi
        _draw_legend(place, figures, width, loc="outside lower center", fontsize=10, frameon=False)
    return axes


def height_of(figures: Sequence[Figure], inches: float, columns: int = 1) -> float:
    """Return the height in inches that figures with panels of this height need."""
    rows = math.ceil(len(_panels(figures)) / columns)
    if len(figures) == 1:
        rows = sum(panel.height for panel in figures[0].panels)
    # Names below the axis are written upright, and a letter takes 0.08 inch. Title, axis and legend
    # take 1.1 inch.
    letters = max((len(name) for figure in figures for name in figure.ticks), default=0)
    return 1.1 + 0.08 * letters + inches * rows


def flat_axes(axes: GivenAxes) -> AxesArray:
    """Return the axes of a user as an array (n,).

    Raises
    ------
    TypeError
        For anything but Axes.
    """
    # A single Axes, a list, or the two-dimensional array of plt.subplots.
    flat = np.array(axes, dtype=object).ravel()
    for item in flat:
        if not isinstance(item, Axes):
            raise TypeError(
                f"cannot draw into {item!r:.80}: give matplotlib Axes, e.g. those of "
                "plt.subplots()."
            )
    return flat


def _panels(figures: Sequence[Figure]) -> list[Panel]:
    """Return the panels of all figures."""
    return [panel for figure in figures for panel in figure.panels]


def _draw_panels(
    axes: AxesArray, figures: Sequence[Figure], hz: bool
) -> list[tuple[AxesArray, Figure]]:
    """Draw all panels, and return the figures with their axes."""
    if hz:
        figures = [in_hertz(figure) for figure in figures]
    drawn = []
    for figure in figures:
        figure_axes, axes = np.split(axes, [len(figure.panels)])
        for ax, panel in zip(figure_axes, figure.panels, strict=True):
            _draw_panel(ax, figure, panel)
        _horizontal_axis(figure_axes, figure)
        drawn.append((figure_axes, figure))

    return drawn


# --- one panel


def _draw_panel(ax: Axes, figure: Figure, panel: Panel) -> None:
    """Draw a panel of a figure, without its horizontal axis."""
    for start, end, color in figure.spans:
        ax.axvspan(start, end, color=color_of(color), alpha=0.15, linewidth=0)
    if figure.is_plane:
        # One scale, or distances and angles in the complex plane would mislead.
        ax.set_aspect("equal", adjustable="datalim")
    for series in panel.series:
        _DRAWERS[series.kind](ax, series)
    if figure.is_plane:
        _draw_plane(ax, figure, panel)
    subject = figure.subject if panel is figure.panels[0] else ""
    title = "\n".join(text for text in (subject, panel.title) if text)
    ax.set_title(plain(title), fontsize=12 if subject else 10, wrap=True)

    _vertical_axis(ax, panel)
    ax.set_ylabel(plain(panel.label), fontsize=11)
    ax.tick_params(labelsize=10)
    ax.grid(True, color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def _draw_line(ax: Axes, series: Series) -> None:
    look = _look(series)
    if len(series.x) == 1:
        look["marker"] = "+"  # matplotlib draws no line through one point
    ax.plot(series.x, _finite(series.y), **look)


def _draw_points(ax: Axes, series: Series) -> None:
    y = _finite(series.y)
    layer = 3.0 if len(y) <= CROWD else 1.5
    if series.low is not None and series.high is not None:
        # In the complex plane, the error of a point is a circle; elsewhere it is a bar.
        if ax.get_aspect() == 1:
            unit_circle = np.exp(1j * np.linspace(0, 2 * np.pi, 49))
            radius = (series.high - series.low)[:, None] / 2
            circles = (series.x + 1j * y)[:, None] + radius * unit_circle
            _draw_regions(ax, outlined(circles, series.color, is_hollow=True))
        else:
            look = {"colors": color_of(series.color), "linewidths": 1.0, "alpha": 0.2 * layer}
            bars = ax.hlines if series.is_across else ax.vlines
            places = y if series.is_across else series.x
            bars(places, _finite(series.low), _finite(series.high), zorder=layer - 0.3, **look)

    # The ink of all points together stays the same: a thousand points must not hide the curve.
    size = MARKER_SIZE * min(1.0, (CROWD / max(len(y), 1)) ** 0.5)
    ax.plot(series.x, y, **{**_look(series), "markersize": max(2.0, size)}, zorder=layer)


def _draw_band(ax: Axes, series: Series) -> None:
    assert series.low is not None
    assert series.high is not None
    # `fill_between` omits infinity, so that the limits need no `_finite`.
    ax.fill_between(
        series.x,
        series.low,
        series.high,
        color=color_of(series.color),
        alpha=BAND_ALPHA,
        linewidth=0,
        zorder=1.1,
    )


def _draw_rule(ax: Axes, series: Series) -> None:
    color, dash = color_of(series.color), _dash(series)
    ax.axhline(series.y[0], zorder=1, color=color, linewidth=0.8, linestyle=dash)


def _draw_regions(ax: Axes, series: Series) -> None:
    color = color_of(series.color)
    look = {"facecolors": "none", "edgecolors": color, "linewidths": 0.8}
    look |= {"linestyles": _dash(series), "alpha": 0.6, "zorder": 2}
    if not series.is_hollow:
        # A pale opaque color: transparent ellipses would become dark where they overlap.
        pale = tuple(1 - BAND_ALPHA * (1 - part) for part in to_rgb(color))
        look = {"facecolors": [pale], "linewidths": 0, "zorder": 0.5}
    vertices = np.column_stack([series.x, series.y])
    pieces = np.ma.clump_unmasked(np.ma.masked_invalid(series.x))
    ax.add_collection(PolyCollection([vertices[rows] for rows in pieces], **look), autolim=False)


_DRAWERS = {
    "line": _draw_line,
    "points": _draw_points,
    "band": _draw_band,
    "rule": _draw_rule,
    "regions": _draw_regions,
}


def _draw_plane(ax: Axes, figure: Figure, panel: Panel) -> None:
    """Give both axes their lines through zero, and number the points."""
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    ax.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    ax.margins(0.12)

    # Confidence regions may be many times as wide as the data, which would then be a dot: they
    # widen the limits by half at most.
    reach = ax.dataLim.expanded(1.5, 1.5)
    for series in panel.series:
        if series.kind == "regions" and not series.is_hollow:
            ax.update_datalim(np.clip(np.column_stack([series.x, series.y]), reach.min, reach.max))

    if figure.limits is not None and panel.limits is not None:
        ax.dataLim.set_points(np.array([figure.limits, panel.limits]).T)
        ax.margins(0)

    _write_labels(ax, panel, figure.unit)


def _write_labels(ax: Axes, panel: Panel, unit: str) -> None:
    """Write labels beside the points, on the outer side of their curve, where there is room."""
    # On the inner side of a bend labels would lie on the curve.
    room = max(ax.dataLim.width, ax.dataLim.height) / 14
    look = {"fontsize": 8.5, "color": "0.25", "ha": "center", "va": "center"}
    outline = [withStroke(linewidth=2, foreground="white")]
    written: list[tuple[str, complex]] = []

    def has_room(text: str, point: complex) -> bool:
        for other_text, other_point in written:
            # Points of several tests at one frequency lie near each other: one number is enough.
            needed = 3 * room if text == other_text else room
            if abs(point - other_point) < needed:
                return False
        return True

    for series in panel.series:
        if not series.labels:
            continue
        points = series.x + 1j * series.y
        # Labels lie on the side away from the middle of the points, that of a single point at the
        # right: the tiny number gives zero a direction.
        away = points - points.mean() + 1e-300
        outward = away / np.abs(away)
        for text, point, normal in zip(series.labels, points, outward, strict=True):
            if not has_room(text, point):
                continue
            # The first label has the unit. A longer label begins farther away.
            label = text if written else f"{text} {unit}"
            offset = (normal.real * (7 + 2.2 * len(label)), normal.imag * 11)  # points
            ax.annotate(
                label,
                (point.real, point.imag),
                offset,
                textcoords="offset points",
                path_effects=outline,
                **look,
            )
            written.append((text, point))


def _look(series: Series) -> dict[str, Any]:
    """Return the keywords of matplotlib's `plot`."""
    color = color_of(series.color)
    look = {"color": color, "label": plain(series.name) or "_"}
    if series.kind in ("line", "rule", "regions"):
        width = 1.6
        if series.is_hollow:
            width = 0.3
        elif len(series.x) > LONG_LINE:
            # Long records swing so fast that wide lines would fill the panel. Measurements are gray
            # and must be visible beside the thin lines on them.
            width = 2.4 if series.color == GRAY else 0.9
        return {**look, "linestyle": _dash(series), "linewidth": width}

    look |= {"linestyle": "none", "markersize": MARKER_SIZE}
    if series.style == CROSS:
        return {**look, "marker": "x"}
    look["marker"] = MARKERS[series.style % len(MARKERS)]
    if series.is_hollow:
        return {**look, "markerfacecolor": "none", "markeredgecolor": color}
    return {**look, "markeredgecolor": "white", "markeredgewidth": 0.5}


def _dash(series: Series) -> str:
    """Return the line style of a series."""
    return DASHES[series.style % len(DASHES)]


def _finite(values: Array) -> Array:
    """Replace infinity, as the logarithm of zero, by NaN: matplotlib would scale axes to it."""
    return np.where(np.isfinite(values), values, np.nan)


def color_of(number: int) -> str:
    """Return the color of this number."""
    return NAMED.get(number) or COLORS[number % len(COLORS)]


def plain(text: str) -> str:
    """Return text that matplotlib shows as it is."""
    # Dollar signs begin mathematics, and matplotlib leaves a label with a leading underscore out of
    # a legend.
    return text.lstrip("_").replace("$", r"\$")


# --- axes


def _vertical_axis(ax: Axes, panel: Panel) -> None:
    """Set scale, limits and ticks of the vertical axis."""
    if panel.is_logarithmic:
        ax.set_yscale("log")
    if panel.limits is not None and ax.get_aspect() != 1:  # equal aspect changes the limits
        ax.set_ylim(panel.limits)
    if panel.is_logarithmic:
        _number_decades(ax.yaxis, *ax.get_ylim())

    low, high = ax.get_ylim()
    span = float(high) - float(low)  # floats of Python, which warn of no overflow
    if panel.ticks:
        ax.set_yticks(range(1, len(panel.ticks) + 1), [*map(plain, panel.ticks)])
    elif not panel.is_logarithmic:
        steps = [1, 2, 5, 10]
        # Over less than 60 degrees, these steps read well for angles too.
        if panel.steps and span > 60:
            steps = [1, 1.5, 3, 4.5, 9, 10]
        most = 7 if panel.height >= 1 else 4
        ax.yaxis.set_major_locator(MaxNLocator(most, steps=steps))


def _horizontal_axis(axes: AxesArray, figure: Figure) -> None:
    """Set label, scale, limits and ticks of the horizontal axes of a figure."""
    for ax in axes:
        # Only the lowest of stacked panels has a label.
        if ax.xaxis.get_tick_params().get("labelbottom", True):
            ax.set_xlabel(plain(figure.label), fontsize=11)
        if figure.limits is not None and not figure.is_plane:
            ax.set_xlim(figure.limits)
        if figure.ticks:
            names = [*map(plain, figure.ticks)]
            ax.set_xticks(range(1, len(names) + 1), names, rotation=90)
        if figure.is_whole:
            ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))

    if figure.is_logarithmic:
        # The limits include everything in the axes, also what a user drew into them before.
        low = min(ax.dataLim.minposx for ax in axes)
        high = max(ax.dataLim.xmax for ax in axes)
        for ax in axes:
            ax.set(xscale="log", xlim=(low / 1.15, high * 1.15))
            _number_decades(ax.xaxis, low, high)


def _number_decades(axis: Axis, low: float, high: float) -> None:
    """Write plain numbers at a logarithmic axis: 60, not 6 times a power of ten."""
    if high < 5 * low:
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]))
    elif high < 1e3 * low:
        # Up to three decades have room for 1, 2 and 5 of each.
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    else:
        axis.set_major_locator(LogLocator(subs=(1,)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


# --- legends


def _legend_entries(figures: Sequence[Figure]) -> dict[str, tuple[Artist, ...]]:
    """Return the keys by label: points, lines, then bands; a label has a key for every color."""
    drawn = []
    for figure in figures:
        for panel in figure.panels:
            for series in panel.series:
                drawn.append((figure, panel, series))
    drawn.sort(key=lambda item: ORDER.index(item[2].kind))
    # One entry "measured" with the markers of six data sets is read faster than six entries: the
    # keys of a name are distinguished by color and style.
    keys: dict[str, dict[tuple[int, int], Artist]] = {}
    # In panels below the first one with a name, the name may have another style.
    first_panels: dict[str, Panel] = {}
    for figure, panel, series in drawn:
        is_area = series.kind in ("band", "regions") and not series.is_hollow
        name = figure.bands if is_area else series.name
        if name and first_panels.setdefault(name, panel) is panel:
            key = Line2D([], [], **_look(series))
            if is_area:
                key = Patch(color=color_of(series.color), alpha=BAND_ALPHA, linewidth=0)
            keys.setdefault(plain(name), {})[series.color, series.style] = key

    entries = {}
    for name, by_look in keys.items():
        entries[name] = tuple(by_look[look] for look in sorted(by_look))
    return entries


def _draw_legend(place: Any, figures: Sequence[Figure], width: float = 0.0, **look: Any) -> None:
    """Draw a legend in as many columns as fit a width in inches; keys of a label side by side."""
    entries = _legend_entries(figures)
    if not entries:
        return
    # Length of the keys in em: several keys of a label need more than one.
    length = max(2.0, 1.2 * max(map(len, entries.values())))
    # Widths of the first columns, in letters, if they have the longest labels. A letter of 10
    # points takes about 1/11 inch, an em of the key 1.5 letters.
    letters = np.cumsum(sorted(map(len, entries), reverse=True))
    widths = letters + (3 + 1.5 * length) * np.arange(1, 1 + len(entries))
    columns = max(1, np.count_nonzero(widths <= 11 * width))
    handlers = {tuple: HandlerTuple(ndivide=None, pad=0.4)}
    look |= {"ncols": columns, "handler_map": handlers, "handlelength": length}
    place.legend([*entries.values()], [*entries], **look)
