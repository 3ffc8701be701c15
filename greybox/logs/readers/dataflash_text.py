"""ArduPilot DataFlash logs as text (.log): one message per line, ``ATT, 42079828, 0.01, ...``, and FMT lines."""

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import FORMAT_TO_STRUCT

from greybox.data.record import Recording
from greybox.data.text_table import is_number
from greybox.logs.readers import ardupilot_metadata
from greybox.logs.readers.dataflash import CLOCKS, TABLES, clock_column, recording
from greybox.logs.readers.dataflash_index import Layout
from greybox.logs.readers.dataflash_units import Units, UnitTables
from greybox.logs.readers.messages import Messages, bare, on_one_clock
from greybox.logs.readers.time_stamps import increasing

FMT_FIELDS = 5  # type, length, name, format, columns


class Lines:
    """The lines of a log by message name, with their numbers, and the layouts that FMT lines describe."""

    def __init__(self, text: str) -> None:
        self.layouts: dict[str, Layout] = {}
        self.numbers: dict[str, list[int]] = {}
        self.bodies: dict[str, list[str]] = {}
        self.other: list[str] = []
        for number, line in enumerate(text.split("\n")):
            name, comma, body = line.partition(",")
            if not comma:
                self.other += [line.strip()] if line.strip() else []
                continue
            if name == "FMT":
                self._define(body)
            self.numbers.setdefault(name, []).append(number)
            self.bodies.setdefault(name, []).append(body)

    def _define(self, body: str) -> None:
        fields = [field.strip() for field in body.split(",", FMT_FIELDS - 1)]
        if len(fields) < FMT_FIELDS or not fields[0].isdecimal() or any(c not in FORMAT_TO_STRUCT for c in fields[3]):
            return
        columns = tuple(column.strip() for column in fields[4].split(",") if column.strip())
        if len(columns) == len(fields[3]) == len(set(columns)) and fields[2] != "FMT":
            self.layouts[fields[2]] = Layout(int(fields[0]), fields[2], 0, fields[3], columns)


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
    raw = path.read_bytes()
    lines = Lines(raw.decode("utf-8-sig", "replace").replace("\r", "\n"))
    damaged: dict[str, int] = {}
    tables = UnitTables(_messages(lines, name, Units({}, ""), damaged) for name in TABLES if name in lines.layouts)
    groups = [
        _messages(lines, name, tables.of(layout), damaged)
        for name, layout in lines.layouts.items()
        if name not in TABLES and name in lines.bodies
    ]
    unknown = sum(len(bodies) for name, bodies in lines.bodies.items() if name not in lines.layouts and name != "FMT")
    groups, interpolated = _with_times(groups)
    findings = [*_damage(damaged, unknown), *tables.findings, *interpolated]
    return recording(on_one_clock(groups + _banner(lines)), path, hashlib.sha256(raw).hexdigest(), messages, findings)


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
        group if group.time is not None else replace(group, time=np.interp(group.order, order, time, np.nan, np.nan))
        for group in groups
    ]
    interval = float(np.median(np.diff(time)))
    return made, (
        f"only {clock.name} has times, every {interval:.2g} s: those of the other messages lie between by their lines, "
        "and may be off by as much; do not identify what is faster from this log.",
    )


def _messages(lines: Lines, name: str, units: Units, damaged: dict[str, int]) -> Messages:
    """Return the messages of one name; lines with too few fields, or no time, are counted as damaged."""
    layout = lines.layouts[name]
    bodies = lines.bodies.get(name, [])
    width = len(layout.columns)
    split = [[field.strip() for field in body.split(",", width - 1)] for body in bodies]
    sound = [i for i, fields in enumerate(split) if len(fields) == width]
    fields = dict(zip(layout.columns, zip(*(split[i] for i in sound), strict=True), strict=True)) if sound else {}

    timer = clock_column(layout)
    time = None
    columns = {}
    texts = {}
    for letter, column in zip(layout.format, layout.columns, strict=True):
        values = fields.get(column, ())
        if column == timer:
            time = _numbers(values) / CLOCKS.get(column, 1e3)
        elif letter in "anNZ" or (letter == "M" and values and not is_number(values[0])):
            texts[column] = values
        else:
            columns[column] = _numbers(values)

    if len(sound) < len(split):
        damaged[name] = len(split) - len(sound)
    order = np.array([lines.numbers[name][i] for i in sound], dtype=np.int64)
    return Messages(name, order, time, columns, texts, units.columns, units.instance)


def _numbers(values: Sequence[str]) -> NDArray[np.float64]:
    """Convert a column, NaN where it is not a number."""
    try:
        return np.array(values, dtype=float)
    except ValueError:
        return np.array([float(value) if is_number(value) else np.nan for value in values])


def _banner(lines: Lines) -> list[Messages]:
    """Return the line in which an old log names its firmware, as a text message."""
    said = [line for line in lines.other if ardupilot_metadata.vehicle_in(line)][:1]
    if not said or "MSG" in lines.bodies:
        return []
    return [Messages("MSG", np.zeros(1, dtype=np.int64), None, {}, {"Message": said})]


def _damage(damaged: dict[str, int], unknown: int) -> list[str]:
    findings = [f"{name}: {count} damaged lines were skipped." for name, count in damaged.items()]
    if unknown:
        findings.append(f"{unknown} lines are damaged, or have no FMT line that describes them, and were skipped.")
    return findings
