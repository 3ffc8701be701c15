"""Finds the messages in a DataFlash log, damaged ones included.

pymavlink has a compiled scan, but it terminates the Python process at the first message of an
unknown type or length, and prints a line for every byte that it skips. This scan is about as fast,
silent, and returns the damaged places. The table of format letters is that of pymavlink.

Units of a DataFlash log: UNIT and MULT name them by a letter, and FMTU uses the letters.
"""

import math
import mmap
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymavlink.DFReader import FORMAT_TO_STRUCT, MULT_TO_PREFIX

from greybox.files.arrays import IntArray
from greybox.files.frozen_values import frozen
from greybox.files.grouping import unique
from greybox.logs.readers.ardupilot_metadata import column, unit
from greybox.logs.readers.messages import Messages

Bytes = bytes | mmap.mmap
HEAD = b"\xa3\x95"  # before every message; the number of its type follows
FMT = 0x80  # the message that describes the others: type, length, name, format, columns
FMT_LENGTH = 89
FMT_BODY = struct.Struct("<BB4s16s64s")


@dataclass(frozen=True)
class Layout:
    """The layout of one message type: its bytes with the header, one letter for each column."""

    kind: int
    name: str
    length: int
    format: str
    columns: tuple[str, ...]

    @property
    def dtype(self) -> np.dtype:
        """The body as a packed numpy type, little-endian."""
        formats = (FORMAT_TO_STRUCT[letter][0] for letter in self.format)
        # The letters of `struct` are those of numpy, except that of texts: 16s is S16.
        types = (f"S{form[:-1]}" if form.endswith("s") else f"<{form}" for form in formats)
        return np.dtype([(f"f{i}", type_) for i, type_ in enumerate(types)])

    def scale(self, column: int) -> float | None:
        """Return the divisor of the letter: 100 for c, C, e and E, 1e7 for L, None for others."""
        multiplier = FORMAT_TO_STRUCT[self.format[column]][1]
        return None if multiplier is None else 1 / multiplier


FMT_LAYOUT = Layout(
    FMT, "FMT", FMT_LENGTH, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns")
)


@frozen
class Index:
    """Offsets of all sound messages, in the order of the file, and its damage.

    Attributes
    ----------
    layouts : tuple of Layout
        Every description in the file; one type may have several that differ.
    offsets : (n,) array
        Where each message starts, bytes.
    numbers : (n,) array
        Its layout, as an index.
    damage : tuple of (start, end)
        Bytes that belong to no message.
    cut : str
        Name of a last message that is not complete.
    """

    layouts: tuple[Layout, ...]
    offsets: IntArray
    numbers: IntArray
    damage: tuple[tuple[int, int], ...]
    cut: str


def index(data: Bytes) -> Index:
    """Find every message in `data`."""
    raw = np.frombuffer(data, dtype=np.uint8)
    # Every place that may begin a message; data look like a header once in 65 536 bytes.
    starts = np.flatnonzero((raw[:-2] == HEAD[0]) & (raw[1:-1] == HEAD[1]))
    layouts, numbers = _layouts(data, starts, raw[starts + 2])
    starts, numbers = starts[numbers >= 0], numbers[numbers >= 0]
    ends = starts + np.array([layout.length for layout in layouts])[numbers]

    is_message, damage = _chain(data, starts, ends)
    # Only the last message can reach beyond the end of the file.
    cut = np.flatnonzero(is_message & (ends > raw.size))
    is_message[cut] = False
    name = layouts[numbers[cut[0]]].name if cut.size else ""
    return Index(layouts, starts[is_message], numbers[is_message], damage, name)


