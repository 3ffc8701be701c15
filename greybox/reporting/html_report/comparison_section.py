"""Several results side by side: tables, comparison, and figures that overlay them."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

from greybox.assessment.result import Fits
from greybox.assessment.validation.compare import compare
from greybox.assessment.validation.comparison import HELD_OUT, Comparison
from greybox.data.files.grouping import grouped, unique
from greybox.reporting.html_report.elements import (
    COLUMNS,
    Cell,
    figure_grid,
    number_cell,
    table,
    tag,
)
from greybox.reporting.html_report.fit_section import Entry
from greybox.reporting.plotting.figure import Figure
from greybox.reporting.plotting.overview import response_figures
from greybox.reporting.plotting.study import estimates_figure, structures_figure
from greybox.reporting.plotting.time_history import history_figure
from greybox.workflows.study.study import FAILURES, Study, shown

GRADES = {"good": "good", "doubt": "in doubt", "poor": "poor", "failed": "failed"}


def comparison_section(entries: Sequence[Entry], comparison: Comparison | None) -> list[Element]:
    """Return estimates, tests and figures of all results."""
    labels = []
    fits = []
    for entry in entries:
        if entry.fit is not None and entry.fit.converged:
            labels.append(entry.label)
            fits.append(entry.fit)
    # More curves than colors cannot be distinguished.
    few = 2 <= len(fits) <= 6  # fits in one figure: there are six colors
    content = list(_estimates(entries))
    if comparison is None and few:
        try:
            comparison = compare(*fits, labels=labels)
        except (ValueError, LookupError) as error:  # a page about other data is still a page
            content.append(tag("p", f"They are not compared by a test: {error.args[0]}"))
    if comparison is not None:
        content += _comparison(comparison)
    figures = list(_figures(fits, labels, comparison)) if few else []
    return [*content, figure_grid(figures)] if figures else content


def overview(entries: Sequence[Entry]) -> Element:
    """Return the table of all results, with links to their sections."""
    header = ["result", "verdict", "model", "criterion", "cost", "starts agreeing", "warnings"]
    return table([*header, "data"], [_overview_row(entry) for entry in entries])


def _overview_row(entry: Entry) -> list[Cell]:
    # Members of a study whose fits are not loaded have no section to which a link could lead.
    name = Cell(tag("a", entry.label, href=f"#{entry.anchor}") if entry.anchor else entry.label)
    answer = entry.answer
    if entry.error or not answer:
        return [name, Cell(entry.error or "no result", mark="failed"), *[Cell("")] * 6]
    grade = answer["verdict"]["grade"]
    agreeing = answer["agreeing"]
    warnings = len(answer["warnings"])
    agreement = f"{agreeing} of {answer['starts']}" if answer["converged"] else "–"
    return [
        name,
        Cell(GRADES[grade], mark=grade),
        Cell(", ".join(answer["model"])),
        Cell(answer["criterion"]),
        number_cell(answer["cost"], 6),
        Cell(agreement, float(agreeing)),
        Cell(str(warnings), float(warnings)),
        Cell(", ".join(answer["data"])),
    ]


def _estimates(entries: Sequence[Entry]) -> Iterator[Element]:
    """Yield a table of all estimates, with a column for every parameter."""
    estimated = [e for e in entries if e.answer.get("converged") and e.answer["standard_error"]]
    names = unique(name for entry in estimated for name in entry.answer["standard_error"])
    if names:
        yield tag("h3", "Estimates with standard errors")
    # If there are more estimates than fit on a page, structures have tables of their own.
    is_wide = len(names) > 12
    for group in grouped(estimated, lambda e: is_wide and tuple(e.answer["standard_error"])):
        columns = group[0].answer["standard_error"] if is_wide else names
        rows = [[Cell(e.label), *_estimate_cells(e.answer, columns)] for e in group]
        yield table(["result", *columns], rows)


def _estimate_cells(answer: Mapping[str, Any], names: Iterable[str]) -> Iterator[Cell]:
    values = {**answer["derived"], **answer["estimate"]}
    for name in names:
        if values.get(name) is None:
            yield Cell("–" if name in values else "")
            continue
        yield Cell(shown(values[name], answer["standard_error"][name]), values[name])


def _comparison(comparison: Comparison) -> Iterator[Element]:
    yield tag("h3", "Comparison")
    yield tag("p", f"Data: {comparison.data}.")
    for statement in filter(None, (comparison.verdict, *comparison.statements)):
        yield tag("p", statement)
    rows = [
        [
            *map(Cell, (row.data, row.output, row.measure, row.unit)),
            *map(Cell, row.texts, row.values),
        ]
        for row in comparison.rows
    ]
    yield table(["data", "output", "measure", "unit", *comparison.labels], rows)


def _figures(fits: Fits, labels: Sequence[str], comparison: Comparison | None) -> Iterator[Figure]:
    """Yield responses and histories of all, and predictions of records that no fit has used."""
    if all(fit.responses for fit in fits):
        yield from response_figures(fits, labels)

    for k in range(min(len(fit.records) for fit in fits)):
        try:
            yield history_figure(fits, k, labels, COLUMNS)
        except ValueError:  # the fits have different records, which no figure can show together
            break

    if comparison is not None:
        for predictions in zip(*comparison.predictions.get(HELD_OUT, ()), strict=True):
            yield history_figure(predictions, 0, comparison.labels, COLUMNS)


def study_section(study: Study) -> Iterator[Element]:
    """Yield how many members are done and how good they are, and which structure is supported."""
    if study.failed:
        yield table(FAILURES, [[*map(Cell, row)] for row in study.failed])
    if not study.done:
        return
    grades = Counter(member.answer["verdict"]["grade"] for member in study.done)
    texts = (f"{grades[grade]} {text}" for grade, text in GRADES.items() if grades[grade])
    yield tag("p", f"{study.state}. The fits: {', '.join(texts)}.")
    figures = [structures_figure(study), estimates_figure(study, "cost")]
    if len(study.select(status="done").groups(study.structures)) > 1:
        comparison = study.ranking()
        yield from (tag("p", text) for text in (comparison.verdict, *comparison.statements) if text)
        figures.insert(0, structures_figure(comparison))
    yield figure_grid(figures)
