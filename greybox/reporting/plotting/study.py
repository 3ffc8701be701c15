"""Figures of a study or of fits: a parameter over operating points or members, and maps."""

import math
from collections.abc import Collection
from itertools import groupby
from pathlib import Path

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
NAMED = 40  # members up to which each has its name

# Classes of a map by their upper end, with color and marker. Differences of BIC: Kass and Raftery
# (1995), as in `validation/parsimony.py`.
BIC = {
    "at most 2 above the least BIC": (2.0, 2, 0),
    "2 to 10": (10.0, 4, 1),
    "more than 10": (np.inf, 1, CROSS),
}
AGREEING = {
    "at most half of the starts agree": (0.5, 1, CROSS),
    "more": (1.0, 2, 0),
}

Value = tuple[StudyMember, float, float]
"""A quantity of a member, and its standard error."""


@public
def trend(study: Study, quantity: str, over: str | Values, ax: Axes | None = None) -> Axes:
    """Draw a quantity with its standard errors over the operating point, in one color a structure.

    The lines are weighted by the standard errors. If estimates scatter more than these say, the
    error of the slope is enlarged accordingly; p is the probability of such a slope without a
    trend, by Student's t.

    Parameters
    ----------
    study : Study
    quantity : str
        A parameter or a derived quantity.
    over : str or mapping of data set to number
        Another quantity, an operating point of the problem (``at``), or its value by data set.
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
        label, places = over, {member: x for member, x, _ in _values(study, over)}
    else:
        label = "Operating point"
        places = {m: over[m.factors["data"]] for m in study.done if m.factors["data"] in over}
    series = []
    for k, (model, values) in enumerate(_by_model(_values(study, quantity))):
        points = [(places[member], y, error) for member, y, error in values if member in places]
        if points:
            x, y, error = np.array(points).T
            series.append(Series(model, "points", x, y, k, k, low=y - error, high=y + error))
            if len(set(x)) > 2 and np.all(error > 0):
                series.append(_line(model, x, y, error, k))
    if not series:
        sets = [*study.groups("data")]
        raise ValueError(f"over={over!r:.80} names no data set: give values for {some(sets)}.")
    panel = Panel(_label(study, quantity), series)
    return Figure("Trend", _label(study, label), [panel], f"Trend of {quantity}")


def _line(model: str, x: Array, y: Array, error: Array, color: int) -> Series:
    """Return the weighted line, whose name has the slope and its test."""
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
    """Draw a quantity of all members with standard errors; ``"cost"`` sorted, as a waterfall.

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
        # A study that is stored nowhere, a member a fit.
        require_drawable(study, Collection, f"{STUDY}, or a list of fits")
        for fit in study:
            require_drawable(fit, Fit, "a Fit")
        names = distinct_labels([fit.name for fit in study], ())
        fits = zip(names, study, strict=True)
        study = Study(Path(), tuple(StudyMember(Path(), 0, n, f.to_dict(), 0) for n, f in fits))
    values = _values(study, quantity)
    if quantity == "cost":
        values.sort(key=lambda value: value[1])
    rows = {member: float(len(values) - k) for k, (member, _, _) in enumerate(values)}
    series = []
    for k, (model, group) in enumerate(_by_model(values)):
        x, error = np.array([value[1:] for value in group]).T
        look = {"low": x - error, "high": x + error, "is_across": True}
        notes = [f"{m.name}: {shown(*pair)}" for m, *pair in group]
        y = np.array([rows[member] for member, _, _ in group])
        series.append(Series(model, "points", x, y, k, k, notes=notes, **look))
    labels = [", ".join(label.values()) for label in names_by_difference([*rows])]
    names = labels[::-1] if len(rows) <= NAMED else [""]
    height, limits = max(1.0, min(len(rows), NAMED) / 10), (0.5, len(rows) + 0.5)
    panel = Panel("", series, height, limits=limits, ticks=names)
    x = [value for _, value, _ in values]
    is_logarithmic = quantity == "cost" and min(x) > 0 and max(x) > 30 * min(x)
    label = _label(study, quantity)
    return Figure("Members", label, [panel], quantity, is_logarithmic=is_logarithmic)


@public
def structures(results: Study | Comparison, ax: Axes | None = None) -> Axes:
    """Draw a map of structures and data sets.

    Parameters
    ----------
    results : Study or Comparison
        A study shows the share of the starts that agree on the best minimum, and
        ``gb.compare(study)`` how far BIC is above the least.
    ax : Axes, optional
        By default a new figure is made.
    """
    return draw([structures_figure(results)], ax)[0]


def structures_figure(results: Study | Comparison) -> Figure:
    """Return a map of marks of three classes, which print well."""
    if isinstance(results, Comparison):
        title, classes, cells = "Evidence", BIC, _evidence(results)
    else:
        require_drawable(results, Study, f"{STUDY}, or what gb.compare makes of it")
        title, classes, cells = "Starts that agree", AGREEING, _shares(results)
    columns, rows = (unique(key[k] for key in cells) for k in (0, 1))
    low, series = -np.inf, []
    for name, (high, color, style) in classes.items():
        inside = {key: value for key, value in cells.items() if low < value <= high}
        low = high
        x, y = (
            np.array([1.0 + places.index(key[k]) for key in inside])
            for k, places in enumerate((columns, rows[::-1]))
        )
        notes = [f"{row}, {column}: {number(v, 3)}" for (column, row), v in inside.items()]
        series.append(Series(name, "points", x, y, color, style, notes=notes))
    height = max(0.6, len(rows) / 10)
    limits = (0.5, len(rows) + 0.5), (0.5, len(columns) + 0.5)
    panel = Panel("", series, height, limits=limits[0], ticks=rows[::-1])
    names = columns if len(columns) <= NAMED else [""]
    title = f"{title} by structure and data set"
    return Figure(title, "", [panel], limits=limits[1], ticks=names)


def _evidence(comparison: Comparison) -> dict[tuple[str, str], float]:
    return {
        (row["measure"], label): value
        for row in comparison.table
        if row["output"] == EVIDENCE
        for label, value in row["values"].items()
        if value is not None
    }


def _shares(study: Study) -> dict[tuple[str, str], float]:
    """Return the least share of agreeing starts by data set and structure."""
    shares: dict[tuple[str, str], float] = {}
    structure = study.structures
    for member in study.members:
        factors, agreeing = member.factors, member.answer.get("agreeing", 0)
        if {"data", structure} <= factors.keys():
            key = factors["data"], factors[structure]
            shares[key] = min(agreeing / max(member.runs, 1), shares.get(key, 1.0))
    return shares


def _values(study: Study, quantity: str) -> list[Value]:
    values = []
    for member in study.done:
        answer = member.answer
        known = {**answer, **answer.get("at", {}), **answer["derived"], **answer["estimate"]}
        if known.get(quantity) is not None:
            error = answer["standard_error"].get(quantity) or 0.0
            values.append((member, known[quantity], error))
    if not values:
        raise ValueError(f"no member has the quantity {quantity!r:.60}.")
    return values


def _label(study: Study, quantity: str) -> str:
    units = {n: unit for m in study.done for n, unit in m.answer.get("unit", {}).items()}
    return with_unit(quantity, units.get(quantity, ""))


def _by_model(values: list[Value]) -> list[tuple[str, list[Value]]]:
    def model(value: Value) -> str:
        return value[0].factors["model"]

    return [(name, [*group]) for name, group in groupby(sorted(values, key=model), model)]
