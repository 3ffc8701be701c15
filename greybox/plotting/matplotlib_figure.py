"""The matplotlib renderer: draws a `Figure` value into new axes or into those of a user."""

import io
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure as MatplotlibFigure
from matplotlib.figure import SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter
from numpy.typing import NDArray

from greybox.files.arrays import Array
from greybox.plotting.figure import CROSS, GRAY, INK, Figure, Panel, Series

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too
# pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
MARKER_SIZE = 5.5  # points
CROWD = 100  # points of one series above which markers shrink and lie below the curves
BAND_ALPHA = 0.2

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


def new_figure(width: float, height: float, title: str = "") -> MatplotlibFigure:
    """Return an empty figure of this size in inches."""
    # Not pyplot, which keeps every figure in memory until it is closed.
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08)
    page = _NotebookFigure(figsize=(width, height), layout=layout)
    if title:
        page.suptitle(plain(title), fontsize=13)
    return page


# --- whole figures


def draw(
    figure: Figure,
    axes: GivenAxes | None = None,
    *,
    legend: bool = True,
    width: float = 6.4,
    inches: float = 2.5,
) -> AxesArray:
    """Draw a figure into the given axes, one for each panel, or into a new one.

    `width` and `inches`, the height of a usual panel, are those of a new figure.

    Raises
    ------
    TypeError, ValueError
        For anything but Axes, or a wrong number of them.
    """
    if axes is None:
        return draw_into(new_figure(width, height_of(figure, inches)), figure, legend=legend)

    drawn = _one_for_each([figure], axes)
    _draw_panels(drawn, figure)
    _write_title(drawn[0], figure)
    if legend:
        _legend_inside(drawn[0], figure)
    return drawn


def draw_into(
    place: MatplotlibFigure | SubFigure, figure: Figure, *, legend: bool = True
) -> AxesArray:
    """Draw a figure into an empty matplotlib figure or a part of one, with its legend below."""
    # One horizontal axis: zooming one panel zooms all.
    heights = [panel.height for panel in figure.panels]
    axes = place.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    _draw_panels(axes, figure)
    _write_title(axes[0], figure)
    place.align_ylabels(axes)
    if legend:
        _legend_below(place, [figure])
    return axes


