"""The margins of loops on the page, with their figures."""

from collections.abc import Iterator, Sequence
from xml.etree.ElementTree import Element

from greybox.data.frequency_response import FrequencyResponse
from greybox.experiment.margins import Margins
from greybox.html_report.elements import tag
from greybox.html_report.figure import figure_grid
from greybox.plotting.loops import loop_figures


def margin_content(
    loops: Sequence[Margins], measured: Sequence[FrequencyResponse]
) -> Iterator[Element]:
    """Yield the answer and the figures of every loop; measured points belong to the first one."""
    for k, answer in enumerate(loops):
        yield tag("pre", str(answer))
        yield figure_grid(loop_figures(answer, *([] if k else measured)))
