"""A page about one or several fits, to look at and to share.

The page: one file that needs no network and runs no script except its own.
"""

import base64
import hashlib
import re
from collections.abc import Sequence
from datetime import date
from itertools import starmap
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from greybox.assessment.result import Fit
from greybox.assessment.validation.comparison import Comparison
from greybox.assessment.validation.same_data import labels_of
from greybox.data.files.argument_checks import checked_items, require_kind
from greybox.data.files.grouping import grouped
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.data.files.safe_files import write_text
from greybox.data.files.version import __version__
from greybox.data.files.wording import counted
from greybox.reporting.html_report.comparison_section import (
    comparison_section,
    overview,
    study_section,
)
from greybox.reporting.html_report.elements import Child, html, tag
from greybox.reporting.html_report.fit_section import Entry, fit_section
from greybox.reporting.html_report.loop_sections import gain_section, margin_section
from greybox.workflows.experiment.margin_values import Margins
from greybox.workflows.experiment.safe_gains import SafeGains
from greybox.workflows.study.members import StudyMember
from greybox.workflows.study.study import Study

DETAILED = 12  # members of a study whose fits are loaded and shown: as many as one looks through


@public
def report(
    fits: Fit | Study | Sequence[Fit | Study],
    path: str | Path,
    *,
    comparison: Comparison | None = None,
    margins: Margins | Sequence[Margins] = (),
    gains: SafeGains | None = None,
    title: str = "",
    author: str = "",
) -> None:
    """Write a page about fits: one HTML file for a browser, for print, or for a colleague.

    Parameters
    ----------
    fits : Fit, Study or sequence of them
        None, ``[]``, for margins of a loop that was only measured. Several are shown side by side;
        of a study, the first twelve members in detail. For a fit
        that was loaded without its model the page shows the contents of the file, and says what it
        cannot draw.
    path : str or Path
        An existing file is replaced once the new one is complete.
    comparison : Comparison, optional
        With held-out results: ``gb.compare(a, b, records=flight)``. By default up to six fits are
        compared on their own data.
    margins : Margins or sequence of them
        Margins of loops of these fits, shown with their figures.
    gains : SafeGains, optional
        Gains for these fits, shown beside today's with figures of both loops.
    title : str
        By default the name of the fit.
    author : str
        Who answers for the page; it is printed below the title, with today's date.

    Raises
    ------
    TypeError, ValueError
        For an object that is not a fit, for neither a fit nor margins, or for a path that does
        not end in ``.html``.
    OSError
        If the folder cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from greybox.problems import pitch_hover
    >>> gb.report(gb.fit(pitch_hover.problem(), starts=20), "pitch.html", title="Pitch in hover")
    >>> Path("pitch.html").stat().st_size > 50_000  # bytes
    True
    """
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{path} is not the name of a page: give one that ends in .html.")
    cure = "fits, such as gb.fit(problem) returns, or a study"
    results = checked_items("a result", fits, Fit | Study, cure)
    require_kind("comparison", comparison, Comparison | None, "what gb.compare returns")
    loops = checked_items("margins", margins, Margins, "what gb.margins returns")
    require_kind("gains", gains, SafeGains | None, "what gb.safe_gains returns")

    # A file from a stranger may contain any numbers, and warnings about them help nobody.
    with np.errstate(all="ignore"):
        # Labels of fits must differ, since links lead to them; members of a study have unique
        # names.
        labels = iter(labels_of([result for result in results if isinstance(result, Fit)]))
        entries: list[Entry] = []
        for result in results:
            if isinstance(result, Fit):
                entries.append(Entry(next(labels), result, result.to_dict()))
            else:
                entries += members_of(result)
        if not entries and not loops:
            raise ValueError("there is nothing to report: give at least one fit, or margins.")

        default = f"{counted(len(entries), 'result')} side by side"
        if not entries:
            default = "Stability margins"
        elif len(entries) == 1:
            default = entries[0].answer.get("problem", entries[0].label)
        studies = [result for result in results if isinstance(result, Study)]
        appended = [*margin_section(loops), *gain_section(gains)]
        text = page(entries, comparison, title or default, studies, appended, author)
    write_text(Path(path), text)


