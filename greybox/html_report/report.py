"""A page about one or several fits, to look at and to hand on."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from greybox.data.safe_files import write_text
from greybox.data.text_table import counted
from greybox.estimate.result import Fit
from greybox.html_report.entry import Entry
from greybox.html_report.page import page
from greybox.study.study import Study
from greybox.validation.comparison import Comparison
from greybox.validation.same_data import labels_of


def report(
    fits: Fit | Study | Sequence[Fit | Study],
    path: str | Path,
    *,
    comparison: Comparison | None = None,
    title: str = "",
) -> None:
    """Write a page about fits: one HTML file that needs nothing else, for a browser, for print, for a colleague.

    Parameters
    ----------
    fits : Fit, Study or sequence of them
        Several stand side by side. Of a fit that was loaded without its model the page shows what the file holds, and
        says what it cannot draw.
    path : str or Path
        An existing file is replaced once the new one is complete.
    comparison : Comparison, optional
        With held-out results: ``gb.compare(a, b, records=flight)``. By default up to six fits are compared on their own
        data.
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
        raise TypeError(f"cannot report {wrong[0]!r:.80}: give fits, such as gb.fit(problem) returns, or a study.")
    if comparison is not None and not isinstance(comparison, Comparison):
        raise TypeError(f"comparison is {comparison!r:.80}: give what gb.compare returns.")
    alone = [thing for thing in given if isinstance(thing, Fit)]
    labels = iter(labels_of(alone))
    entries: list[Entry] = []
    for thing in given:
        entries += [Entry(next(labels), thing)] if isinstance(thing, Fit) else study_entries(thing)
    write_page(entries, Path(path), comparison, title)


def write_page(entries: Sequence[Entry], path: Path, comparison: Comparison | None = None, title: str = "") -> None:
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
        f"{counted(len(entries), 'result')} side by side" if more else first.fit.name if first.fit else first.label
    )
    with np.errstate(all="ignore"):  # files come from anyone: what is not finite is not drawn
        text = page(entries, comparison, title or by_default)
    write_text(path, text)


def study_entries(study: Study) -> list[Entry]:
    """Return the members of a study; those that have no fit with the reason."""
    entries = []
    for member in study.members:
        fit, error = None, member.error or "unfinished"
        if member.status == "done":
            fit, error = member.fit, ""
        entries.append(Entry(member.name, fit, str(member.folder), error))
    return entries
