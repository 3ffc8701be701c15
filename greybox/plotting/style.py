"""What all figures share: colors, symbols for signal names, the frame of a diagram, legends, and given axes."""

import io
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from numpy.typing import NDArray

from greybox.data.text_table import greek

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DARK = "#222222"
GRAYS = ("#222222", "#777777", "#AAAAAA")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
TITLE_SIZE = 12  # points

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
        raise TypeError(f"cannot draw into {wrong[0]!r:.80}: give matplotlib Axes, e.g. those of plt.subplots().")
    return flat


def plain(text: str) -> str:
    """Return `text` as matplotlib is to show it: no mathematics, and no underscore that hides it from a legend."""
    return text.lstrip("_").replace("$", r"\$")


def symbol(name: str) -> str:
    """Return a signal's name with Greek letters: theta is θ, u_phi is u_φ."""
    return "_".join(greek(part) for part in name.split("_")).replace("$", r"\$")


def finish(ax: Axes, ylabel: str) -> None:
    """Label the vertical axis and give the panel the grid and the spines of every diagram."""
    ax.set_ylabel(ylabel, fontsize=11)
    ax.tick_params(labelsize=10)
    ax.grid(True, color="0.9", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def label_horizontal(axes: Iterable[Axes], label: str) -> None:
    """Label the horizontal axis of the panels that show its numbers; of stacked ones only the lowest does."""
    for ax in axes:
        if ax.xaxis.get_tick_params().get("labelbottom", True):
            ax.set_xlabel(label, fontsize=11)


def legend_below(figure: Figure | SubFigure, entries: Entries) -> None:
    """Draw a legend below everything, where it covers no data."""
    width = figure.bbox.width / figure.dpi  # inches; a letter of 10 points takes about 1/11, a key six letters
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


def legend_inside(ax: Axes, entries: Entries) -> None:
    """Draw a legend inside a panel."""
    ax.legend(handles=[*entries.values()], labels=[*entries], fontsize=9, **_keys_side_by_side(entries))


def _keys_side_by_side(entries: Entries) -> dict:
    most = max(map(len, entries.values()))
    return {"handler_map": {tuple: HandlerTuple(ndivide=None, pad=0.4)}, "handlelength": max(2.0, 1.2 * most)}
