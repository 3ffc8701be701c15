"""The page: one file that needs no network and runs no script except its own."""

import base64
import hashlib
import re
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from xml.etree.ElementTree import Element

from greybox.files.text_table import counted
from greybox.html_report.comparison_section import comparison_section, overview
from greybox.html_report.elements import Child, html, tag
from greybox.html_report.entry import Entry
from greybox.html_report.fit_section import fit_section
from greybox.validation.comparison import Comparison

OPEN = 3  # results up to which all details are open

HERE = Path(__file__).parent


def page(entries: Sequence[Entry], comparison: Comparison | None, title: str) -> str:
    """Return the page of these results as HTML."""
    fits = [entry.fit for entry in entries if entry.fit is not None]
    # A single result needs no comparison, and its sections are those of the page.
    if len(entries) == 1 and fits and comparison is None:
        sections = [_section(name, content) for name, content in fit_section(entries[0])]
        return _document(title, sections)

    content = [overview(entries), *comparison_section(entries, comparison)]
    if any(entry.fit is None and not entry.error for entry in entries):
        text = (
            f"Below are details of {counted(len(fits), 'result')}; greybox report FILE shows those "
            "of another member, whose file is in the folder of the study."
        )
        content.insert(0, tag("p", text))

    sections = [
        _details(entry, is_open=len(entries) <= OPEN) for entry in entries if entry.fit is not None
    ]
    return _document(title, [_section("Comparison", content), *sections])


def _details(entry: Entry, *, is_open: bool) -> Element:
    """Return the section of one of several results."""
    inside = [
        element for name, content in fit_section(entry) for element in (tag("h3", name), *content)
    ]
    summary = tag("summary", tag("h2", entry.label))
    return tag("section", tag("details", summary, inside, open=is_open), id=entry.anchor)


def _section(title: str, content: Child) -> Element:
    return tag("section", tag("h2", title), content, id=re.sub(r"\W+", "-", title.lower()))


def _document(title: str, sections: Sequence[Element]) -> str:
    script, style = ((HERE / name).read_text(encoding="utf-8") for name in ("page.js", "page.css"))
    # The page contains names from files of strangers. Should one slip through as markup, the
    # browser still runs only the script and the style with these hashes, and loads nothing.
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; "
        "base-uri 'none'; form-action 'none'"
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
    links = [tag("a", _title(section), href=f"#{section.get('id')}") for section in sections]
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
