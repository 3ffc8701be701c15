"""Figures of a study or of fits: a parameter over operating points or members, and maps."""

import math
from collections.abc import Collection
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from greybox.assessment.result import Fit, Fits
from greybox.assessment.validation.comparison import Comparison
from greybox.data.files.arrays import Array, sum_of_squares
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values
from greybox.data.files.numbers_in_text import number, p_text
from greybox.data.files.public import public
from greybox.data.files.wording import some
from greybox.reporting.plotting.figure import CROSS, Figure, Panel, Series, require_drawable
from greybox.reporting.plotting.matplotlib_figure import draw
from greybox.reporting.plotting.signals import distinct_labels, with_unit
from greybox.workflows.study.members import StudyMember
from greybox.workflows.study.ranking import EVIDENCE
from greybox.workflows.study.study import Study, names_by_difference, shown

STUDY = "the Study that gb.batch or gb.study.read_study returns"
NAMED = 40  # most members of a figure with the name of each

# Classes of a map: their upper ends, colors and markers. The classes of BIC are those of Kass and
# Raftery (1995), as in `validation/parsimony.py`.
BIC = {
    "at most 2 above the least BIC": (2.0, 2, 0),
    "2 to 10": (10.0, 4, 1),
    "more than 10": (np.inf, 1, CROSS),
}
AGREEING = {
    "at most half of the starts agree": (0.5, 1, CROSS),
    "more": (1.0, 2, 0),
}


class Value(NamedTuple):
    """A quantity of a member, with its standard error."""

    member: StudyMember
    value: float
    error: float


@public
def trend(study: Study, quantity: str, over: str | Values, ax: Axes | None = None) -> Axes:
    """Draw a quantity with its standard errors over the operating point.

    Each structure has a color, and a line that is fitted with weights from the standard errors. If
    estimates scatter more than the standard errors suggest, the error of the slope is enlarged
    accordingly. p is the probability of at least such a slope without a trend, by Student's t.

    Parameters
    ----------
    study : Study
    quantity : str
        A parameter or a derived quantity.
    over : str or mapping of data set to number
        Another quantity, a value of the operating point (``at``), or numbers by data set.
    ax : Axes, optional
        By default a new figure is made.

    Raises
    ------
    ValueError
        If no member has the quantity, or a value in `over`.
    """
    return draw([trend_figure(study, quantity, over)], ax)[0]


def trend_figure(study: Study, quantity: str, over: str | Values) -> Figure:
    """Return a quantity over the operating point."""
    require_drawable(study, Study, STUDY)
    if isinstance(over, str):
        label = over
        places = {row.member: row.value for row in _values(study, over)}
    else:
        label = "Operating point"
        places = {}
        for member in study.done:
            data = member.factors["data"]
            if data in over:
                places[member] = over[data]

    series = []
    for k, (model, values) in enumerate(_by_model(_values(study, quantity))):
        placed = [row for row in values if row.member in places]
        if not placed:
            continue
        x = np.array([places[row.member] for row in placed])
        y = np.array([row.value for row in placed])
        error = np.array([row.error for row in placed])
        series.append(Series(model, "points", x, y, k, k, low=y - error, high=y + error))
        if len(set(x)) > 2 and np.all(error > 0):
            series.append(_line(model, x, y, error, k))
    if not series:
        sets = [*study.groups("data")]
        raise ValueError(f"over={over!r:.80} names no data set: give values for {some(sets)}.")
    panel = Panel(_label(study, quantity), series)
    return Figure("Trend", _label(study, label), [panel], f"Trend of {quantity}")


def _line(model: str, x: Array, y: Array, error: Array, color: int) -> Series:
    """Return the weighted line through points (n,); its name has the slope and its p value."""
    from scipy.stats import t  # noqa: PLC0415  (slow import)

    (slope, intercept), covariance = np.polyfit(x, y, 1, w=1 / error, cov="unscaled")
    dof = len(x) - 2
    scatter = sum_of_squares((y - intercept - slope * x) / error) / dof
    slope_error = math.sqrt(covariance[0, 0] * max(scatter, 1.0))
    p_value = 2 * float(t.sf(abs(slope) / slope_error, dof))
    ends = np.array([x.min(), x.max()])
    line = intercept + slope * ends
    return Series(
        f"{model}: slope {shown(slope, slope_error)}, {p_text(p_value)}", "line", ends, line, color
    )


@public
def estimates(study: Study | Fits, quantity: str, ax: Axes | None = None) -> Axes:
    """Draw a quantity of all members with standard errors.

    Costs are sorted, as in a waterfall plot.

    Parameters
    ----------
    study : Study or sequence of Fit
    quantity : str
        A parameter, a derived quantity, or ``"cost"``.
    ax : Axes, optional
        By default a new figure is made.

    Raises
    ------
    ValueError
        If no member has the quantity, or if there are no fits.
    """
    return draw([estimates_figure(study, quantity)], ax)[0]