def draw_grid(
    figures: Sequence[Figure],
    axes: GivenAxes | None = None,
    *,
    columns: int,
    size: tuple[float, float],
    title: str = "",
    legend: bool = False,
) -> AxesArray:
    """Draw the panels of several figures side by side, each over its own horizontal axis.

    `columns`, the `size` of a panel in inches and `title` are those of a new figure.

    Raises
    ------
    TypeError, ValueError
        For anything but Axes, or a wrong number of them.
    """
    if axes is None:
        rows = -(-sum(len(figure.panels) for figure in figures) // columns)
        page = new_figure(size[0] * columns, size[1] * rows + 0.4, title)
        return draw_grid_into(page, figures, columns, legend=legend)

    drawn = _one_for_each(figures, axes)
    _draw_side_by_side(drawn, figures)
    if legend:
        for ax, figure in zip(drawn, figures, strict=True):
            _legend_inside(ax, figure)

    return drawn


def draw_grid_into(
    place: MatplotlibFigure | SubFigure, figures: Sequence[Figure], columns: int, *, legend: bool
) -> AxesArray:
    """Draw panels side by side into an empty matplotlib figure or a part of one."""
    count = sum(len(figure.panels) for figure in figures)
    axes = place.subplots(-(-count // columns), columns, squeeze=False).ravel()
    for spare in axes[count:]:
        spare.remove()

    _draw_side_by_side(axes[:count], figures)
    if legend:
        _legend_below(place, figures)
    return axes[:count]


def height_of(figure: Figure, inches: float = 2.5) -> float:
    """Return the height in inches that a figure needs."""
    return 1.1 + inches * sum(panel.height for panel in figure.panels)


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


def _one_for_each(figures: Sequence[Figure], axes: GivenAxes) -> AxesArray:
    """Return the axes of a user, one for each panel."""
    flat = flat_axes(axes)
    names = [panel.title or panel.label for figure in figures for panel in figure.panels]
    if flat.size != len(names):
        raise ValueError(
            f"{figures[0].title} has {len(names)} panels ({'; '.join(names)}), but `axes` has "
            f"{flat.size}: give one for each."
        )
    return flat


def _draw_panels(axes: AxesArray, figure: Figure) -> None:
    for ax, panel in zip(axes, figure.panels, strict=True):
        _draw_panel(ax, figure, panel)
    _horizontal_axis(axes, figure)


def _draw_side_by_side(axes: AxesArray, figures: Sequence[Figure]) -> None:
    # Panels of one figure side by side have an axis of frequency or time each.
    single = [replace(figure, panels=[panel]) for figure in figures for panel in figure.panels]
    for k, figure in enumerate(single):
        _draw_panels(axes[k : k + 1], figure)


def _write_title(ax: Axes, figure: Figure) -> None:
    title = plain(figure.subject or figure.title)
    ax.set_title("\n".join(filter(None, [title, ax.get_title()])), fontsize=12)


# --- one panel


def _draw_panel(ax: Axes, figure: Figure, panel: Panel) -> None:
    for start, end, color in figure.spans:
        ax.axvspan(start, end, color=color_of(color), alpha=0.15, linewidth=0)
    for series in panel.series:
        _DRAWERS[series.kind](ax, series)
    if figure.is_plane:
        _draw_plane(ax, figure, panel)
    if panel.title:
        ax.set_title(plain(panel.title), fontsize=10)

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
        ends = [y - _finite(series.low), _finite(series.high) - y]
        look = {"ecolor": color_of(series.color), "elinewidth": 1.0, "alpha": 0.2 * layer}
        ax.errorbar(series.x, y, ends, fmt="none", zorder=layer - 0.3, **look)

    # The ink of all points together stays the same: a thousand points must not hide the curve.
    size = MARKER_SIZE * min(1.0, (CROWD / max(len(y), 1)) ** 0.5)
    ax.plot(series.x, y, **{**_look(series), "markersize": max(2.0, size)}, zorder=layer)


def _draw_band(ax: Axes, series: Series) -> None:
    assert series.low is not None
    assert series.high is not None
    look = {"color": color_of(series.color), "alpha": BAND_ALPHA, "linewidth": 0, "zorder": 1.1}
    ax.fill_between(series.x, _finite(series.low), _finite(series.high), **look)


def _draw_rule(ax: Axes, series: Series) -> None:
    dash = DASHES[series.style % len(DASHES)]
    ax.axhline(series.y[0], color=color_of(series.color), linewidth=0.8, linestyle=dash, zorder=1)


def _draw_regions(ax: Axes, series: Series) -> None:
    color = color_of(series.color)
    look: dict[str, Any] = {"facecolors": "none", "edgecolors": color, "linewidths": 0.8}
    look |= {"alpha": 0.6, "zorder": 2}
    if not series.is_hollow:
        # A pale opaque color: transparent ellipses would become dark where they overlap.
        pale = tuple(1 - BAND_ALPHA * (1 - part) for part in to_rgb(color))
        look = {"facecolors": [pale], "linewidths": 0, "zorder": 0.5}
    ax.add_collection(PolyCollection(_polygons(series), **look), autolim=False)


_DRAWERS = {
    "line": _draw_line,
    "points": _draw_points,
    "band": _draw_band,
    "rule": _draw_rule,
    "regions": _draw_regions,
}


def _polygons(series: Series) -> list[Array]:
    vertices = np.column_stack([series.x, series.y])
    is_gap = np.isnan(vertices).any(axis=1)
    pieces = np.split(vertices, np.flatnonzero(is_gap))
    return [piece[np.isfinite(piece).all(axis=1)] for piece in pieces if len(piece) > 1]


def _draw_plane(ax: Axes, figure: Figure, panel: Panel) -> None:
    """Give both axes one scale and their lines through zero, and number the points."""
    # One scale, or distances and angles in the complex plane would mislead.
    ax.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    ax.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    ax.margins(0.12)
    ax.set_aspect("equal", adjustable="datalim")

    # Confidence regions may be many times as wide as the data, which would then be a dot: they
    # widen the limits by half at most.
    reach = ax.dataLim.expanded(1.5, 1.5)
    for series in panel.series:
        if series.kind == "regions" and not series.is_hollow:
            vertices = np.column_stack([series.x, series.y])
            ax.update_datalim(np.clip(vertices, reach.min, reach.max))

    if figure.limits is not None and panel.limits is not None:
        ax.dataLim.set_points(np.array([figure.limits, panel.limits]).T)
        ax.margins(0)

    _write_labels(ax, panel)


def _write_labels(ax: Axes, panel: Panel) -> None:
    """Write labels beside the points, on the outer side of their curve, where there is room."""
    # On the inner side of a bend labels would lie on the curve.
    room = max(ax.dataLim.width, ax.dataLim.height) / 14
    look = {"fontsize": 8.5, "color": "0.25", "ha": "center", "va": "center"}
    outline = [withStroke(linewidth=2, foreground="white")]
    written: list[tuple[str, complex]] = []
    for series in panel.series:
        spots = series.x + 1j * series.y
        for k, text in enumerate(series.labels):
            spot = spots[k]
            # Points of several tests at one frequency lie near each other: one number is enough.
            if any(abs(spot - at) < room * (1 + 2 * (text == name)) for name, at in written):
                continue

            previous, following = spots[max(k - 1, 0)], spots[min(k + 1, len(spots) - 1)]
            outward = 2 * spot - previous - following
            if 0 < k < len(spots) - 1:
                # Both axes have one scale, so a normal of the curve is one on paper too.
                normal = 1j * (following - previous)
                outward = normal * np.sign(np.real(np.conj(normal) * outward))
            outward /= abs(outward) or 1.0
            offset = outward.real * (7 + 2.2 * len(text)), outward.imag * 11  # points
            ax.annotate(
                text if written else f"{text} rad/s",
                (spot.real, spot.imag),
                offset,
                textcoords="offset points",
                path_effects=outline,
                **look,
            )
            written.append((text, spot))


def _look(series: Series) -> dict[str, Any]:
    """Return the keywords of matplotlib's `plot`."""
    color = color_of(series.color)
    look = {"color": color, "label": plain(series.name) or "_"}
    if series.kind in ("line", "rule"):
        dash = DASHES[series.style % len(DASHES)]
        return {**look, "linestyle": dash, "linewidth": series.width}

    look |= {"linestyle": "none", "markersize": MARKER_SIZE}
    if series.style == CROSS:
        return {**look, "marker": "x"}
    look["marker"] = MARKERS[series.style % len(MARKERS)]
    if series.is_hollow:
        return {**look, "markerfacecolor": "none", "markeredgecolor": color}
    return {**look, "markeredgecolor": "white", "markeredgewidth": 0.5}


def _finite(values: Array) -> Array:
    """Replace infinity, as the logarithm of zero, by NaN: matplotlib would scale axes to it."""
    return np.where(np.isfinite(values), values, np.nan)


def color_of(number: int) -> str:
    """Return the color of this number."""
    named = {GRAY: "#999999", INK: "#222222"}
    return named.get(number) or COLORS[number % len(COLORS)]


def plain(text: str) -> str:
    """Return text that matplotlib shows as it is."""
    # Dollar signs begin mathematics, and a label with a leading underscore is left out of a legend.
    return text.lstrip("_").replace("$", r"\$")


# --- axes


def _vertical_axis(ax: Axes, panel: Panel) -> None:
    if panel.is_logarithmic:
        ax.set_yscale("log")
    if panel.limits is not None and ax.get_aspect() != 1:  # equal aspect changes the limits
        low, high = (limit if np.isfinite(limit) else None for limit in panel.limits)
        ax.set_ylim(low, high)

    # Below 60 degrees the steps 1, 2, 5 read well for angles too.
    span = float(np.ptp(ax.get_ylim()))
    if panel.steps and span > 60:
        large = [step for step in panel.steps if step >= 15 and span <= 7 * step]
        most = panel.steps[-1]
        ax.yaxis.set_major_locator(
            MultipleLocator(large[0] if large else most * np.ceil(span / (7 * most)))
        )
    elif not panel.is_logarithmic:
        count = 7 if panel.height >= 1 else 4
        ax.yaxis.set_major_locator(MaxNLocator(count, steps=[1, 2, 5, 10]))


def _horizontal_axis(axes: AxesArray, figure: Figure) -> None:
    for ax in axes:
        if ax.xaxis.get_tick_params().get("labelbottom", True):  # of stacked panels, the lowest
            ax.set_xlabel(plain(figure.label), fontsize=11)
        if figure.limits is not None and not figure.is_plane:
            ax.set_xlim(figure.limits)
        if figure.is_whole:
            ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))

    if figure.is_logarithmic:
        _make_logarithmic(axes)


def _make_logarithmic(axes: AxesArray) -> None:
    """Make horizontal axes logarithmic, with 1, 2 and 5 of every decade where there is room."""
    # From everything in the axes, including what a user drew into them before.
    low = min(ax.dataLim.minposx for ax in axes)
    high = max(ax.dataLim.xmax for ax in axes)
    ratio = high / low
    for ax in axes:
        ax.set(xscale="log", xlim=(low / 1.15, high * 1.15))
        linear = MaxNLocator(6, steps=[1, 2, 2.5, 5, 10])
        decades = LogLocator(subs=(1, 2, 5) if ratio < 1e3 else (1,))
        ax.xaxis.set_major_locator(linear if ratio < 5 else decades)
        ax.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())


