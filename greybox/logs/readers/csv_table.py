"""Tables of measured signals as text: a header line, a time column, numeric columns; comma, semicolon or tab."""

import csv
import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Recording
from greybox.data.text_table import is_number
from greybox.logs.readers.messages import on_one_clock, records
from greybox.logs.readers.table_columns import SECONDS, Heading, heading, seconds, table


def read(path: str | Path, messages: Collection[str] | None = None) -> Recording:
    """Read a table with a header line into one record named after the file.

    The separator is the first of ``;``, tab and comma that the header contains; with ``;`` or tab the numbers
    may have a decimal comma. Units stand in the header: ``pitch [deg]`` or ``pitch (deg)``. So does
    how a signal runs between its samples, where that is known: ``u [1 held]`` for the output of a controller, which
    holds it, and ``pitch [deg sampled]`` for samples of what is continuous. Lines that start with
    ``#`` are comments; empty cells, and words such as ``nan``, are missing samples.

    The time column is the first named time, t or timestamp (any case, with a unit in brackets or as in ``time_s``,
    ``time_ms``), or TimeUS, TimeMS as ArduPilot's tools write it; without a unit it is in seconds. Where there is none,
    the first column serves if it increases and has the unit of a time.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Not used: a table is one record, and all of it is read.

    Returns
    -------
    Recording
        One record; columns that are not numeric are left out, and the findings say so.

    Raises
    ------
    ValueError
        If there is no header, no time column, or no numeric column.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    raw = path.read_bytes()
    checksum = hashlib.sha256(raw).hexdigest()
    lines = [line for line in _decode(raw).splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise ValueError(f"{path} has no table: write a header line with names, then one line of numbers per sample.")

    separator = next((s for s in ";\t" if s in lines[0]), ",")
    headings = _headings(next(_rows(lines[:1], separator, path), []), lines[0], path)
    columns, not_numeric, wrong_length = _columns(headings, lines[1:], separator, path)
    units = {h.name: h.unit for h in headings}
    group, left_out = table(path.stem, _time_first(headings, columns, path), units)
    groups, restarts = on_one_clock([group] if group else [])
    found, problems = records(groups, path.name, checksum)
    if not found:
        raise ValueError(f"{path} has no numeric column beside the time: it needs one for each signal.")

    findings = []
    if wrong_length:
        findings.append(f"{wrong_length} of {len(lines) - 1} lines do not have as many cells as the header: skipped.")
    findings += left_out
    if not_numeric:
        findings.append(f"columns without numbers were left out: {', '.join(not_numeric)}.")
    return Recording(found, path.name, checksum, {}, (*findings, *restarts, *problems))


def _decode(raw: bytes) -> str:
    for encoding in ("utf-8-sig", "cp1252"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    return raw.decode("utf-8", "replace")


def _headings(cells: Sequence[str], line: str, path: Path) -> list[Heading]:
    headings = [heading(cell) for cell in cells]
    names = [h.name for h in headings if h.name]
    if not names or all(is_number(name) for name in names):
        raise ValueError(f"{path} has no header line: its first line, {line[:60]!r}, must name the columns.")
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"{path} has two columns named {twice[0]!r}: give each column a name of its own.")
    return headings


def _columns(
    headings: Sequence[Heading], lines: Sequence[str], separator: str, path: Path
) -> tuple[dict[str, NDArray[np.float64]], list[str], int]:
    """Return the numeric columns by name, the names of other non-empty ones, and how many lines have a wrong length."""
    try:
        clean = np.loadtxt(lines, delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        clean = np.empty((0, 0))
    if clean.shape[1] == len(headings):
        return {h.name: clean[:, i] for i, h in enumerate(headings) if h.name}, [], 0

    cells, wrong_length = _cells(_rows(lines, separator, path), len(headings))
    columns = {}
    not_numeric = []
    for (name, _), column in zip(headings, cells, strict=True):
        values = _numbers(column, separator)
        if name and values is not None:
            columns[name] = values
        elif name and any(cell.strip() for cell in column):
            not_numeric.append(name)
    return columns, not_numeric, wrong_length


def _rows(lines: Sequence[str], separator: str, path: Path) -> Iterator[list[str]]:
    try:
        yield from csv.reader(lines, delimiter=separator, skipinitialspace=True)
    except csv.Error as problem:
        raise ValueError(f"{path} is not a table of numbers ({problem}): save it as plain CSV.") from None


def _cells(rows: Iterable[list[str]], width: int) -> tuple[list[list[str]], int]:
    """Return the cells column by column, and how many lines have a wrong number of them."""
    columns: list[list[str]] = [[] for _ in range(width)]
    wrong_length = 0
    for cells in rows:
        if len(cells) == width + 1 and not cells[-1].strip():
            cells.pop()  # a separator at the end of every line
        if len(cells) == width:
            for column, cell in zip(columns, cells, strict=True):
                column.append(cell)
        else:
            wrong_length += 1
    return columns, wrong_length


def _numbers(cells: Sequence[str], separator: str) -> NDArray[np.float64] | None:
    """Convert a column; NaN for empty cells; None for a column that is not numeric."""
    try:
        return np.array(cells, dtype=float)
    except ValueError:
        cleaned = [cell.strip() for cell in cells]
    if separator != ",":
        cleaned = [cell.replace(",", ".") for cell in cleaned]
    filled = [cell for cell in cleaned if cell]
    numeric = sum(map(is_number, filled))
    if not filled or numeric < len(filled) / 2:  # some damaged cells do not make a column text
        return None
    return np.array([float(cell) if is_number(cell) else np.nan for cell in cleaned])


def _time_first(
    headings: Sequence[Heading], columns: Mapping[str, NDArray[np.float64]], path: Path
) -> dict[str, NDArray[np.float64]]:
    """Return the columns; where none is named as a time, the first serves if it increases and has a unit of time."""
    if any(seconds(h.name, h.unit) and h.name in columns for h in headings):
        return dict(columns)
    name, unit = headings[0]
    if name in columns and unit.lower() in SECONDS and np.all(np.diff(columns[name]) > 0):
        others = {key: values for key, values in columns.items() if key not in (name, "time")}
        return {"time": columns[name] * SECONDS[unit.lower()], **others}
    names = ", ".join(repr(h.name) for h in islice(headings, 12))
    raise ValueError(f"{path} has no time column among {names}: name it 'time [s]', or time, t, time_s, TimeUS.")
