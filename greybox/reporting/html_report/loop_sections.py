"""The sections of the page about loops: stability margins, and proposed gains."""

import math
from collections.abc import Iterator, Sequence

from greybox.data.files.numbers_in_text import number
from greybox.data.files.wording import capitalized
from greybox.reporting.html_report.elements import Cell, Child, figure_grid, number_cell, table, tag
from greybox.reporting.plotting.gains import comparison_figures, gains_figure
from greybox.reporting.plotting.loops import loop_figures
from greybox.workflows.experiment.margin_values import Margins
from greybox.workflows.experiment.safe_gains import PROMISE, SafeGains


def margin_section(loops: Sequence[Margins]) -> Iterator[tuple[str, Child]]:
    """Yield the title and the content of the section about margins, if there are any."""
    content = []
    for loop in loops:
        content.append(tag("p", tag("strong", capitalized(loop.verdict))))
        if loop.margins:
            content.append(_margin_table(loop))
        content += [tag("p", note, class_="soft") for note in loop.notes]
        content.append(figure_grid(loop_figures(loop)))
    if content:
        yield "Stability margins", content


def _margin_table(loop: Margins) -> Child:
    """Return the table of the margins of a loop; an asterisk marks extrapolated ones."""
    interval = "interval" if math.isnan(loop.level) else f"{100 * loop.level:g} % interval"
    rows = []
    for margin in loop.margins:
        ends = "–"
        if math.isfinite(margin.low):
            ends = f"{number(margin.low, 4)} to {number(margin.high, 4)}"
        place = number_cell(margin.omega, 4)
        if margin.is_extrapolated:
            place = Cell(f"{place.text} *", margin.omega)
        rows.append(
            [
                Cell(margin.name),
                Cell(margin.group),
                number_cell(margin.value, 4),
                Cell(ends),
                Cell(margin.unit),
                place,
            ]
        )
    return table(["", "of", "value", interval, "unit", "at rad/s"], rows)


def gain_section(safe: SafeGains | None) -> Iterator[tuple[str, Child]]:
    """Yield the title and the content of the section about gains, if there are any."""
    if safe is None:
        return
    content = [tag("p", tag("strong", capitalized(safe.verdict)))]
    comparison = safe.comparison
    if comparison and safe.is_usable:
        header, rows = comparison.table()
        marks = {"better": "", "as good": "", "worse": "doubt", "may be worse": "doubt"}
        cells = [[*map(Cell, row[:-1]), Cell(row[-1], mark=marks[row[-1]])] for row in rows]
        content.append(table(header, cells))
        content += [tag("p", line, class_="soft") for line in comparison.remarks]
    if safe.steps:
        header = ["gain", "today", "step 1", "step 2", "proposed"]
        steps = []
        for name, today in safe.today.items():
            values = [today, *(step[name] for step in safe.steps)]
            steps.append([Cell(name), *(number_cell(value, 4) for value in values)])
        content += [table(header, steps), tag("p", f"Fly the steps one after the other. {PROMISE}")]
    content += [tag("p", note, class_="soft") for note in safe.notes]
    content.append(figure_grid([gains_figure(safe), *comparison_figures(safe)]))
    yield "Gains", content
