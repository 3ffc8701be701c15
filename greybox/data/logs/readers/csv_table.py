"""Tables of measured signals as text: a header line, a time column, and numeric columns."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.column_headings import Heading, heading
from greybox.data.files.control_characters import printable
from greybox.data.files.decimal_marks import are_numbers, has_decimal_comma, number_in
from greybox.data.files.delimited_text import MISSING, DelimitedText, numbered, read_delimited
from greybox.data.files.progress import bar
from greybox.data.files.wording import counted, some
from greybox.data.logs.readers.betaflight import completed, with_units, without_settings
from greybox.data.logs.readers.messages import MessageNames
from greybox.data.logs.readers.named_arrays import recording
from greybox.data.logs.readers.table_columns import time_column
from greybox.data.record import Recording
from greybox.data.response_columns import find_column
from greybox.data.time_column import TIMES, seconds
from greybox.data.units import with_units_in_header


def read(
    path: Path,
    messages: MessageNames = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read a table with a header line into one record named after the file.

    The cells are separated by semicolons, tabs, commas or blanks; the numbers may have decimal
    commas, see `greybox.data.files.delimited_text`. Units are in the header, ``pitch [deg]`` or
    ``pitch (deg)``, or in a line of their own below it. So is how a signal varies between its
    samples, if it is known: ``u [1 held]`` for the output of a controller, which holds it, and
    ``pitch [deg sampled]`` for samples of a continuous signal. Lines that start with ``#`` or ``%``
    are comments; empty cells, and words such as ``nan``, are missing samples.

    The time column is the first named time, t or timestamp (any case, with a unit in brackets or as
    in ``time_s``, ``time_ms``), or TimeUS, TimeMS as the tools of ArduPilot write it; for times
    without a unit see `greybox.data.time_column`. It may have dates such as
    ``2026-05-01T10:00:00.25``. Otherwise it is the first column, if this increases and has a unit
    of time. The rows of a table without a time column have no order in time, see `Record`.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Not used: a table is one record, and all of it is read.
    stated : mapping of str to str, optional
        Columns by new name, see `greybox.logs.read`. Columns of a table without a header line
        are named by their numbers, from 1.
    rate : float, Hz, optional
        The sampling rate of a table without a time.

    Returns
    -------
    Recording
        One record. The findings name columns without numbers, which are left out, lines with fewer
        cells than the header, which are skipped, and cells with text or infinite values, which are
        missing samples.

    Raises
    ------
    ValueError
        If there is no header or no numeric column; if a line has more cells than the header, or its
        decimal marks might be separators of thousands.
    OSError
        If the file cannot be opened.
    """
    raw, settings = without_settings(path.read_bytes())
    text = with_units_in_header(read_delimited(path, raw))
    if not text.lines:
        raise ValueError(
            f"{path} has no table: write a header line with names, then one line of numbers per "
            "sample."
        )

    text = numbered(text) if stated else text
    headings = with_units(_headings(text))
    columns, findings = _columns(headings, text)
    _require_numbers(path, stated or {}, [h.name for h in headings if h.name not in columns])
    units = {h.name: h.unit for h in headings}
    is_timed = time_column(columns, units) or "time" in (stated or ())
    if is_timed and rate:
        raise ValueError(f"{path} has a time column: leave out the rate, which follows from it.")
    # As rows without a time, the samples would count as independent.
    unread = next((h for h in headings if h.name.lower() in TIMES or seconds(*h)), None)
    if unread and not (is_timed or rate):
        unit = f" [{unread.unit}]" if unread.unit else ""
        raise ValueError(
            f"{path} has the column '{unread.name}{unit}', which is not a time in numbers with a "
            "known unit: give it in seconds as 'time [s]', or give it another name if it is not a "
            "time."
        )

    groups = {path.stem: (columns, units)}
    # Rows without a time are for static models.
    log = recording(path, groups, findings, stated=stated, rate=rate, rows_allowed=True)
    ((name, record),) = log.items()
    record = completed(replace(record, findings=log.findings), settings)
    about = {"parameters": settings} if settings else {}
    return replace(log, records={name: record}, metadata=about, findings=record.findings)


