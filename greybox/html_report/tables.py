"""Tables of the page; its script can sort them."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from greybox.estimate import printed
from greybox.estimate.identifiability import ERROR_GUIDELINE, INSENSITIVITY_GUIDELINE
from greybox.estimate.result import Fit
from greybox.files.arrays import Labels, by_name
from greybox.files.text_table import is_number, number, percent, with_error
from greybox.html_report.elements import Child, tag
from greybox.html_report.formula import with_formulas


@dataclass(frozen=True)
class Cell:
    """Text of a cell, the number by which it is sorted, and the class that marks it."""

    text: Child
    value: float | None = None
    mark: str = ""


def table(header: Labels, rows: Sequence[Sequence[Cell]]) -> Element:
    """Return a table; columns of numbers are flush right."""
    # One number makes a column of numbers: dashes stand for those that are not known.
    is_number = [any(row[k].value is not None for row in rows) for k in range(len(header))]
    head = [
        tag("th", text, scope="col", class_="number" if right else None)
        for text, right in zip(header, is_number, strict=True)
    ]
    body = tag("tbody", *(tag("tr", *map(_cell, row, is_number)) for row in rows))
    sortable = tag("table", tag("thead", tag("tr", *head)), body, class_="sortable")
    return tag("div", sortable, class_="scroll", tabindex="0")


def parameter_table(fit: Fit) -> Element:
    """Return the table of all quantities; for a failed fit, the last values of its best run."""
    header, rows, _ = printed.parameter_table(fit)
    cells = [[Cell(x, float(x)) if is_number(x) else Cell(x) for x in row] for row in rows]
    for row, (*_, about) in zip(cells, rows, strict=True):
        row[-1] = Cell(with_formulas(about) if "$" in about else about)
    if fit.converged:
        header = [*header[:3], "95 % interval", "CR, %", "insensitivity, %", *header[3:]]
        intervals, errors, insensitivities = fit.interval(0.95), {}, {}
        with suppress(ValueError):  # the fit has no standard errors
            judged = fit.identifiability
            errors = by_name(judged.names, judged.error.tolist())
            insensitivities = by_name(judged.names, judged.insensitivity.tolist())
        for row, (name, *_) in zip(cells, rows, strict=True):
            low, high = intervals.get(name, (math.nan, math.nan))
            row[3:3] = [
                Cell(_interval(low, high), low),
                _share(errors.get(name, math.nan), ERROR_GUIDELINE),
                _share(insensitivities.get(name, math.nan), INSENSITIVITY_GUIDELINE),
            ]
    return table(header, cells)


def number_cell(value: float | None, digits: int = 5) -> Cell:
    """Return the cell of a number; a dash for an unknown one."""
    if value is None or not math.isfinite(value):
        return Cell("–")
    return Cell(number(value, digits), value)


def _share(share: float, guideline: float) -> Cell:
    if math.isnan(share):
        return Cell("–")
    text = percent(share)
    return Cell(f"{text} !", share, "doubt") if share > guideline else Cell(text, share)


def _interval(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)):
        return "–"
    # A quarter of a 95 % interval is about one standard error, which decides the digits.
    return " to ".join(with_error(end, (high - low) / 4)[0] for end in (low, high))


def _cell(cell: Cell, is_number: bool) -> Element:
    text = cell.text
    classes = [cell.mark, "number" if is_number else ""]
    # Numbers are never broken into lines; sentences must be, or they would widen the page.
    if isinstance(text, str):
        if len(text) > 24:  # characters from which a text is broken into lines
            classes.append("prose")
        if is_number:
            text = text.replace("-", "−").replace("inf", "∞")

    # The script sorts by this number, not by the rounded text.
    value = f"{cell.value:.12g}" if cell.value is not None and math.isfinite(cell.value) else None
    return tag("td", text, class_=" ".join(filter(None, classes)) or None, data_value=value)
