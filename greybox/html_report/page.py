"""The page: one file that needs no network and runs no script except its own."""

import base64
import hashlib
import re
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from itertools import starmap
from pathlib import Path
from xml.etree.ElementTree import Element

from greybox.experiment.margins import Margins
from greybox.files.text_table import counted
from greybox.html_report.comparison_section import comparison_section, overview, study_section
from greybox.html_report.elements import Child, html, tag
from greybox.html_report.entry import Entry
from greybox.html_report.figure import figure_grid
from greybox.html_report.fit_section import fit_section
from greybox.plotting.loops import loop_figures
from greybox.study.study import Study
from greybox.validation.comparison import Comparison

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
    margins: Sequence[Margins] = (),
    author: str = "",
) -> str:
    """Return the page of these results, and of the margins of their loops, as HTML."""
    loops = [(tag("pre", str(loop)), figure_grid(loop_figures(loop))) for loop in margins]
    appended = [_section("Stability margins", loops)] if loops else []
    fits = [entry.fit for entry in entries if entry.fit is not None]
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
    sections += [
        _details(entry, is_open=len(entries) <= OPEN) for entry in entries if entry.fit is not None
    ]
    return _document(title, [*sections, *appended], author)


def _details(entry: Entry, *, is_open: bool) -> Element:
    """Return the section of one of several results."""
    inside = [(tag("h3", name), content) for name, content in fit_section(entry)]
    summary = tag("summary", tag("h2", entry.label))
    return tag("section", tag("details", summary, inside, open=is_open), id=entry.anchor)


def _section(title: str, content: Child) -> Element:
    return tag("section", tag("h2", title), content, id=re.sub(r"\W+", "-", title.lower()))


def _document(title: str, sections: Sequence[Element], author: str) -> str:
    script, style = ((HERE / name).read_text(encoding="utf-8") for name in ("page.js", "page.css"))
    links = [
        tag("li", tag("a", section.findtext(".//h2"), href=f"#{section.get('id')}"))
        for section in sections
    ]
    byline = ", ".join(filter(None, [author, str(date.today())]))
    return PAGE.format(
        title=html(tag("title", title)),
        heading=html(tag("h1", title)) + html(tag("p", byline, class_="soft")),
        links=html(tag("ul", links)),
        main=html(tag("main", *sections)),
        policy=POLICY.format(_hash(script), _hash(style)),
        script=script,
        style=style,
        version=version("greybox-id"),
    )


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
