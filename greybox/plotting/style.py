"""What all figures share: colors, symbols for signal names, the frame of a diagram, legends, and given axes."""

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from numpy.typing import NDArray

from greybox.data.test_segment import Segment
from greybox.files.text_table import in_greek

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too
# pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DARK = "#222222"
GRAYS = ("#222222", "#777777", "#AAAAAA")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
TITLE_SIZE = 12  # points

Item = TypeVar("Item")

AxesArray = NDArray[np.object_]
"""Matplotlib Axes, in one dimension."""

GivenAxes = Axes | Sequence[Axes] | AxesArray
"""Axes that a user made: one, or an array-like of them."""

Entries = Mapping[str, tuple[Artist, ...]]
"""The keys of a legend by label; those of one label stand side by side."""


class _Figure(Figure):
    """A figure that a notebook shows although pyplot, which registers the display of figures, was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of this size in inches."""
    return _Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08))


def given_axes(axes: GivenAxes, names: Sequence[str], drawing: str) -> AxesArray:
    """Return the axes that a user gave as an array (n,), one for each of `names`.

    Raises
    ------
    TypeError, ValueError
        If one is no matplotlib Axes, or if they are not as many as `names`.
    """
    flat = flat_axes(axes)
    if flat.size != len(names):
        raise ValueError(
            f"{drawing} draws {len(names)} panels ({', '.join(names)}), but `axes` has {flat.size}: give one for each."
        )
    return flat


def flat_axes(axes: GivenAxes) -> AxesArray:
    """Return the axes that a user gave as an array (n,).

    Raises
    ------
    TypeError
        If one is no matplotlib Axes.
    """
    flat = np.array(axes, dtype=object).ravel()
    wrong = [item for item in flat if not isinstance(item, Axes)]
    if wrong:
        raise TypeError(
            f"cannot draw into {wrong[0]!r:.80}: give matplotlib Axes, e.g. those of plt.subplots()."
        )
    return flat


def stacked_axes(
    axes: GivenAxes | None, names: Sequence[str], drawing: str, width: float, height: float
) -> AxesArray:
    """Return the given axes, or those of a new figure of this size in inches, one for each name below the other."""
    if axes is not None:
        return given_axes(axes, names, drawing)
    return stacked(new_figure(width, height), [1.0] * len(names))


def stacked(figure: Figure | SubFigure, heights: Sequence[float]) -> AxesArray:
    """Make axes of these relative heights, one below the other, over one horizontal axis."""
    return figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]


def chosen(items: Sequence[Item], number: int, kind: str) -> Item:
    """Return the item of this number, counted from 0, or from the end where it is negative.

    Raises
    ------
    ValueError
        If there is none.
    """
    if not -len(items) <= number < len(items):
        raise ValueError(f"there is no {kind} {number}: the fit has {len(items)}, counted from 0.")
    return items[number]


def shown_unit(unit: str) -> tuple[float, str]:
    """Return the factor to the unit that a person reads, degrees for radians, and that unit."""
    degrees = {"rad": "°", "rad/s": "°/s"}.get(unit)
    return (1.0, unit) if degrees is None else (180 / math.pi, degrees)


def signal_label(name: str, unit: str) -> str:
    """Return the label of a signal: its symbol and the unit that a person reads."""
    shown = plain(shown_unit(unit)[1])
    return f"{symbol(name)}, {shown}" if shown else symbol(name)


def plain(text: str) -> str:
    """Return `text` as matplotlib is to show it: no mathematics, and no underscore that hides it from a legend."""
    return text.lstrip("_").replace("$", r"\$")


def symbol(name: str) -> str:
    """Return the name of a signal with Greek letters, as matplotlib is to show it."""
    return in_greek(name).replace("$", r"\$")


def color_of(k: int) -> str:
    """Return the color of the k-th curve; after the last color comes the first again."""
    return COLORS[k % len(COLORS)]


def shade_tests(ax: Axes, tests: Iterable[Segment]) -> None:
    """Shade when tests were flown, red where they are not usable."""
    for test in tests:
        ax.axvspan(
            test.start, test.end, color="0.5" if test.usable else "tab:red", alpha=0.15, lw=0
        )


def finish(ax: Axes, ylabel: str, legend: bool = False) -> None:
    """Label the vertical axis, give the panel the grid and the spines of every diagram, and explain its curves."""
    ax.set_ylabel(ylabel, fontsize=11)
    ax.tick_params(labelsize=10)
    ax.grid(True, color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if legend:
        ax.legend(fontsize=8, loc="upper right")


def label_horizontal(axes: Iterable[Axes], label: str) -> None:
    """Label the horizontal axis of the panels that show its numbers; of stacked ones only the lowest does."""
    for ax in axes:
        if ax.xaxis.get_tick_params().get("labelbottom", True):
            ax.set_xlabel(label, fontsize=11)


def legend_below(figure: Figure | SubFigure, entries: Entries) -> None:
    """Draw a legend below everything, where it covers no data."""
    width = (
        figure.bbox.width / figure.dpi
    )  # inches; a letter of 10 points takes about 1/11, a key six letters
    columns = int(11 * width / (max(map(len, entries)) + 6))
    figure.legend(
        handles=[*entries.values()],
        labels=[*entries],
        loc="outside lower center",
        ncols=max(1, min(len(entries), columns)),
        fontsize=10,
        frameon=False,
        **_keys_side_by_side(entries),
    )


def align_and_explain(places: AxesArray, entries: Entries, *, given: bool, legend: bool) -> None:
    """Align the labels of a new figure and draw its legend below it; given axes have theirs inside the first."""
    if not given:
        places[0].figure.align_ylabels(places)
    if legend and given:
        legend_inside(places[0], entries)
    elif legend:
        legend_below(places[0].figure, entries)


def legend_inside(ax: Axes, entries: Entries) -> None:
    """Draw a legend inside a panel."""
    ax.legend(
        handles=[*entries.values()], labels=[*entries], fontsize=9, **_keys_side_by_side(entries)
    )


def _keys_side_by_side(entries: Entries) -> dict:
    most = max(map(len, entries.values()))
    return {
        "handler_map": {tuple: HandlerTuple(ndivide=None, pad=0.4)},
        "handlelength": max(2.0, 1.2 * most),
    }
