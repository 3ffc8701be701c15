"""ArduPilot DataFlash logs as text (.log): one message per line, ``ATT, 42079828, 0.01, ...``."""

import math
from array import array
from pathlib import Path

import numpy as np

from greybox.data.files.numbers_in_text import is_number
from greybox.data.logs.readers.dataflash import CLOCKS, TABLES, clock_column, is_wanted, recording
from greybox.data.logs.readers.dataflash_layout import Layout, sound_layout
from greybox.data.logs.readers.dataflash_units import Units, UnitTables
from greybox.data.logs.readers.messages import MessageNames, Messages, bare
from greybox.data.record import Recording

TEXTS = "anNZM"  # letters of text; a mode, M, is a name or a number


def _layout(body: str) -> Layout | None:
    """Return the layout that an FMT line describes, None if the line is damaged."""
    fields = [field.strip() for field in body.split(",", 4)]
    if len(fields) < 5 or not fields[0].isdecimal():
        return None
    kind, _, name, letters, names = fields
    columns = tuple(column.strip() for column in names.split(",") if column.strip())
    return sound_layout(int(kind), name, None, letters, columns)


class _MessageLines:
    """The columns of all lines of one name, converted line by line; or their times alone."""

    def __init__(self, layout: Layout, is_stored: bool) -> None:
        self.layout = layout
        self.damaged = 0
        self.timer = clock_column(layout)
        self.order = array("q")
        self.letters = dict(zip(layout.columns, layout.format, strict=True))
        self.columns: dict[str, array[float] | list[str]] = {
            name: [] if letter in TEXTS and name != self.timer else array("d")
            for name, letter in self.letters.items()
            if is_stored or name == self.timer
        }

    def append(self, number: int, body: str) -> None:
        """Append a line; lines with too few or too many fields are damaged."""
        # The last field may be a text with commas.
        fields = body.split(",", len(self.letters) - 1)
        is_text = self.layout.format.endswith(tuple(TEXTS))
        if len(fields) < len(self.letters) or ("," in fields[-1] and not is_text):
            self.damaged += 1
            return
        self.order.append(number)
        for name, field in zip(self.letters, fields, strict=True):
            column = self.columns.get(name)
            if isinstance(column, array):
                column.append(_number(field))
            elif column is not None:
                column.append(field.strip())

    def messages(self, units: Units) -> Messages:
        """Return the messages."""
        numbers = {}
        texts = {}
        for name, column in self.columns.items():
            if isinstance(column, array):
                numbers[name] = np.asarray(column)
            # Modes are names in some firmware and numbers in other.
            elif self.letters[name] == "M" and column and is_number(column[0]):
                numbers[name] = np.array([*map(_number, column)])
            else:
                texts[name] = column
        time = numbers.pop(self.timer, None)
        if time is not None:
            time = time / CLOCKS.get(self.timer, 1e3)
        return Messages(self.layout.name, np.asarray(self.order), time, numbers, texts, *units)


def read(path: Path, messages: MessageNames = None) -> Recording:
    """Read a DataFlash text log.

    Parameters
    ----------
    path : Path
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
    messages = bare(messages)
    current: dict[str, _MessageLines] = {}  # by the latest FMT line of each name
    by_layout: dict[tuple[object, ...], _MessageLines] = {}
    unknown = 0
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(file):
            name, comma, body = line.partition(",")
            if name == "FMT":
                if layout := _layout(body):
                    is_stored = is_wanted(layout.name, messages)
                    key = (layout.name, layout.format, layout.columns)
                    group = by_layout.setdefault(key, _MessageLines(layout, is_stored))
                    current[layout.name] = group
            elif name in current:
                current[name].append(number, body)
            else:
                unknown += bool(comma)

    # The log may describe one name in two ways: the one with most lines is read.
    lines: dict[str, _MessageLines] = {}
    for group in by_layout.values():
        other = lines.setdefault(group.layout.name, group)
        if len(group.order) > len(other.order):
            lines[group.layout.name] = group
    lost = [
        f"{group.layout.name}: {len(group.order)} lines with another layout than the rest were "
        "left out."
        for group in by_layout.values()
        if group.order and lines[group.layout.name] is not group
    ]

    tables = UnitTables(lines[name].messages(Units({}, "")) for name in TABLES if name in lines)
    groups = [
        group.messages(tables.of(group.layout))
        for name, group in lines.items()
        if name not in TABLES and group.order
    ]
    findings = [
        f"{group.layout.name}: {group.damaged} damaged lines were skipped."
        for group in by_layout.values()
        if group.damaged
    ]
    findings += lost
    if unknown:
        findings.append(
            f"{unknown} lines are damaged, or have no FMT line that describes them, and were "
            "skipped."
        )
    return recording(groups, path, messages, (*findings, *tables.findings))


def _number(field: str) -> float:
    try:
        return float(field)
    except ValueError:
        return math.nan
