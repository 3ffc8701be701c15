"""Tables of measured signals as text: a header line, a time column, and numeric columns."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from greybox.data.dates import seconds_in_texts
from greybox.data.files.arrays import Array
from greybox.data.files.control_characters import printable
from greybox.data.files.decimal_marks import has_decimal_comma, is_like_number, number_in
from greybox.data.files.delimited_text import MISSING, DelimitedText, read_delimited
from greybox.data.files.grouping import unique
from greybox.data.files.progress import bar
from greybox.data.files.wording import counted, some
from greybox.data.headings import Heading, find_column, headings, with_units_in_header
from greybox.data.logs.readers.betaflight import completed, with_units, without_settings
from greybox.data.logs.readers.messages import MessageNames
from greybox.data.logs.readers.named_arrays import recording
from greybox.data.logs.readers.table_columns import MOST_DEVICES
from greybox.data.record import Recording
from greybox.data.time_column import clock_names, is_clock_name, seconds, stands_still

Rows = Sequence[tuple[int, Sequence[str]]]  # numbers of lines and their cells


def read(
    path: Path,
    messages: MessageNames = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read a table with a header line into one record named after the file.

    The cells are separated by semicolons, tabs, commas or blanks; the numbers may have decimal
    commas, see `greybox.data.files.delimited_text`. Units, and how signals vary between their
    samples, are in the header, see `greybox.data.headings`, or in a line of their own below it.
    Lines that start with ``#`` or ``%`` are comments; empty cells, and words such as ``nan``, are
    missing samples. A header that is repeated is skipped.

    The time column is that of `greybox.data.time_column`; it may have dates such as
    ``2026-05-01T10:00:00.25`` or times of day. The rows of a table without a time column have no
    order in time, see `Record`.

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
        One record, or one for each device whose rows come in turn. The findings name columns
        without numbers, which are left out, lines with fewer cells than the header, which are
        skipped, and cells with text or infinite values, which are missing samples.

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

    _require_numbers(text)
    if not (text.has_header or stated):
        line = text.lines[0][:60]
        raise ValueError(
            f"{path} has no header line: its first line, {line!r}, must name the columns. Or give "
            "numbers for names, columns=... with time=1 u=2 theta=3:deg."
        )

    named = with_units(headings(text.header))
    used = _used(named, stated or {})
    columns, units_of_texts, findings = _columns(named, text, used)
    for name in used - columns.keys() if stated else ():
        raise ValueError(f"{path} has no numbers in the column {name!r}: name another one.")
    units = {h.name: h.unit for h in named} | units_of_texts
    clock = ("time",) if "time" in (stated or ()) else clock_names(columns, units)
    if clock and rate:
        raise ValueError(f"{path} has a time column: leave out the rate, which follows from it.")
    # As rows without a time, the samples would count as independent.
    unread = [h for h in named if is_clock_name(h.base) and not (clock and h.name in columns)]
    if unread and not (rate or any(map(is_clock_name, clock))):
        values = columns.get(unread[0].name)
        fault = "which is not a time in numbers with a known unit"
        if values is not None and stands_still(values):
            fault = "which stands still"
        raise ValueError(
            f"{path} has the column '{unread[0]}', {fault}: give it in seconds as 'time [s]', "
            "state the rate, rate=HZ, or give it another name if it is not a time."
        )

    groups = {path.stem: (columns, units)}
    # Rows without a time are for static models.
    log = recording(path, groups, findings, stated=stated, rate=rate, rows_allowed=True)
    # A table of one device is one record, and its findings are those of the file.
    if len(log) == 1:
        log = replace(log, records={n: replace(r, findings=log.findings) for n, r in log.items()})
    tables = {name: completed(record, settings) for name, record in log.items()}
    findings = unique([*log.findings, *(text for r in tables.values() for text in r.findings)])
    about = {"parameters": settings} if settings else {}
    return replace(log, records=tables, metadata=about, findings=findings)


def _require_numbers(text: DelimitedText) -> None:
    """Raise ValueError if no cell of the table is a number, and say how its rows look."""
    lines = text.lines[:: max(len(text.lines) // 9, 1)]
    cells = [cell.strip(' "') for line in lines for cell in line.split(text.separator)]
    if any(map(is_like_number, cells)):
        return
    line = text.lines[len(text.lines) // 2].strip()[:60]
    raise ValueError(
        f"{text.path} has no column of numbers, as in {line!r}: leave only numbers in the cells, "
        "with names and units in the line above, as in time [s], u [N]."
    )


def _used(named: Sequence[Heading], stated: Mapping[str, str]) -> set[str]:
    """Return the names of the columns that the user names, of all columns without a statement."""
    used = set() if stated else {h.name for h in named}
    for column in stated.values():
        # A column that does not exist is refused where columns are renamed.
        with suppress(ValueError):
            used.add(named[find_column(column, named).place].name)
    return used


def _columns(
    named: Sequence[Heading], text: DelimitedText, used: Collection[str]
) -> tuple[dict[str, Array], dict[str, str], list[str]]:
    """Return the columns of numbers and times, the units of times that are texts, and findings.

    Those that are used, and clocks, decide the decimal mark.
    """
    try:
        lines = bar(text.lines, desc=f"reading {printable(text.path.name)}", unit="line")
        # The usual table has plain numbers, which numpy reads ten times as fast as cell by cell.
        clean = np.loadtxt(lines, delimiter=text.separator, comments=None, ndmin=2)
    except ValueError:
        clean = np.empty((0, 0))
    if clean.shape[1] == len(named) and not np.isinf(clean).any():
        return {h.name: clean[:, i] for i, h in enumerate(named) if h.name}, {}, []

    rows, findings = _complete_rows(text, named)
    places = {h.name: k for k, h in enumerate(named) if h.name}
    # Texts decide nothing about numbers.
    numeric = {name: k for name, k in places.items() if _is_of_numbers(rows, k)}
    _require_one_header(text, rows, [*numeric.values()])
    # One decision for the whole table: a column of integers shows no decimal mark.
    decisive = [k for name, k in numeric.items() if name in used or seconds(name)]
    cells = ((number, [row[k] for k in decisive]) for number, row in rows)
    comma = has_decimal_comma(text.path, cells)

    columns = {}
    units = {}
    odd_cells = []
    not_numeric = []
    for name, k in places.items():
        if name in numeric:
            columns[name], odd = _numbers(rows, k, comma)
            odd_cells += [f"{name} ({odd})"] if odd else []
            continue
        dates = seconds_in_texts([row[k] for _, row in rows])
        if dates:
            columns[name], units[name] = dates
        else:
            not_numeric.append(name)
    _require_one_signal_a_column(text, named, rows, [places[name] for name in not_numeric])
    if odd_cells:
        findings.append(
            f"cells that are not finite numbers, which count as missing: {some(odd_cells, 12)}."
        )
    if not_numeric:
        findings.append(f"columns without numbers were left out: {some(not_numeric, 12)}.")

    return columns, units, findings


def _numbers(rows: Rows, place: int, comma: bool) -> tuple[Array, str]:
    """Return the values (n,) of a column, and its damaged cells in words."""
    cells = [row[place] for _, row in rows]
    values = np.array([number_in(cell, comma) for cell in cells])
    values[np.isinf(values)] = np.nan
    missing = np.flatnonzero(np.isnan(values)).tolist()
    odd = [j for j in missing if cells[j].lower() not in MISSING]
    if not odd:
        return values, ""
    first = f"the first {cells[odd[0]][:30]!r} in line {rows[odd[0]][0]}"
    return values, f"{counted(len(odd), 'cell')}, {first}"


def _complete_rows(text: DelimitedText, named: Sequence[Heading]) -> tuple[Rows, list[str]]:
    """Return the numbered rows that have all cells and are no headers, and findings."""
    header = {*text.header, *(h.name for h in named), *(h.unit for h in named)}
    complete = []
    short = []
    repeated = []
    for number, row in text.rows():
        names = [cell for cell in row if cell.lower() not in MISSING]
        # Units in a line of their own may have brackets.
        names = [name if name in header else name.strip("[](){} ") for name in names]
        if len(row) < len(named):
            short.append(number)
        elif len(names) > 1 and header.issuperset(names):
            repeated.append(number)
        else:
            complete.append((number, row))

    findings = []
    if repeated:
        findings.append(
            f"the header is repeated in {counted(len(repeated), 'line')}, the first is line "
            f"{repeated[0]}: all rows were read as one table."
        )
    if short:
        findings.append(
            f"{len(short)} of {len(short) + len(complete)} lines have fewer cells than the header "
            f"and were skipped; the first is line {short[0]}."
        )
    return complete, findings


def _require_one_header(text: DelimitedText, rows: Rows, numeric: Sequence[int]) -> None:
    """Raise ValueError if a row has other names than the header above its numbers."""
    for number, row in rows if len(numeric) > 1 else ():
        if is_like_number(row[numeric[0]]):
            continue
        names = {row[k] for k in numeric}
        if len(names) == len(numeric) and not any(map(is_like_number, names)):
            raise text.second_header(number)


def _require_one_signal_a_column(
    text: DelimitedText, named: Sequence[Heading], rows: Rows, texts: Sequence[int]
) -> None:
    """Raise ValueError if a text names the signal, or the device, that each row is of.

    Its rows have a time that is repeated for each of the names.
    """
    clocks = [k for k, h in enumerate(named) if seconds(h.base)]
    for place, clock in product(texts, clocks):
        names = {row[place] for _, row in rows}
        times = {row[clock] for _, row in rows}
        pairs = {(row[clock], row[place]) for _, row in rows}
        if 2 <= len(names) <= MOST_DEVICES and 1.5 * len(times) < len(pairs) == len(rows):
            raise ValueError(
                f"{text.path} has rows of {some(sorted(names))} at each time, by its column "
                f"{text.header[place]!r}: give each a column of its own, as pandas.DataFrame.pivot "
                "does, or a file of its own."
            )


def _is_of_numbers(rows: Rows, place: int) -> bool:
    """Return whether a column has numbers, or words for missing ones, up to some damaged cells."""
    cells = [row[place] for _, row in rows if row[place]]
    present = [cell for cell in cells if cell.lower() not in MISSING]
    return bool(cells) and 2 * sum(map(is_like_number, present)) >= len(present)