def _layouts(
    data: Bytes, starts: IntArray, kinds: NDArray[np.uint8]
) -> tuple[tuple[Layout, ...], IntArray]:
    """Return all descriptions, and which of them applies at each header, -1 where none does."""
    layouts = {FMT_LAYOUT: 0}
    descriptions: dict[int, list[tuple[int, int]]] = {}
    for row in np.flatnonzero(kinds == FMT).tolist():
        body = data[starts[row] + 3 : starts[row] + FMT_LENGTH]
        layout = _layout(body) if len(body) == FMT_BODY.size else None
        if layout is not None and layout.kind != FMT:
            number = layouts.setdefault(layout, len(layouts))
            descriptions.setdefault(layout.kind, []).append((row, number))

    numbers = np.where(kinds == FMT, 0, -1)
    for kind, described in descriptions.items():
        rows = np.flatnonzero(kinds == kind)
        since, number = np.array([(-1, -1), *described]).T
        # A later description replaces the earlier one from its place on.
        numbers[rows] = number[np.searchsorted(since, rows) - 1]

    return tuple(layouts), numbers


def _chain(
    data: Bytes, starts: IntArray, ends: IntArray
) -> tuple[NDArray[np.bool_], tuple[tuple[int, int], ...]]:
    """Return which headers begin messages that follow each other, and the damaged places.

    Two bytes within a message may look like a header. So a message counts if it begins where the
    previous one ends. Behind damage, another message or the end of the file must follow it.
    """
    is_message = np.zeros(starts.size, dtype=bool)
    breaks = np.append(np.flatnonzero(ends[:-1] != starts[1:]), starts.size - 1)
    damage = []
    last, end = -1, 0
    while end <= len(data) - len(HEAD) - 1:
        # All messages up to the next break follow each other: they need not be visited one by one.
        first = np.searchsorted(starts, end)
        if first < starts.size and starts[first] == end:
            last = int(breaks[np.searchsorted(breaks, first)])
            is_message[first : last + 1] = True
            end = int(ends[last])
            continue

        following = last + 1
        # Nothing follows the last message of a file, and a cut one may follow.
        while following < starts.size and not HEAD.startswith(
            data[ends[following] : ends[following] + 2]
        ):
            following += 1
        resume = int(starts[following]) if following < starts.size else len(data)
        # The last message was truncated: a sound one begins inside it.
        if resume < end:
            is_message[last] = False
            end = int(starts[last])
        # A page of memory: zeros or erased flash at the end of a file are not damage.
        tail = data[end : end + 4096]
        if resume < len(data) or (tail.strip(b"\0") and tail.strip(b"\xff")):
            damage.append((end, resume))
        end = resume

    return is_message, tuple(damage)


def sound_layout(
    kind: int, name: str, length: int | None, letters: str, columns: tuple[str, ...]
) -> Layout | None:
    """Return the layout, or None if its letters, columns and length do not fit together.

    The length is None in logs of text.
    """
    # Bytes of other messages may look like a description.
    if not (
        name.isascii()
        and name.replace("_", "").isalnum()
        and all(c in FORMAT_TO_STRUCT for c in letters)
    ):
        return None
    layout = Layout(kind, name, length or 0, letters, columns)
    fits = len(columns) == len(letters) == len(set(columns))
    return layout if fits and length in (None, layout.dtype.itemsize + 3) else None


def _layout(body: bytes) -> Layout | None:
    kind, length, name, letters, columns = FMT_BODY.unpack(body)
    names = tuple(column for column in text(columns).split(",") if column)
    return sound_layout(kind, text(name), length, text(letters), names)


def text(raw: bytes) -> str:
    """Return a text field up to its first zero byte, decoded as pymavlink does."""
    raw = raw.partition(b"\0")[0]
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("iso-8859-1")


INSTANCE = "#"  # the letter of a column that counts instances
INSTANCES = ("I", "C", "Inst", "Instance")  # names of such a second column in logs without FMTU

