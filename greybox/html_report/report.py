"""A page about one or several fits, to look at and to hand on."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.safe_files import write_text
from greybox.files.text_table import counted
from greybox.html_report.entry import Entry
from greybox.html_report.interval_section import bootstrap_table
from greybox.html_report.page import page
from greybox.study.bootstrap import Bootstrap
from greybox.study.study import Study, StudyMember
from greybox.validation.comparison import Comparison
from greybox.validation.same_data import labels_of

DETAILED = 12  # members of a study whose fits are loaded and shown: as many as one looks through


def report(
    fits: Fit | Study | Sequence[Fit | Study],
    path: str | Path,
    *,
    comparison: Comparison | None = None,
    bootstraps: Sequence[Bootstrap] = (),
    details: Collection[str] = (),
    title: str = "",
) -> None:
    """Write a page about fits: one HTML file that needs nothing else, for a browser, for print, for a colleague.

    Parameters
    ----------
    fits : Fit, Study or sequence of them
        Several stand side by side. Of a fit that was loaded without its model the page shows what
        the file holds, and says what it cannot draw.
    path : str or Path
        An existing file is replaced once the new one is complete.
    comparison : Comparison, optional
        With held-out results: ``gb.compare(a, b, records=flight)``. By default up to six fits are
        compared on their own data.
    bootstraps : sequence of Bootstrap
        Of some of the fits, which they stand beside; profiles are shown where a fit holds them.
    details : collection of str
        Members of studies to show in detail, names or patterns such as ``"pitch*"``. By default up
        to twelve: the one of the lowest cost for each data set and criterion, then the next.
    title : str
        By default the name of the fit.

    Raises
    ------
    TypeError, ValueError
        For what is no fit, or for nothing.
    OSError
        If the folder cannot be written.
    """
    given = [fits] if isinstance(fits, Fit | Study) else list(fits)
    wrong = [thing for thing in given if not isinstance(thing, Fit | Study)]
    if wrong:
        raise TypeError(
            f"cannot report {wrong[0]!r:.80}: give fits, such as gb.fit(problem) returns, or a study."
        )
    if comparison is not None and not isinstance(comparison, Comparison):
        raise TypeError(f"comparison is {comparison!r:.80}: give what gb.compare returns.")
    alone = [thing for thing in given if isinstance(thing, Fit)]
    labels = iter(labels_of(alone))
    entries: list[Entry] = []
    for thing in given:
        entries += (
            [Entry(next(labels), thing)]
            if isinstance(thing, Fit)
            else study_entries(thing, details)
        )
    said = [found.summary() for found in bootstraps]
    write_page(with_bootstraps(entries, said), Path(path), comparison, title)


def write_page(
    entries: Sequence[Entry], path: Path, comparison: Comparison | None = None, title: str = ""
) -> None:
    """Write the page of these results.

    Raises
    ------
    ValueError
        If there are none.
    """
    if not entries:
        raise ValueError("there is nothing to report: give at least one fit.")
    (first, *more) = entries
    by_default = (
        f"{counted(len(entries), 'result')} side by side"
        if more
        else first.answer.get("problem", first.label)
    )
    with np.errstate(all="ignore"):  # files come from anyone: what is not finite is not drawn
        text = page(entries, comparison, title or by_default)
    write_text(path, text)


def with_bootstraps(entries: Sequence[Entry], said: Sequence[Mapping[str, Any]]) -> list[Entry]:
    """Return the entries, each with the bootstrap of its fit if one of these summaries is; names tell.

    Raises
    ------
    ValueError
        For what is no such summary, or of none of the fits.
    """
    found = {}
    for summary in said:
        try:
            bootstrap_table(summary)
            name = summary["problem"]
        except (LookupError, TypeError, ValueError, AttributeError):
            raise ValueError(
                "a bootstrap is not understood: give what greybox bootstrap --json printed."
            ) from None
        if not any(entry.fit is not None and entry.fit.name == name for entry in entries):
            raise ValueError(
                f"there is a bootstrap of {name!r:.60}, and no fit of that name on this page."
            )
        found[name] = summary
    return [
        entry if entry.fit is None else replace(entry, bootstrap=found.get(entry.fit.name, {}))
        for entry in entries
    ]


def study_entries(study: Study, details: Collection[str] = ()) -> list[Entry]:
    """Return the members of a study, with the fits of those whose `details` are shown.

    Raises
    ------
    ValueError
        If no member with an answer has one of these names.
    """
    done = [member for member in study.members if member.status == "done"]
    shown = {member.name for member in _best(done)[:DETAILED]}
    if details:
        for name in details:
            if not any(_is_called(member, name) for member in done):
                raise ValueError(
                    f"the study has no answer of a member {name!r}: its members are in its table."
                )
        shown = {
            member.name for member in done if any(_is_called(member, name) for name in details)
        }
    return [
        Entry(
            member.name,
            member.fit if member.name in shown else None,
            member.answer,
            str(member.file),
            "" if member.status == "done" else member.error or "unfinished",
        )
        for member in study.members
    ]


def _is_called(member: StudyMember, name: str) -> bool:
    return member.name == name or fnmatchcase(member.name, name)


def _best(members: Sequence[StudyMember]) -> list[StudyMember]:
    """Return the members by their place among those whose costs can be compared, which have data and criterion alike.

    Of one place, those by the first criterion of each data set come first.
    """
    rules: dict[str, dict[str, int]] = {}  # of a data set, in the order of the study
    for member in members:
        of_data = rules.setdefault(member.answer["checksum"], {})
        of_data.setdefault(member.answer["rule"], len(of_data))
    places: dict[tuple[str, str], int] = {}
    ranked = []
    for k, member in sorted(enumerate(members), key=lambda pair: _cost(pair[1])):
        data, rule = member.answer["checksum"], member.answer["rule"]
        places[data, rule] = places.get((data, rule), 0) + 1
        ranked.append((places[data, rule], rules[data][rule], k, member))
    return [member for *_, member in sorted(ranked, key=lambda entry: entry[:3])]


def _cost(member: StudyMember) -> float:
    cost = member.answer["cost"]
    return math.inf if cost is None else float(cost)
