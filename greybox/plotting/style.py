"""What stands on a page: points and curves, the frame around them, legends, and names as symbols."""

import io
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D

from greybox.data.frequency_response import FrequencyResponse

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito: told apart by all eyes
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
MARKER_SIZE = 5.5  # points
CROWD = 100  # points of one data set from which on they shrink and lie below the curves


class _Figure(Figure):
    """A figure that a notebook shows although pyplot, which would teach it to, was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def page(width: float, height: float) -> Figure:
    """Return an empty figure of this size in inches."""
    return _Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08))


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


@dataclass(frozen=True, eq=False)
class Series:
    """Measured points (of the style of a marker) or a curve (of the style of a line), and what it belongs to.

    `checksum` is that of the data, `pair` the names of input and output.
    """

    response: FrequencyResponse
    label: str
    color: str
    style: str
    checksum: str
    pair: tuple[str, str]

    @property
    def measured(self) -> bool:
        """True for points, False for a curve."""
        return self.style in MARKERS

    @property
    def look(self) -> dict[str, Any]:
        """What matplotlib wants to know."""
        look = {"color": self.color, "label": self.label}
        if self.measured:
            small = min(1.0, (CROWD / len(self.response)) ** 0.5)  # as much ink as a crowd's
            edge = {"markeredgecolor": "white", "markeredgewidth": 0.5 if small == 1 else 0.0}
            size = {"markersize": max(2.0, small * MARKER_SIZE), "zorder": 3 if small == 1 else 1.5}
            return {**look, "linestyle": "none", "marker": self.style, **edge, **size}
        return {**look, "linestyle": self.style, "marker": "" if len(self.response) > 1 else "+", "linewidth": 1.8}

    @property
    def key(self) -> Line2D:
        """The key of a legend."""
        size = {"markersize": MARKER_SIZE} if self.measured else {}
        return Line2D([], [], **{**self.look, **size})


def ratio(series: Sequence[Series]) -> str:
    """Return output/input in symbols, e.g. θ/u, or P(jω) where they are not the same for all."""
    inputs, outputs = ({one.pair[k] for one in series} - {""} for k in (0, 1))
    return f"{symbol(*outputs)}/{symbol(*inputs)}" if len(outputs) == len(inputs) == 1 else "P(jω)"


def finish(axes: Axes, xlabel: str, ylabel: str) -> None:
    """Label the axes and give them the grid and the spines of every diagram."""
    axes.set_xlabel(xlabel, fontsize=11)
    axes.set_ylabel(ylabel, fontsize=11)
    axes.tick_params(labelsize=10)
    axes.grid(True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def legend(figure: Figure | SubFigure, series: Sequence[Series]) -> None:
    """Draw a legend of all data, then of the curves, one entry per fit with all its colors."""
    entries: dict[str, dict[str, Line2D]] = {}
    for one in sorted(series, key=lambda one: not one.measured):
        entries.setdefault(one.label, {})[one.color + one.style] = one.key
    legend_below(figure, {label: tuple(keys.values()) for label, keys in entries.items()})


def legend_below(figure: Figure | SubFigure, entries: Mapping[str, tuple[Line2D, ...]]) -> None:
    """Draw a legend below everything, where it covers no data, with the keys of one label side by side."""
    figure.legend(
        handles=[*entries.values()],
        labels=[*entries],
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0.4)},
        handlelength=max(2.0, 1.2 * max(map(len, entries.values()))),
        loc="outside lower center",
        ncols=max(1, min(len(entries), int(figure.bbox.width / figure.dpi * 11 / (max(map(len, entries)) + 6)))),
        fontsize=10,
        frameon=False,
    )