# --- legends


def _legend_below(place: MatplotlibFigure | SubFigure, figures: Sequence[Figure]) -> None:
    """Draw the legend below all panels, where it covers no data."""
    entries = _legend_entries(figures)
    if not entries:
        return
    inches = place.bbox.width / place.dpi
    # A letter of 10 points takes about 1/11 inch, a key six letters.
    columns = int(11 * inches / (max(map(len, entries)) + 6))
    place.legend(
        loc="outside lower center",
        ncols=max(1, min(len(entries), columns)),
        fontsize=10,
        frameon=False,
        **_keys_side_by_side(entries),
    )


def _legend_inside(ax: Axes, figure: Figure) -> None:
    entries = _legend_entries([figure])
    if entries:
        ax.legend(fontsize=9, **_keys_side_by_side(entries))


def _legend_entries(figures: Sequence[Figure]) -> dict[str, tuple[Artist, ...]]:
    """Return the keys by label: points, lines, then bands; a label has a key for every color."""
    # One entry "measured" with the markers of six data sets is read faster than six entries.
    keys: dict[tuple[int, str], dict[tuple[int, int], Artist]] = {}
    for figure in figures:
        for panel in figure.panels:
            earlier = {name for _, name in keys}  # in panels above, where they have other styles
            for series in panel.series:
                look = series.color, series.style
                if series.kind in ("band", "regions") and not series.is_hollow:
                    patch = Patch(color=color_of(series.color), alpha=BAND_ALPHA, linewidth=0)
                    keys.setdefault((2, figure.bands), {})[look] = patch
                elif series.name not in earlier:
                    place = (int(series.kind != "points"), series.name)
                    keys.setdefault(place, {})[look] = Line2D([], [], **_look(series))

    in_order = sorted(keys.items(), key=lambda item: item[0][0])
    return {
        plain(label): tuple(artists[look] for look in sorted(artists))
        for (_, label), artists in in_order
        if label
    }


def _keys_side_by_side(entries: dict[str, tuple[Artist, ...]]) -> dict[str, Any]:
    return {
        "handles": [*entries.values()],
        "labels": [*entries],
        "handler_map": {tuple: HandlerTuple(ndivide=None, pad=0.4)},
        "handlelength": max(2.0, 1.2 * max(map(len, entries.values()))),
    }
