"""A page about one or several fits, to look at and to share."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from greybox.estimate.result import Fit
from greybox.experiment.margins import Margins
from greybox.files.arrays import Strings
from greybox.files.grouping import grouped
from greybox.files.safe_files import write_text
from greybox.files.text_table import counted, number
from greybox.html_report.entry import Entry
from greybox.html_report.page import page
from greybox.study.store import StudyMember
from greybox.study.study import Study
from greybox.validation.comparison import Comparison
from greybox.validation.same_data import labels_of

DETAILED = 12  # members of a study whose fits are loaded and shown: as many as one looks through


def report(
    fits: Fit | Study | Sequence[Fit | Study],
    path: str | Path,
    *,
    comparison: Comparison | None = None,
    margins: Margins | Sequence[Margins] = (),
    title: str = "",
    author: str = "",
) -> None:
    """Write a page about fits: one HTML file for a browser, for print, or for a colleague.

    Parameters
    ----------
    fits : Fit, Study or sequence of them
        Several are shown side by side; of a study, the first twelve members in detail. For a fit
        that was loaded without its model the page shows the contents of the file, and says what it
        cannot draw.
    path : str or Path
        An existing file is replaced once the new one is complete.
    comparison : Comparison, optional
        With held-out results: ``gb.compare(a, b, records=flight)``. By default up to six fits are
        compared on their own data.
    margins : Margins or sequence of them
        Margins of loops of these fits, shown with their figures.
    title : str
        By default the name of the fit.
    author : str
        Who answers for the page; it is printed below the title, with today's date.

    Raises
    ------
    TypeError, ValueError
        For an object that is not a fit, or for no fit.
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
    results = [fits] if isinstance(fits, Fit | Study) else list(fits)
    for result in results:
        if not isinstance(result, Fit | Study):
            raise TypeError(
                f"cannot report {result!r:.80}: give fits, such as gb.fit(problem) returns, or a "
                "study."
            )

    if comparison is not None and not isinstance(comparison, Comparison):
        raise TypeError(f"comparison is {comparison!r:.80}: give what gb.compare returns.")

    # Labels of fits must differ, since links lead to them; members of a study have unique names.
    labels = iter(labels_of([result for result in results if isinstance(result, Fit)]))
    entries: list[Entry] = []
    for result in results:
        entries += [Entry(next(labels), result)] if isinstance(result, Fit) else members_of(result)
    if not entries:
        raise ValueError("there is nothing to report: give at least one fit.")

    default = f"{counted(len(entries), 'result')} side by side"
    if len(entries) == 1:
        default = entries[0].answer.get("problem", entries[0].label)
    # A file from a stranger may contain any numbers, and warnings about them help nobody.
    with np.errstate(all="ignore"):
        studies = [result for result in results if isinstance(result, Study)]
        loops = [margins] if isinstance(margins, Margins) else margins
        text = page(entries, comparison, title or default, studies, loops, author)
    write_text(Path(path), text)


def members_of(study: Study) -> list[Entry]:
    """Return the members of a study, those with the same answer as one; the first with fits."""

    def seen(member: StudyMember) -> Strings:
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
