"""ArduPilot DataFlash logs as text (.log): one message per line, ``ATT, 42079828, 0.01, ...``, and FMT lines."""

import hashlib
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT

from greybox.data.record import Recording
from greybox.files.arrays import Array, IntArray
from greybox.files.text_table import is_number
from greybox.logs.readers import ardupilot_metadata
from greybox.logs.readers.dataflash import ALWAYS, CLOCKS, TABLES, clock_column, recording
from greybox.logs.readers.dataflash_index import Layout
from greybox.logs.readers.dataflash_units import Units, UnitTables
from greybox.logs.readers.messages import Messages, bare, on_one_clock
from greybox.logs.readers.time_stamps import increasing

FMT_FIELDS = 5  # type, length, name, format, columns
TEXTS = "anNZM"  # letters of text; a mode, M, is a name or a number
BATCH = 1000  # lines of a message that are text at a time, a megabyte as fields

Column = Any  # an array of numbers, or a list of text


class Lines:
    """The lines of a log by message name: the columns of those that are wanted, of the others the times.

    Attributes
    ----------
    layouts : dict of str to Layout
        By message name, as FMT lines describe them.
    each : dict of str to _Columns
    banner : str
        The line in which an old log names its firmware; empty if there is none.
    """

    def __init__(self, lines: Iterable[str], wanted: Collection[str] | None) -> None:
        self.layouts: dict[str, Layout] = {}
        self.each: dict[str, _Columns] = {}
        self.banner = ""
        for number, line in enumerate(lines):
            name, comma, body = line.partition(",")
            if not comma:
                self.banner = self.banner or (
                    line.strip() if ardupilot_metadata.vehicle_in(line) else ""
                )
                continue
            if name == "FMT":
                self._define(body)
            columns = self.each.get(name)
            if columns is None:
                columns = self.each[name] = _Columns(wanted is None or name in wanted)
            columns.take(number, body, self.layouts.get(name))

    def _define(self, body: str) -> None:
        fields = [field.strip() for field in body.split(",", FMT_FIELDS - 1)]
        if (
            len(fields) < FMT_FIELDS
            or not fields[0].isdecimal()
            or any(c not in FORMAT_TO_STRUCT for c in fields[3])
        ):
            return
        columns = tuple(column.strip() for column in fields[4].split(",") if column.strip())
        if len(columns) == len(fields[3]) == len(set(columns)) and fields[2] != "FMT":
            self.layouts[fields[2]] = Layout(int(fields[0]), fields[2], 0, fields[3], columns)


class _Columns:
    """The columns of all lines of one name, numbers from batch to batch, so that little of the log is text at a time.

    Of those that are not wanted as a `whole` the times are kept alone.
    """

    def __init__(self, whole: bool) -> None:
        self.count = 0
        self._whole = whole
        self._numbers: list[int] = []
        self._bodies: list[str] = []
        self._batches: list[tuple[Layout, IntArray, dict[str, Column]]] = []

    def take(self, number: int, body: str, layout: Layout | None) -> None:
        """Keep a line."""
        self.count += 1
        self._numbers.append(number)
        self._bodies.append(body)
        if len(self._bodies) >= BATCH and layout is not None:
            self._convert(layout)

    def _convert(self, layout: Layout) -> None:
        commas, timer = len(layout.columns) - 1, clock_column(layout)
        kept = layout.columns if self._whole else (timer,) if timer else ()
        splits = max((layout.columns.index(name) + 1 for name in kept), default=0)
        sound = [i for i, body in enumerate(self._bodies) if body.count(",") >= commas]
        split = [self._bodies[i].split(",", min(splits, commas)) for i in sound]
        columns: dict[str, Column] = {}
        for i, (letter, name) in enumerate(zip(layout.format, layout.columns, strict=True)):
            if name in kept:
                values = [fields[i].strip() for fields in split]
                columns[name] = values if letter in TEXTS and name != timer else _numbers(values)
        self._batches.append((layout, np.array(self._numbers, dtype=np.int64)[sound], columns))
        self._numbers, self._bodies = [], []

    def messages(self, layout: Layout, units: Units, damaged: dict[str, int]) -> Messages:
        """Return the messages; lines with too few fields, or of another layout, are counted as damaged."""
        self._convert(layout)
        batches = [(order, columns) for own, order, columns in self._batches if own == layout]
        order = np.concatenate([order for order, _ in batches])
        timer = clock_column(layout)
        time, numbers, texts = None, {}, {}
        for letter, name in zip(layout.format, layout.columns, strict=True):
            parts = [columns[name] for _, columns in batches if name in columns]
            if name == timer:
                time = np.concatenate(parts) / CLOCKS.get(name, 1e3)
            elif parts and letter in TEXTS:
                values = [*chain.from_iterable(parts)]
                if letter == "M" and values and is_number(values[0]):
                    numbers[name] = _numbers(values)
                else:
                    texts[name] = values
            elif parts:
                numbers[name] = np.concatenate(parts)
        if order.size < self.count:
            damaged[layout.name] = self.count - order.size
        return Messages(
            layout.name,
            order,
            time,
            numbers,
            texts,
            units.columns,
            units.instance if self._whole else "",
        )


