"""The margins of loops on the page, with their figures."""

from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

from greybox.data.frequency_response import FrequencyResponse
from greybox.experiment.margins import Margins
from greybox.html_report.elements import tag
from greybox.html_report.figure import figure_grid
from greybox.html_report.tables import Cell, table
from greybox.plotting.loops import loop_figures


def margin_content(
    loops: Sequence[Margins], measured: Sequence[FrequencyResponse]
) -> Iterator[Element]:
    """Yield verdict, table and figures of every loop; measured points belong to the first one."""
    for answer in loops:
        heading, *rows = answer.rows
        yield tag("h3", f"{answer.plant}, broken at {answer.signal}")
        yield tag("p", answer.verdict[0].upper() + answer.verdict[1:])
        yield table(heading, [[Cell(text) for text in row] for row in rows])
        yield from (tag("p", note, class_="soft") for note in answer.notes)
        if answer.loop is not None:
            points = measured if answer is loops[0] else ()
            yield figure_grid(loop_figures(answer, *points))