_ANGLES = dict.fromkeys("DesRoll Roll DesPitch Pitch DesYaw Yaw ErrRP ErrYaw".split(), "deg")
_VELOCITY = dict.fromkeys(("VN", "VE", "VD"), "m/s") | dict.fromkeys(("PN", "PE", "PD"), "m")
USUAL = {
    "ATT": _ANGLES,
    "AHR2": _ANGLES,
    "RATE": dict.fromkeys("RDes R PDes P YDes Y".split(), "deg/s"),
    "IMU": dict.fromkeys("GyrX GyrY GyrZ".split(), "rad/s")
    | dict.fromkeys("AccX AccY AccZ".split(), "m/s²"),
    **dict.fromkeys(("EKF1", "NKF1", "XKF1"), _ANGLES | _VELOCITY),
}


class Units(NamedTuple):
    """Unit of every column of one type, and the column of instances, if any."""

    columns: Mapping[str, str]
    instance: str


class UnitTables:
    """The tables of one log, made of its UNIT, MULT and FMTU messages."""

    def __init__(self, groups: Iterable[Messages]) -> None:
        tables = {group.name: group for group in groups}
        self._labels: dict[str, set[str]] = {}
        for letter, label in _pairs(tables.get("UNIT"), "Label"):
            self._labels.setdefault(_letter(letter), set()).add(label)
        # Single precision on board: pymavlink rounds to 7 digits to look the prefixes up.
        self._multipliers = {
            _letter(letter): float(f"{value:.7g}")
            for letter, value in _pairs(tables.get("MULT"), "Mult")
        }
        used = tables.get("FMTU")
        letters = zip(column(used, "UnitIds"), column(used, "MultIds"), strict=False)
        self._letters = dict(zip(map(_integer, column(used, "FmtType")), letters, strict=False))

    @property
    def findings(self) -> tuple[str, ...]:
        """Messages about letters with several units in the table."""
        return tuple(
            f"the table of units has the letter {letter!r} for {' and for '.join(sorted(labels))}: "
            "its columns are taken without a unit."
            for letter, labels in self._labels.items()
            if len(labels) > 1
        )

    def of(self, layout: Layout) -> Units:
        """Return the units of one type as pymavlink does, with the multiplier in it, cm/s²."""
        units, scales = self._letters.get(layout.kind, ("", ""))
        columns = {}
        for i, (name, letter) in enumerate(zip(layout.columns, units, strict=False)):
            labels = self._labels.get(letter, ())
            label = unit(*labels) if len(labels) == 1 else ""
            # A format letter that scales has been applied to the numbers already.
            scaled = label and i < len(scales) and layout.scale(i) is None
            multiplier = self._multipliers.get(scales[i], 1.0) if scaled else 1.0
            # The prefix of 1.0 is empty.
            columns[name] = MULT_TO_PREFIX.get(multiplier, f"{multiplier:.4g} ") + label
        return Units(columns, _instance(layout, units))


def with_usual_units(groups: list[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Give messages of logs without unit tables ArduPilot's usual units, with a finding."""
    if any(unit for group in groups for unit in group.units.values()):
        return groups, ()
    names = ", ".join(unique(group.name for group in groups if group.name in USUAL))
    with_units = [replace(g, units={**g.units, **USUAL.get(g.name, {})}) for g in groups]
    text = f"the log has no table of units: ArduPilot's usual ones are assumed for {names}."
    return with_units, (text,) if names else ()


def _pairs(table: Messages | None, value: str) -> Iterable[tuple[float, Any]]:
    """Return the pairs of the columns Id and `value`; empty if one is missing."""
    return zip(column(table, "Id"), column(table, value), strict=False)


def _instance(layout: Layout, units: str) -> str:
    if INSTANCE in units:
        at = units.index(INSTANCE)
        return layout.columns[at] if at < len(layout.columns) else ""
    second = layout.columns[1] if len(layout.columns) > 1 and not units else ""
    return second if second in INSTANCES and layout.format[1] in "bBM" else ""


def _letter(value: float) -> str:
    # Letters are logged as numbers; damaged ones may exceed ASCII.
    return chr(_integer(value) & 0x7F)


def _integer(value: float) -> int:
    """Return a number as an integer; 0, which these tables do not use, for a damaged one."""
    return int(value) if math.isfinite(value) else 0
