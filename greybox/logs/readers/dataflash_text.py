"""ArduPilot DataFlash logs as text (.log): one message per line, ``ATT, 42079828, 0.01, ...``."""

import hashlib
import math
from array import array
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np

from greybox.data.record import Recording
from greybox.files.text_table import is_number
from greybox.logs.readers import ardupilot_metadata
from greybox.logs.readers.dataflash import ALWAYS, CLOCKS, TABLES, clock_column, recording
from greybox.logs.readers.dataflash_index import Layout, sound_layout
from greybox.logs.readers.dataflash_units import Units, UnitTables
from greybox.logs.readers.messages import Messages, bare

TEXTS = "anNZM"  # letters of text; a mode, M, is a name or a number


class Lines:
    """The lines of a log by message name; of those that are not wanted, only the times.

    Attributes
    ----------
    messages : dict of str to _MessageLines
        By message name, as FMT lines describe them.
    unknown : int
        Lines without a description.
    banner : str
        The line in which an old log names its firmware, or empty.
    """

    def __init__(self, lines: Iterable[str], wanted: Collection[str] | None) -> None:
        self.messages: dict[str, _MessageLines] = {}
        self.unknown = 0
        self.banner = ""

        for number, line in enumerate(lines):
            name, comma, body = line.partition(",")
            if not comma:
                if not self.banner and ardupilot_metadata.vehicle_in(line):
                    self.banner = line.strip()
            elif name == "FMT":
                layout = _layout(body)
                if layout and layout.name not in self.messages:
                    is_wanted = wanted is None or layout.name in wanted
                    self.messages[layout.name] = _MessageLines(layout, is_wanted)
            elif name in self.messages:
                self.messages[name].append(number, body)
            else:
                self.unknown += 1


def _layout(body: str) -> Layout | None:
    """Return the layout that an FMT line describes, None if the line is damaged."""
    fields = [field.strip() for field in body.split(",", 4)]
    if len(fields) < 5 or not fields[0].isdecimal() or fields[2] == "FMT":
        return None
    kind, _, name, letters, names = fields
    columns = tuple(column.strip() for column in names.split(",") if column.strip())
    return sound_layout(int(kind), name, None, letters, columns)


class _MessageLines:
    """The columns of all lines of one name, converted line by line."""

    def __init__(self, layout: Layout, is_wanted: bool) -> None:
        self.layout = layout
        self.damaged = 0
        self._is_wanted = is_wanted
        self._timer = clock_column(layout)
        self._order = array("q")
        self._columns: dict[str, array[float] | list[str]] = {}
        self._letters = dict(zip(layout.columns, layout.format, strict=True))

        for name, letter in self._letters.items():
            if is_wanted or name == self._timer:
                is_text = letter in TEXTS and name != self._timer
                self._columns[name] = [] if is_text else array("d")

    def append(self, number: int, body: str) -> None:
        """Append a line; lines with too few fields are damaged."""
        # The last field may be a text with commas.
        fields = body.split(",", len(self.layout.columns) - 1)
        if len(fields) < len(self.layout.columns):
            self.damaged += 1
            return
        self._order.append(number)

        for name, field in zip(self.layout.columns, fields, strict=True):
            column = self._columns.get(name)
            if isinstance(column, array):
                column.append(_number(field))
            elif column is not None:
                column.append(field.strip())

    def messages(self, units: Units) -> Messages:
        """Return the messages."""
        time = None
        numbers = {}
        texts = {}
        for name, column in self._columns.items():
            if name == self._timer:
                time = np.asarray(column) / CLOCKS.get(name, 1e3)
            elif isinstance(column, array):
                numbers[name] = np.asarray(column)
            # Modes are names in some firmware and numbers in other.
            elif column and is_number(column[0]) and self._letters[name] == "M":
                numbers[name] = np.array([_number(cell) for cell in column])
            else:
                texts[name] = column

        return Messages(
            self.layout.name,
            np.asarray(self._order),
            time,
            numbers,
            texts,
            units.columns,
            units.instance if self._is_wanted else "",
        )


def read(path: Path, messages: Collection[str] | None = None) -> Recording:
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
    with path.open("rb") as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = Lines(file, None if messages is None else {*messages, *ALWAYS, *TABLES})
    tables = UnitTables(
        lines.messages[name].messages(Units({}, "")) for name in TABLES if name in lines.messages
    )
    groups = [
        group.messages(tables.of(group.layout))
        for name, group in lines.messages.items()
        if name not in TABLES
    ]
    groups = [group for group in groups if len(group)]
    findings = [*_damage(lines), *tables.findings]

    return recording(groups + _banner(lines), path, checksum, messages, findings)


def _number(field: str) -> float:
    try:
        return float(field)
    except ValueError:
        return math.nan


def _banner(lines: Lines) -> list[Messages]:
    """Return the line in which an old log names its firmware, as a text message."""
    # Later logs name the firmware in their text messages.
    if not lines.banner or "MSG" in lines.messages:
        return []
    return [Messages("MSG", np.zeros(1, dtype=np.int64), None, {}, {"Message": [lines.banner]})]


def _damage(lines: Lines) -> list[str]:
    findings = [
        f"{name}: {group.damaged} damaged lines were skipped."
        for name, group in lines.messages.items()
        if group.damaged
    ]
    if lines.unknown:
        findings.append(
            f"{lines.unknown} lines are damaged, or have no FMT line that describes them, and were "
            "skipped."
        )

    return findings
