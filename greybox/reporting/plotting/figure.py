"""A figure as a value, which matplotlib (`matplotlib_figure`) and the page of a report draw."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, Interval
from greybox.data.files.frozen_values import frozen
from greybox.data.files.numbers_in_text import number

GRAY = -1  # colors without a number
INK = -2
CROSS = -1  # marker of what failed
ANGLES = (1, 2, 5, 15, 30, 45, 90, 180, 360, 720)  # natural steps of an axis in degrees


@frozen
class Series:
    """Lines, points or areas of one color.

    Attributes
    ----------
    name : str
        Entry in the legend; empty for none. Series with the same name share an entry.
    kind : "line", "points", "band", "rule" or "regions"
        A band lies between `low` and `high`. A rule is a horizontal line at ``y[0]``. Regions are
        polygons with NaN between them, filled with a pale color or, if hollow, outlined.
    x, y : (n,) arrays
        NaN in y interrupts a line.
    color : int
        0 to 5, then again from 0; GRAY or INK.
    style : int
        Number of the dash pattern or of the marker; CROSS.
    low, high : (n,) arrays or None
        Ends of error bars, or of the band. In the complex plane, bars are diameters of circles.
    notes : sequence of str
        What the page shows when a point is read, instead of its numbers.
    labels : sequence of str
        Written beside the points.
    is_hollow : bool
        Whether a line is hair-thin.
    is_across : bool
        The error bars `low` to `high` are horizontal.
    """

    name: str
    kind: Literal["line", "points", "band", "rule", "regions"]
    x: Array
    y: Array
    color: int = 0
    style: int = 0
    low: Array | None = None
    high: Array | None = None
    notes: Sequence[str] = ()
    labels: Sequence[str] = ()
    is_hollow: bool = False
    is_across: bool = False


def band(name: str, x: Array, low: Array, high: Array, color: int = 0) -> Series:
    """Return the area between two curves (n,)."""
    return Series(name, "band", x, low, color, low=low, high=high)


def outlined(outlines: ComplexArray, color: int, *, is_hollow: bool = False) -> Series:
    """Return closed outlines (n, m) in the complex plane as one series."""
    # NaN ends an outline.
    vertices = np.insert(outlines, 0, np.nan, axis=1).ravel()
    return Series("", "regions", vertices.real, vertices.imag, color, is_hollow=is_hollow)


def rule(y: float = 0.0, name: str = "", style: int = 0) -> Series:
    """Return a gray horizontal line."""
    return Series(name, "rule", np.zeros(1), np.array([y]), GRAY, style)


@frozen
class Panel:
    """One vertical axis with its series.

    Attributes
    ----------
    label : str
        The quantity, with its unit after a comma.
    series : sequence of Series
        Later ones are drawn above earlier ones.
    height : float
        In multiples of a usual panel.
    is_logarithmic : bool
    limits : (float, float) or None
        By default everything that is drawn.
    steps : sequence of float
        Natural distances of ticks, such as `ANGLES`; by default 1, 2 and 5 times powers of ten.
    title : str
        Drawn by matplotlib above the panel; the page has captions.
    ticks : sequence of str
        Names at 1, 2, ... in place of numbers.
    """

    label: str
    series: Sequence[Series]
    height: float = 1.0
    is_logarithmic: bool = False
    limits: Interval | None = None
    steps: Sequence[float] = ()
    title: str = ""
    ticks: Sequence[str] = ()


@frozen
class Figure:
    """Panels below one another, over one horizontal axis.

    Attributes
    ----------
    title : str
        The kind of diagram.
    label : str
        Label of the horizontal axis.
    panels : sequence of Panel
    subject : str
        Names of what is drawn: the title in matplotlib.
    caption : str
        Sentences below the title on the page.
    bands : str
        What bands show, for the legend of matplotlib.
    spans : sequence of (start, end, color)
        Shaded by matplotlib in all panels.
    is_logarithmic : bool
        The horizontal axis.
    is_plane : bool
        Both axes have one scale, as in the complex plane.
    is_whole : bool
        The horizontal axis counts.
    is_wide : bool
        The figure takes the whole width of the page.
    limits : (float, float) or None
        Limits of the horizontal axis; by default everything that is drawn.
    ticks : sequence of str
        Names at 1, 2, ... of the horizontal axis in place of numbers.
    unit : str
        Unit of the frequencies that are written beside points of the complex plane.
    """

    title: str
    label: str
    panels: Sequence[Panel]
    subject: str = ""
    caption: str = ""
    bands: str = ""
    spans: Sequence[tuple[float, float, int]] = ()
    is_logarithmic: bool = False
    is_plane: bool = False
    is_whole: bool = False
    is_wide: bool = False
    limits: Interval | None = None
    ticks: Sequence[str] = ()
    unit: str = "rad/s"


def require_drawable(item: Any, kinds: type | tuple[type, ...], cure: str) -> None:
    """Raise TypeError for anything but an item of these kinds; the message says to give `cure`."""
    if not isinstance(item, kinds):
        raise TypeError(f"cannot draw {item!r:.80}: give {cure}.")


def in_hertz(figure: Figure) -> Figure:
    """Return a figure of omega in rad/s as one of the frequency in Hz."""
    is_axis = figure.label.endswith(", rad/s")

    def converted(series: Series) -> Series:
        x = series.x / math.tau if is_axis else series.x
        labels = [number(float(omega) / math.tau, 3) for omega in series.labels]
        return replace(series, x=x, labels=labels)

    panels = [replace(panel, series=[*map(converted, panel.series)]) for panel in figure.panels]
    label = "Frequency, Hz" if is_axis else figure.label
    return replace(figure, label=label, panels=panels, unit="Hz")