def read(path: str | Path, messages: Collection[str] | None = None) -> Recording:
    """Read a DataFlash text log.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Types to read, e.g. ``("ATT", "RATE")``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Times in s since the vehicle's start; values as written, units from the log's own tables.

    Raises
    ------
    ValueError
        If the file holds no message that can be read.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    messages = bare(messages)
    with path.open("rb") as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = Lines(file, None if messages is None else {*messages, *ALWAYS, *TABLES})
    damaged: dict[str, int] = {}

    def messages_of(name: str, units: Units) -> Messages:
        return lines.each[name].messages(lines.layouts[name], units, damaged)

    known = [name for name in lines.layouts if name in lines.each]
    tables = UnitTables(messages_of(name, Units({}, "")) for name in TABLES if name in known)
    groups = [
        messages_of(name, tables.of(lines.layouts[name])) for name in known if name not in TABLES
    ]
    unknown = sum(
        one.count for name, one in lines.each.items() if name not in lines.layouts and name != "FMT"
    )
    groups, interpolated = _with_times(groups)
    findings = [*_damage(damaged, unknown), *tables.findings, *interpolated]
    return recording(on_one_clock(groups + _banner(lines)), path, checksum, messages, findings)


def _with_times(groups: list[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Give the messages of a log of before 2014 times, where only GPS has them: by the lines between its messages."""
    timed = [group for group in groups if group.time is not None and len(group) > 1]
    if not timed or any(group.name not in ("GPS", "GPS2") for group in timed):
        return groups, ()
    clock = max(timed, key=len)
    assert clock.time is not None
    rows = increasing(clock.time)
    if rows.size < 2:
        return groups, ()
    order, time = clock.order[rows], clock.time[rows]
    made = [
        group
        if group.time is not None
        else replace(group, time=np.interp(group.order, order, time, np.nan, np.nan))
        for group in groups
    ]
    interval = float(np.median(np.diff(time)))
    return made, (
        f"only {clock.name} has times, every {interval:.2g} s: those of the other messages lie between by their lines, "
        "and may be off by as much; do not identify what is faster from this log.",
    )


def _numbers(values: Sequence[str]) -> Array:
    """Convert a column, NaN where it is not a number."""
    try:
        return np.array(values, dtype=float)
    except ValueError:
        return np.array([float(value) if is_number(value) else np.nan for value in values])


def _banner(lines: Lines) -> list[Messages]:
    """Return the line in which an old log names its firmware, as a text message."""
    if not lines.banner or "MSG" in lines.each:
        return []
    return [Messages("MSG", np.zeros(1, dtype=np.int64), None, {}, {"Message": [lines.banner]})]


def _damage(damaged: dict[str, int], unknown: int) -> list[str]:
    findings = [f"{name}: {count} damaged lines were skipped." for name, count in damaged.items()]
    if unknown:
        findings.append(
            f"{unknown} lines are damaged, or have no FMT line that describes them, and were skipped."
        )
    return findings
