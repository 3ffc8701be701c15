"""Tables of the page, which its script can sort."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from greybox.estimate.identifiability import ERROR_GUIDELINE, INSENSITIVITY_GUIDELINE
from greybox.estimate.result import Fit, Quantity
from greybox.estimate.verdict import percent
from greybox.files.text_table import number, with_error
from greybox.html_report.elements import Child, tag

PROSE = 24  # characters from which a text is broken into lines


@dataclass(frozen=True)
class Cell:
    """What stands in a cell, the number it is sorted by, and whether it is marked."""

    text: Child
    value: float | None = None
    mark: str = ""


def table(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> Element:
    """Return a table; columns of numbers are flush right."""
    numeric = [any(row[k].value is not None for row in rows) for k in range(len(header))]
    head = tag(
        "tr", *(_header(text, is_number) for text, is_number in zip(header, numeric, strict=True))
    )
    body = tag("tbody", *(tag("tr", *map(_cell, row, numeric)) for row in rows))
    return tag(
        "div",
        tag("table", tag("thead", head), body, class_="sortable"),
        class_="scroll",
        tabindex="0",
    )


def parameter_table(fit: Fit) -> Element:
    """Return the table of all parameters and derived quantities of a fit, or of those where its best run ended."""
    if not fit.converged:
        return _best_effort(fit)
    intervals = fit.interval(0.95)
    error, insensitivity = _shares(fit)
    rows = []
    for q in fit.quantities:
        value, spread = with_error(q.value, q.standard_error)
        low, high = intervals.get(q.name, (math.nan, math.nan))
        rows.append(
            [
                Cell(q.name),
                Cell(value, q.value),
                Cell("–", None) if spread == "-" else Cell(spread, q.standard_error),
                Cell(_interval(low, high), low),
                Cell(q.unit),
                _share(error.get(q.name), ERROR_GUIDELINE),
                _share(insensitivity.get(q.name), INSENSITIVITY_GUIDELINE),
                Cell(_bounds(q)),
                Cell("at bound" if q.at_bound else q.kind, mark="doubt" if q.at_bound else ""),
                Cell(q.about),
            ]
        )
    header = (
        "parameter",
        "estimate",
        "± error",
        "95 % interval",
        "unit",
        "CR, %",
        "insensitivity, %",
        "bounds",
        "kind",
    )
    return table([*header, "meaning"], rows)


def number_cell(value: float | None, digits: int = 5) -> Cell:
    """Return the cell of a number; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return Cell("–")
    return Cell(number(value, digits), value)


def _best_effort(fit: Fit) -> Element:
    values = fit.best_effort or {}
    rows = [
        [
            Cell(q.name),
            number_cell(values.get(q.name)),
            Cell(q.unit),
            Cell(_bounds(q)),
            Cell(q.kind),
            Cell(q.about),
        ]
        for q in fit.quantities
        if q.name in values or not values
    ]
    return table(["parameter", "ended at", "unit", "bounds", "kind", "meaning"], rows)


def _shares(fit: Fit) -> tuple[dict[str, float], dict[str, float]]:
    """Return errors and insensitivities by name as shares of the values; nothing where the fit has none."""
    try:
        judged = fit.identifiability
    except ValueError:
        return {}, {}
    pairs = (judged.error.tolist(), judged.insensitivity.tolist())
    error, insensitivity = (dict(zip(judged.names, column, strict=True)) for column in pairs)
    return error, insensitivity


def _share(share: float | None, guideline: float) -> Cell:
    if share is None or math.isnan(share):
        return Cell("–")
    text = "∞" if math.isinf(share) else percent(share)
    return Cell(
        f"{text} !" if share > guideline else text,
        min(share, 1e300),
        "doubt" if share > guideline else "",
    )


def _interval(low: float, high: float) -> str:
    if not (math.isfinite(low) and math.isfinite(high)):
        return "–"
    low_text, _ = with_error(low, (high - low) / 4)
    high_text, _ = with_error(high, (high - low) / 4)
    return f"{low_text} to {high_text}".replace("-", "−")


def _bounds(q: Quantity) -> str:
    return (
        f"{q.bounds[0]:g} to {q.bounds[1]:g}".replace("-", "−").replace("inf", "∞")
        if q.kind == "free"
        else ""
    )


def _header(text: str, is_number: bool) -> Element:
    return tag("th", text, scope="col", class_="number" if is_number else None)


def _cell(cell: Cell, is_number: bool) -> Element:
    is_prose = isinstance(cell.text, str) and len(cell.text) > PROSE
    classes = [cell.mark, *(["number"] if is_number else []), *(["prose"] if is_prose else [])]
    text = cell.text.replace("-", "−") if is_number and isinstance(cell.text, str) else cell.text
    value = f"{cell.value:.12g}" if cell.value is not None and math.isfinite(cell.value) else None
    return tag("td", text, class_=" ".join(filter(None, classes)) or None, data_value=value)
