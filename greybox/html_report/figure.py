"""Figures as plain values, which the page's script draws: panels over one horizontal axis, each with its series."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np

from greybox.files.arrays import Array
from greybox.html_report.elements import Child, tag

DIGITS = 5  # of numbers in a figure: a pixel is a thousandth of a panel


@dataclass(frozen=True, eq=False)
class Series:
    """What is drawn in one color and has one name.

    Attributes
    ----------
    name : str
        In the legend; series of one name in several panels are shown and hidden together. Empty:
        not in the legend.
    kind : "line", "points", "band" or "rule"
        A band lies between `low` and `high`. A rule is a horizontal line at ``y[0]``.
    x, y : (n,) arrays
        NaN in y interrupts a line.
    color, style : int
        Numbers of a color, -1 for gray and -2 for black, and of a dash or a marker.
    low, high : (n,) arrays or None
        Ends of error bars, or of a band.
    notes : sequence of str
        What is said of each point when it is read, instead of its numbers.
    """

    name: str
    kind: Literal["line", "points", "band", "rule"]
    x: Array
    y: Array
    color: int = 0
    style: int = 0
    low: Array | None = None
    high: Array | None = None
    notes: Sequence[str] = ()

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        columns = {"x": self.x, "y": self.y, "low": self.low, "high": self.high}
        numbers = {name: _rounded(values) for name, values in columns.items() if values is not None}
        notes = {"notes": list(self.notes)} if self.notes else {}
        return {
            "name": self.name,
            "kind": self.kind,
            "color": self.color,
            "style": self.style,
            **numbers,
            **notes,
        }


@dataclass(frozen=True, eq=False)
class Panel:
    """One vertical axis with its series.

    Attributes
    ----------
    label : str
        What is drawn, with its unit after a comma.
    series : sequence of Series
        The last one lies above the others.
    height : float
        In multiples of a usual panel.
    is_logarithmic : bool
    limits : (float, float) or None
        By default all that is drawn.
    steps : sequence of float
        Between ticks, those that are natural for angles; by default 1, 2 and 5.
    """

    label: str
    series: Sequence[Series]
    height: float = 1.0
    is_logarithmic: bool = False
    limits: tuple[float, float] | None = None
    steps: Sequence[float] = ()

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "label": self.label,
            "height": self.height,
            "log": self.is_logarithmic,
            "limits": self.limits and [_finite(limit) for limit in self.limits],
            "steps": list(self.steps),
            "series": [series.plain for series in self.series],
        }


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels below one another, over one horizontal axis.

    Attributes
    ----------
    title : str
    label : str
        Of the horizontal axis.
    panels : sequence of Panel
    caption : Child
        What there is to say.
    is_logarithmic : bool
        Of the horizontal axis.
    is_plane : bool
        Whether both axes have one scale, as in the complex plane.
    is_whole : bool
        Whether the horizontal axis counts, so that there is nothing between its numbers.
    is_wide : bool
        Whether it takes the whole width of the page.
    limits : (float, float) or None
        Of the horizontal axis, by default all that is drawn.
    """

    title: str
    label: str
    panels: Sequence[Panel]
    caption: Child = None
    is_logarithmic: bool = False
    is_plane: bool = False
    is_whole: bool = False
    is_wide: bool = False
    limits: tuple[float, float] | None = None

    @property
    def element(self) -> Element:
        """As it stands on the page; the script draws into the element of class ``plot``."""
        plain = {
            "title": self.title,
            "label": self.label,
            "log": self.is_logarithmic,
            "plane": self.is_plane,
            "whole": self.is_whole,
            "limits": self.limits and [_finite(limit) for limit in self.limits],
            "panels": [panel.plain for panel in self.panels],
        }
        data = json.dumps(plain, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
        plot = tag("div", class_="plot", data_figure=data)
        caption = tag(
            "figcaption", tag("strong", self.title), " " if self.caption else None, self.caption
        )
        return tag("figure", caption, plot)


def figure_grid(figures: Sequence[Figure]) -> Element:
    """Return figures as they stand on the page, beside one another where there is room."""
    elements = [figure.element for figure in figures]
    for figure, element in zip(figures, elements, strict=True):
        if figure.is_wide or len(figures) == 1:
            element.set("class", "wide")
    return tag("div", elements, class_="figures")


def _rounded(values: Array) -> list[float | None]:
    """Return numbers with the digits that a figure of their span needs, and None for what is not finite."""
    values = np.asarray(values, dtype=float)
    finite = values[np.isfinite(values)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    return [_finite(value, span) for value in values.tolist()]


def _finite(value: float, span: float = 0.0) -> float | None:
    if not math.isfinite(value):
        return None
    # Times far from zero, as those of a clock, keep their differences.
    more = math.ceil(math.log10(abs(value) / span)) if 0 < span < abs(value) else 0
    rounded = float(f"{value:.{DIGITS + more}g}")
    return int(rounded) if rounded.is_integer() and abs(rounded) < 1e15 else rounded