def members_of(study: Study) -> list[Entry]:
    """Return the members of a study, those with the same answer as one; the first with fits."""

    def seen(member: StudyMember) -> tuple[str, ...]:
        # Neither a seed nor an approximation of the delay need change an answer.
        factors = [
            f"{n} {value}" for n, value in member.factors.items() if n not in ("seed", "delay")
        ]
        identity = member.answer["cost"] if member.status == "done" else member.number
        return *factors, number(identity, 6)

    # Only the first ones are loaded: a page about a hundred fits would take minutes and megabytes.
    return [
        Entry(
            f"{first.name} and {len(others)} alike" if others else first.name,
            first.fit if k < DETAILED else None,
            first.answer,
            first.reason,
        )
        for k, (first, *others) in enumerate(grouped(study.members, seen))
    ]


OPEN = 3  # results up to which all details are open

HERE = Path(__file__).parent

# The page contains names from files of strangers. Should one slip through as markup, the browser
# still runs only the script and the style with these hashes, and loads nothing.
POLICY = (
    "default-src 'none'; img-src data:; script-src '{}'; style-src '{}'; base-uri 'none'; "
    "form-action 'none'"
)
PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="greybox {version}">
{title}<style>{style}</style>
</head>
<body>
<header><div>{heading}</div><button type="button" id="theme" hidden>Colors: auto</button></header>
<nav aria-label="Sections">{links}</nav>
<noscript><p>The figures need the script of this page, which is switched off here.</p></noscript>
{main}<script>{script}</script>
</body>
</html>
"""


def page(
    entries: Sequence[Entry],
    comparison: Comparison | None,
    title: str,
    studies: Sequence[Study] = (),
    titled: Sequence[tuple[str, Child]] = (),
    author: str = "",
) -> str:
    """Return the page of these results, and of `titled` sections about their loops, as HTML."""
    appended = list(starmap(_section, titled))
    fits = [entry.fit for entry in entries if entry.fit is not None]
    if not entries:
        return _document(title, appended, author)
    # A single result needs no comparison, and its sections are those of the page.
    if len(entries) == 1 and fits and comparison is None:
        sections = starmap(_section, fit_section(entries[0]))
        return _document(title, [*sections, *appended], author)

    content = [overview(entries), *comparison_section(entries, comparison)]
    if any(entry.fit is None and not entry.error for entry in entries):
        text = (
            f"Below are details of {counted(len(fits), 'result')}. For those of another member "
            "write a page about its fit alone."
        )
        content.insert(0, tag("p", text))

    sections = [_section("Summary", study_section(study)) for study in studies]
    sections.append(_section("Comparison", content))
    if len(entries) > 12:  # tables are printed across the paper
        sections[-1].set("class", "many")
    for entry in entries:
        if entry.fit is not None:
            inside = [(tag("h3", name), content) for name, content in fit_section(entry)]
            summary = tag("summary", tag("h2", entry.label))
            details = tag("details", summary, inside, open=len(entries) <= OPEN)
            sections.append(tag("section", details, id=entry.anchor))
    return _document(title, [*sections, *appended], author)


def _section(title: str, content: Child) -> Element:
    return tag("section", tag("h2", title), content, id=re.sub(r"\W+", "-", title.lower()))


def _document(title: str, sections: Sequence[Element], author: str) -> str:
    script = (HERE / "page.js").read_text(encoding="utf-8")
    style = (HERE / "page.css").read_text(encoding="utf-8")
    links = [
        tag("li", tag("a", section.findtext(".//h2", ""), href=f"#{section.get('id')}"))
        for section in sections
    ]
    byline = ", ".join(filter(None, [author, str(date.today())]))
    return PAGE.format(
        title=html(tag("title", title)),
        heading=html(tag("h1", title)) + html(tag("p", byline, class_="soft")),
        links=html(tag("ul", links)),
        main=html(tag("main", sections)),
        policy=POLICY.format(_hash(script), _hash(style)),
        script=script,
        style=style,
        version=__version__,
    )


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
