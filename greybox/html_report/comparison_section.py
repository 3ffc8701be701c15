"""Several results side by side: one table of all, how they compare, and their figures laid over one another."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.etree.ElementTree import Element

from greybox.estimate.result import Fit
from greybox.files.text_table import with_error
from greybox.html_report.elements import tag
from greybox.html_report.entry import Entry
from greybox.html_report.figure import figure_grid
from greybox.html_report.tables import Cell, number_cell, table
from greybox.plotting.bode import bode_figure
from greybox.plotting.figure import Figure
from greybox.plotting.nyquist import nyquist_figures
from greybox.plotting.time_history import history_figure
from greybox.validation.compare import compare
from greybox.validation.comparison import HELD_OUT, Comparison

OVERLAID = 6  # fits in one figure: there are six colors
WIDEST = 12  # quantities in one table: more do not fit beside one another


def comparison_section(
    entries: Sequence[Entry], comparison: Comparison | None, columns: int
) -> list[Element]:
    """Return what the results say beside one another: estimates, tests, and figures of all."""
    fits = [
        (entry.label, entry.fit)
        for entry in entries
        if entry.fit is not None and entry.fit.converged
    ]
    content = list(_estimates(entries))
    labels, converged = [label for label, _ in fits], [fit for _, fit in fits]
    if comparison is None and 2 <= len(fits) <= OVERLAID:
        try:
            comparison = compare(*converged, labels=labels)
        except (ValueError, LookupError) as error:
            content.append(tag("p", f"They are not compared by a test: {error.args[0]}"))
    if comparison is not None:
        content += _comparison(comparison)
    drawn = (
        list(_figures(converged, labels, comparison, columns)) if 2 <= len(fits) <= OVERLAID else []
    )
    if drawn:
        content.append(figure_grid(drawn))
    return content


def overview(entries: Sequence[Entry]) -> Element:
    """Return the table of all results, with links to their sections."""
    rows = []
    for entry in entries:
        name = Cell(tag("a", entry.label, href=f"#{entry.anchor}") if entry.anchor else entry.label)
        answer = entry.answer
        if entry.error or not answer:
            rows.append([name, Cell(entry.error or "no result", mark="failed"), *[Cell("")] * 6])
            continue
        grade = answer["verdict"]["grade"]
        agreeing, warnings = answer["agreeing"], len(answer["warnings"])
        rows.append(
            [
                name,
                Cell({"good": "good", "doubt": "in doubt", "failed": "failed"}[grade], mark=grade),
                Cell(", ".join(answer["model"])),
                Cell(answer["criterion"]),
                number_cell(answer["cost"], 6),
                Cell(
                    f"{agreeing} of {answer['starts']}" if answer["converged"] else "–",
                    float(agreeing),
                ),
                Cell(str(warnings), float(warnings)),
                Cell(", ".join(answer["data"])),
            ]
        )
    header = [
        "result",
        "verdict",
        "model",
        "criterion",
        "cost",
        "starts agreeing",
        "warnings",
        "data",
    ]
    return table(header, rows)


def _estimates(entries: Sequence[Entry]) -> Iterator[Element]:
    """Yield the table of all estimates with their errors, or, of very different results, one for each structure."""
    known = [
        entry
        for entry in entries
        if entry.answer.get("converged") and entry.answer["standard_error"]
    ]
    all_names = tuple(
        dict.fromkeys(name for entry in known for name in entry.answer["standard_error"])
    )
    groups: dict[tuple[str, ...], list[Entry]] = {}
    for entry in known:
        names = all_names if len(all_names) <= WIDEST else tuple(entry.answer["standard_error"])
        groups.setdefault(names, []).append(entry)
    if groups:
        yield tag("h3", "Estimates with standard errors")
    for names, group in groups.items():
        yield table(
            ["result", *names],
            [[Cell(entry.label), *_estimate_cells(entry.answer, names)] for entry in group],
        )


def _estimate_cells(answer: Mapping[str, Any], names: Sequence[str]) -> Iterator[Cell]:
    values = {**answer["derived"], **answer["estimate"]}
    for name in names:
        if values.get(name) is None:
            yield Cell("–" if name in values else "")
            continue
        spread = answer["standard_error"][name]
        value, error = with_error(values[name], math.nan if spread is None else spread)
        yield Cell(value if error == "-" else f"{value} ± {error}", values[name])


def _comparison(comparison: Comparison) -> Iterator[Element]:
    yield tag("h3", "Comparison")
    yield tag("p", f"Data: {comparison.data}.")
    for statement in comparison.statements:
        yield tag("p", statement)
    header = ["data", "output", "measure", "unit", *comparison.labels]
    rows = [
        [
            Cell(r.data),
            Cell(r.output),
            Cell(r.measure),
            Cell(r.unit),
            *(number_cell(value) for value in r.values),
        ]
        for r in comparison.rows
    ]
    yield table(header, rows)


def _figures(
    fits: Sequence[Fit], labels: Sequence[str], comparison: Comparison | None, columns: int
) -> Iterator[Figure]:
    """Yield responses and histories of all, and predictions of what none has seen."""
    if all(fit.responses for fit in fits):
        yield bode_figure(fits, labels)
        yield from nyquist_figures(fits, labels)
    for k in range(min(len(fit.records) for fit in fits)):
        try:
            yield history_figure(fits, k, labels, columns)
        except ValueError:  # other records
            break
    predictions = comparison.predictions.get(HELD_OUT, ()) if comparison else ()
    for of_record in zip(*predictions, strict=True):
        yield history_figure(of_record, 0, comparison.labels if comparison else labels, columns)