def estimates_figure(study: Study | Fits, quantity: str) -> Figure:
    """Return a quantity of all members, the first or lowest one at the top."""
    if not isinstance(study, Study):
        # The fits become the members of a study that is not stored.
        require_drawable(study, Collection, f"{STUDY}, or a list of fits")
        for fit in study:
            require_drawable(fit, Fit, "a Fit")
        names = distinct_labels([fit.name for fit in study], ())
        members = [
            StudyMember(Path(), 0, name, fit.to_dict(), 0)
            for name, fit in zip(names, study, strict=True)
        ]
        study = Study(Path(), tuple(members))
    values = _values(study, quantity)
    if quantity == "cost":
        values.sort(key=lambda row: row.value)
    # The height of every member, from the top.
    heights = {row.member: float(len(values) - k) for k, row in enumerate(values)}
    series = []
    for k, (model, group) in enumerate(_by_model(values)):
        x = np.array([row.value for row in group])
        y = np.array([heights[row.member] for row in group])
        error = np.array([row.error for row in group])
        notes = [f"{row.member.name}: {shown(row.value, row.error)}" for row in group]
        points = Series(
            model,
            "points",
            x,
            y,
            k,
            k,
            low=x - error,
            high=x + error,
            is_across=True,
            notes=notes,
        )
        series.append(points)
    labels = [", ".join(label.values()) for label in names_by_difference([*heights])]
    names = labels[::-1] if len(heights) <= NAMED else [""]
    height = max(1.0, min(len(heights), NAMED) / 10)
    panel = Panel("", series, height, limits=(0.5, len(heights) + 0.5), ticks=names)
    lowest = min(row.value for row in values)
    highest = max(row.value for row in values)
    is_logarithmic = quantity == "cost" and lowest > 0 and highest > 30 * lowest
    label = _label(study, quantity)
    return Figure("Members", label, [panel], quantity, is_logarithmic=is_logarithmic)


@public
def structures(results: Study | Comparison, ax: Axes | None = None) -> Axes:
    """Draw a map of structures and data sets.

    Parameters
    ----------
    results : Study or Comparison
        The map of a study shows the share of the starts that agree on the best minimum, that of
        ``gb.compare(study)`` the difference of BIC from the least one.
    ax : Axes, optional
        By default a new figure is made.
    """
    return draw([structures_figure(results)], ax)[0]


def structures_figure(results: Study | Comparison) -> Figure:
    """Return a map of structures and data sets, with a mark for each class of numbers."""
    if isinstance(results, Comparison):
        title, classes, cells = "Evidence", BIC, _evidence(results)
    else:
        require_drawable(results, Study, f"{STUDY}, or what gb.compare makes of it")
        title, classes, cells = "Starts that agree", AGREEING, _shares(results)
    columns = unique(column for column, _ in cells)
    rows = unique(row for _, row in cells)
    from_below = rows[::-1]
    series = []
    low = -np.inf
    for name, (high, color, style) in classes.items():
        x, y, notes = [], [], []
        for (column, row), value in cells.items():
            if low < value <= high:
                x.append(1.0 + columns.index(column))
                y.append(1.0 + from_below.index(row))
                notes.append(f"{row}, {column}: {number(value, 3)}")
        series.append(Series(name, "points", np.array(x), np.array(y), color, style, notes=notes))
        low = high
    height = max(0.6, len(rows) / 10)
    panel = Panel("", series, height, limits=(0.5, len(rows) + 0.5), ticks=from_below)
    names = columns if len(columns) <= NAMED else [""]
    title = f"{title} by structure and data set"
    return Figure(title, "", [panel], limits=(0.5, len(columns) + 0.5), ticks=names)


def _evidence(comparison: Comparison) -> dict[tuple[str, str], float]:
    """Return the differences of BIC from the least one, by data set and structure."""
    differences = {}
    for row in comparison.table:
        if row["output"] != EVIDENCE:
            continue
        for label, value in row["values"].items():
            if value is not None:
                # In this table, a measure is the name of a data set.
                differences[row["measure"], label] = value
    return differences


def _shares(study: Study) -> dict[tuple[str, str], float]:
    """Return the share of agreeing starts by data set and structure, the least of all members."""
    shares: dict[tuple[str, str], float] = {}
    structure = study.structures
    for member in study.members:
        factors = member.factors
        if "data" in factors and structure in factors:
            key = factors["data"], factors[structure]
            share = member.answer.get("agreeing", 0) / max(member.runs, 1)
            shares[key] = min(share, shares.get(key, 1.0))
    return shares


def _values(study: Study, quantity: str) -> list[Value]:
    """Return a quantity of all members that have it, with a standard error of zero if unknown."""
    values = []
    for member in study.done:
        answer = member.answer
        quantities = {**answer, **answer.get("at", {}), **answer["derived"], **answer["estimate"]}
        if quantities.get(quantity) is not None:
            error = answer["standard_error"].get(quantity) or 0.0
            values.append(Value(member, quantities[quantity], error))
    if not values:
        raise ValueError(f"no member has the quantity {quantity!r:.60}.")
    return values


def _label(study: Study, quantity: str) -> str:
    """Return a quantity with its unit."""
    units: dict[str, str] = {}
    for member in study.done:
        units |= member.answer.get("unit", {})
    return with_unit(quantity, units.get(quantity, ""))


def _by_model(values: list[Value]) -> list[tuple[str, list[Value]]]:
    """Return the values of every model, the models in alphabetical order."""

    def model(value: Value) -> str:
        return value.member.factors["model"]

    return [(name, [*group]) for name, group in groupby(sorted(values, key=model), model)]
