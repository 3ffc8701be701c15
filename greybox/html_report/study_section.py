"""A study in a few figures, before its members."""

from collections import Counter
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from greybox.html_report.comparison_section import GRADES
from greybox.html_report.elements import tag
from greybox.html_report.figure import figure_grid
from greybox.html_report.tables import Cell, table
from greybox.plotting.study import estimates_figure, structures_figure
from greybox.study.study import FAILURES, Study


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
