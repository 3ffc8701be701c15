"""The page: everything in one file, which needs no network and runs no other script than its own."""

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from xml.etree.ElementTree import Element

from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.html_report.comparison_section import comparison_section, overview
from greybox.html_report.elements import Child, html, tag
from greybox.html_report.entry import Entry
from greybox.html_report.fit_section import fit_section
from greybox.plotting.long_lines import COLUMNS
from greybox.validation.comparison import Comparison

LARGEST = 2_900_000  # bytes of a page, so that mail takes it: from there on results stand in the table alone
LINES = 1_200_000  # bytes for the lines of records, of LARGEST
FEWEST = 200  # columns of a line, however many lines there are
BYTES = 30  # of a column of a line: two points of two numbers
LINKS = 13  # sections up to which all are linked at the top: the table and the details of twelve results
OPEN = 3  # results up to which the details of all are open

HERE = Path(__file__).parent


def page(entries: Sequence[Entry], comparison: Comparison | None, title: str) -> str:
    """Return the page of these results as HTML."""
    columns = _columns([entry.fit for entry in entries if entry.fit is not None])
    if len(entries) == 1 and entries[0].fit is not None and comparison is None:
        (entry,) = entries
        sections = [_section(name, content) for name, content in fit_section(entry, columns)]
        return _document(title, sections)

    compared = comparison_section(entries, comparison, columns)
    sections, entries = _details(
        entries, columns, sum(len(html(part).encode()) for part in compared)
    )
    content: list[Child] = [overview(entries), compared]
    left_out = sum(entry.fit is not None and not entry.anchor for entry in entries)
    if any(entry.fit is None and not entry.error for entry in entries):
        detailed = counted(sum(entry.fit is not None for entry in entries), "result")
        text = (
            f"Below are details of {detailed}, the best of each data set and criterion or those asked for; "
            "greybox report STUDY --details NAME shows others."
        )
        content.insert(0, tag("p", text))
    if left_out:
        text = (
            f"The details of {counted(left_out, 'result')} are left out to keep the page below 3 MB: "
            "write a page of each with greybox report RESULT."
        )
        content.insert(0, tag("p", text))
    return _document(title, [_section("Comparison", content), *sections])


def _details(
    entries: Sequence[Entry], columns: int, size: int
) -> tuple[list[Element], list[Entry]]:
    """Return the sections of as many results as the page of so many bytes holds, and all entries with their anchors."""
    sections: list[Element] = []
    anchored: list[Entry] = []
    for k, entry in enumerate(entries):
        anchor = ""
        if entry.fit is not None and size < LARGEST:
            anchor = f"result-{k + 1}"
            section = _details_of(
                entry.label, fit_section(entry, columns), anchor, len(entries) <= OPEN
            )
            size += len(html(section).encode())
            if size < LARGEST:
                sections.append(section)
            else:
                anchor = ""
        anchored.append(replace(entry, anchor=anchor))
    return sections, anchored


def _details_of(
    label: str, parts: Iterable[tuple[str, list[Element]]], anchor: str, is_open: bool
) -> Element:
    inside = [element for name, content in parts for element in (tag("h3", name), *content)]
    return tag(
        "section", tag("details", tag("summary", tag("h2", label)), inside, open=is_open), id=anchor
    )


def _columns(fits: Sequence[Fit]) -> int:
    """Return how many columns of every line of records the page has room for."""
    lines = sum(
        3 * len(part.outputs) + len(part.data.signals) for fit in fits for part in fit.records[:6]
    )
    return max(FEWEST, min(COLUMNS, LINES // (BYTES * max(lines, 1))))


def _section(title: str, content: Child, anchor: str = "") -> Element:
    return tag(
        "section", tag("h2", title), content, id=anchor or re.sub(r"\W+", "-", title.lower())
    )


def _document(title: str, sections: Sequence[Element]) -> str:
    script, style = ((HERE / name).read_text(encoding="utf-8") for name in ("page.js", "page.css"))
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; base-uri 'none'; "
        "form-action 'none'"
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name_="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name_="generator", content=f"greybox {version('greybox-id')}"),
        tag("title", title),
        tag("style", style),
    )
    # The table of many results has links to those with details.
    linked = sections if len(sections) <= LINKS else sections[:1]
    links = [tag("a", _title(section), href=f"#{section.get('id')}") for section in linked]
    header = tag(
        "header",
        tag("div", tag("h1", title)),
        tag("button", "Colors: auto", type="button", id="theme", hidden=True),
    )
    nav = tag("nav", tag("ul", *(tag("li", link) for link in links)), aria_label="Sections")
    without = tag(
        "noscript",
        tag("p", "The figures need the script of this page, which is switched off here."),
    )
    body = tag("body", header, nav, without, tag("main", *sections), tag("script", script))
    return f"<!DOCTYPE html>\n{html(tag('html', head, body, lang='en'))}\n"


def _title(section: Element) -> str:
    heading = section.find(".//h2")
    return "" if heading is None else "".join(heading.itertext())


def _hash(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