def _headings(text: DelimitedText) -> list[Heading]:
    headings = [heading(cell) for cell in text.header]
    names = [h.name for h in headings if h.name]
    by_number = names == [str(k) for k in range(1, len(names) + 1)]
    # A first line of numbers is data, unless these are the numbers of the columns.
    if not names or (are_numbers(" ".join(names).split()) and not by_number):
        line = text.separator.join(text.header)[:60]
        raise ValueError(
            f"{text.path} has no header line: its first line, {line!r}, must name the columns. Or "
            "give numbers for names, columns=... with time=1 u=2 theta=3:deg."
        )
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice:
        raise ValueError(
            f"{text.path} has two columns named {twice!r}: give each column a name of its own."
        )

    return headings


def _require_numbers(path: Path, stated: Mapping[str, str], without: Sequence[str]) -> None:
    """Raise ValueError if a stated column is one of those without numbers."""
    for column in stated.values():
        with suppress(ValueError):
            name = without[find_column(column, without).place]
            break
    else:
        return
    raise ValueError(f"{path} has no numbers in the column {name!r}: name another one.")


def _columns(
    headings: Sequence[Heading], text: DelimitedText
) -> tuple[dict[str, Array], list[str]]:
    """Return the numeric columns by name, and findings."""
    try:
        lines = bar(text.lines, desc=f"reading {printable(text.path.name)}", unit="line")
        # The usual table has plain numbers, which numpy reads ten times as fast as cell by cell.
        clean = np.loadtxt(lines, delimiter=text.separator, comments=None, ndmin=2)
    except ValueError:
        clean = np.empty((0, 0))
    if clean.shape[1] == len(headings) and not np.isinf(clean).any():
        return {h.name: clean[:, i] for i, h in enumerate(headings) if h.name}, []

    rows = list(text.rows())
    short = [number for number, row in rows if len(row) < len(headings)]
    complete = [(number, row) for number, row in rows if len(row) == len(headings)]
    # One decision for the whole table: a column of integers shows no decimal mark.
    comma = has_decimal_comma(text.path, complete)

    columns = {}
    not_numeric = []
    odd_cells: list[str] = []
    for k, name in [(k, h.name) for k, h in enumerate(headings) if h.name]:
        cells = [row[k] for _, row in complete]
        if not any(cells):
            not_numeric.append(name)
            continue
        values = np.array([number_in(cell, comma) for cell in cells])
        values[np.isinf(values)] = np.nan
        missing = np.flatnonzero(np.isnan(values)).tolist()
        odd = [j for j in missing if cells[j].lower() not in MISSING]
        # Some damaged cells do not make a column one of text.
        if len(odd) > sum(map(bool, cells)) / 2:
            # Dates of ISO 8601, UTC, in ns since 1970.
            dates = [cell.removesuffix("Z") for cell in cells]
            with suppress(ValueError):
                columns[name] = np.array(dates, "datetime64[ns]").astype(float)
                continue
            not_numeric.append(name)
            continue
        columns[name] = values
        if odd:
            first = f"the first {cells[odd[0]][:30]!r} in line {complete[odd[0]][0]}"
            odd_cells.append(f"{name} ({counted(len(odd), 'cell')}, {first})")

    findings = []
    if short:
        findings.append(
            f"{len(short)} of {len(rows)} lines have fewer cells than the header and were skipped; "
            f"the first is line {short[0]}."
        )
    if odd_cells:
        findings.append(
            f"cells that are not finite numbers, which count as missing: {some(odd_cells, 12)}."
        )
    if not_numeric:
        findings.append(f"columns without numbers were left out: {some(not_numeric, 12)}.")

    return columns, findings
