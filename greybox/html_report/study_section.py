"""A study in a few figures, before its members."""

from collections import Counter
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from greybox.files.text_table import number
from greybox.html_report.comparison_section import GRADES
from greybox.html_report.elements import tag
from greybox.html_report.figure import figure_grid
from greybox.plotting.study import estimates_figure, structures_figure
from greybox.study.store import StudyMember
from greybox.study.study import Study


def study_section(study: Study) -> Iterator[Element]:
    """Yield how many members are done and how good they are, and which structure is supported."""
    if not study.done:
        return
    grades = Counter(member.answer["verdict"]["grade"] for member in study.done)
    texts = (f"{grades[grade]} {text}" for grade, text in GRADES.items() if grades[grade])
    yield tag("p", f"{study.state}. Of the fits: {', '.join(texts)}.")
    figures = [structures_figure(study), estimates_figure(study, "cost")]
    if len(study.groups("model")) > 1:
        comparison = study.ranking()
        yield from (tag("p", text) for text in (comparison.verdict, *comparison.statements) if text)
        figures.insert(0, structures_figure(comparison))
    yield figure_grid(figures)
    if study.failures:
        yield tag("pre", study.failures)


def folded(study: Study) -> list[tuple[str, StudyMember]]:
    """Return the members with their names; those that agree in all but the seed are one."""
    alike: dict[tuple[str, ...], list[StudyMember]] = {}
    for member in study.members:
        factors = [f"{n} {value}" for n, value in member.factors.items() if n != "seed"]
        identity = member.answer["cost"] if member.status == "done" else member.number
        alike.setdefault((*factors, number(identity, 6)), []).append(member)
    return [
        (f"{first.name} and {len(others)} alike" if others else first.name, first)
        for first, *others in alike.values()
    ]
