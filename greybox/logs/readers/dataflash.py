"""ArduPilot DataFlash logs, binary (.BIN): decoded piece by piece of the file, one column at a time.

`dataflash_index` finds the messages in the file; what the numbers mean (scales of the format
letters, unit and multiplier tables) follows pymavlink, and the values are equal to pymavlink's to
the last bit.
"""

import hashlib
import mmap
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Recording
from greybox.files.arrays import Array, IntArray
from greybox.files.progress import counted_off
from greybox.logs.readers import ardupilot_metadata
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.dataflash_index import PIECE, Index, Layout, index, text
from greybox.logs.readers.dataflash_units import Units, UnitTables, with_usual_units
from greybox.logs.readers.mapped_file import release
from greybox.logs.readers.messages import Clocked, Messages, bare, merged, on_one_clock, records

# About the log or the vehicle: no time histories.
ABOUT = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE", "ISBH", "ISBD")
ALWAYS = ("PARM", "MSG", "MODE", "VER", "ARM", "EV")  # metadata, read whatever is requested
TABLES = ("FMT", "FMTU", "UNIT", "MULT")
CLOCKS = {"TimeUS": 1e6, "TimeMS": 1e3}  # ticks per second


def read(path: str | Path, messages: Collection[str] | None = None) -> Recording:
    """Read a DataFlash log.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Types to read, e.g. ``("ATT", "RATE")``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Times in s since the vehicle's start; values and units as pymavlink gives them.

    Raises
    ------
    ValueError
        If the file holds no message that can be read.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    messages = bare(messages)
    with open(path, "rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    log, damage = _contents(data, messages)
    return recording(log, path, _checksum(data), messages, damage)


def recording(
    log: Clocked,
    path: Path,
    checksum: str,
    messages: Collection[str] | None,
    findings: Sequence[str],
) -> Recording:
    """Make a recording of the messages of an ArduPilot log, binary or text."""
    restarts = log.findings
    span = log.span
    groups, assumed = with_usual_units(log.groups)
    groups, conflicts = merged(groups)
    wanted = [g for g in groups if g.name not in ABOUT and (messages is None or g.name in messages)]
    metadata = ardupilot_metadata.metadata(groups, span)
    missing = _missing({g.name for g in groups}, messages)
    wanted = with_holds(wanted, metadata.get("parameters", {}))
    by_name, problems = records(wanted, path.name, checksum)
    if not by_name and not metadata:
        raise ValueError(
            f"{path} holds no ArduPilot message that can be read; copy it from the vehicle again."
        )
    findings = (*findings, *conflicts, *restarts, *missing, *problems, *assumed)
    return Recording(by_name, path.name, checksum, metadata, findings)


def _checksum(data: mmap.mmap) -> str:
    digest = hashlib.sha256()
    for start in range(0, len(data), PIECE):
        digest.update(data[start : start + PIECE])
        release(data, start, start + PIECE)
    return digest.hexdigest()


def _contents(data: mmap.mmap, messages: Collection[str] | None) -> tuple[Clocked, tuple[str, ...]]:
    """Return the messages on one clock, those that are requested with their columns, and the damage."""
    positions = index(data)
    damage = _damage(positions)
    types, stamps = _decoded(data, positions, messages)
    del positions  # of a log of gigabytes, it takes as much memory as a message or two
    types = [columns for columns in types if columns.count]
    tables = UnitTables(
        columns.messages(Units({}, ""), stamps)
        for columns in types
        if columns.layout.name in TABLES
    )
    groups = [
        columns.messages(tables.of(columns.layout), stamps)
        for columns in types
        if columns.layout.name not in TABLES
    ]
    del types
    return on_one_clock(groups, stamps), (*damage, *tables.findings)


def _decoded(
    data: mmap.mmap, positions: Index, messages: Collection[str] | None
) -> "tuple[list[_Columns], Array]":
    """Decode the types that are requested, of the others the times; return columns, and all times, s.

    It goes piece by piece through the file, so that nothing else of it is ever in memory.
    """
    counts = np.bincount(positions.which, minlength=len(positions.layouts))
    types = [
        _Columns(data, layout, count, _is_wanted(layout.name, messages))
        for layout, count in zip(positions.layouts, counts.tolist(), strict=True)
    ]
    is_timed = np.array([columns.is_timed for columns in types], dtype=bool)
    stamps = np.empty(int(counts[is_timed].sum()))
    timed_count = 0
    edges = np.arange(PIECE, len(data) + PIECE, PIECE)
    ends = np.searchsorted(positions.offsets, edges).tolist()
    for piece, (first, last) in enumerate(
        counted_off([*pairwise([0, *ends])], "decoding", "piece")
    ):
        which = positions.which[first:last]
        offsets = positions.offsets[first:last].astype(np.int64)
        numbers = timed_count + np.cumsum(is_timed[which])
        for k in np.unique(which).tolist():
            rows = np.flatnonzero(which == k)
            order = numbers[rows] - 1 if is_timed[k] else rows + first
            types[k].decode(offsets[rows], order, stamps)
        timed_count = int(numbers[-1]) if numbers.size else timed_count
        release(data, (piece - 1) * PIECE, (piece + 1) * PIECE)
    return types, stamps


def _is_wanted(name: str, messages: Collection[str] | None) -> bool:
    if messages is None:
        return name != "FILE"  # whole files of the vehicle, as text
    return name in {*messages, *ALWAYS, *TABLES}


class _Columns:
    """The columns of all messages of one layout, filled from one piece of the file after the other.

    Messages that are not wanted give their times alone, to the stamps of the log, which are the
    times of all timed messages by their number. The unit tables take no part in that: they are
    written again and again, with any time.
    """

    def __init__(self, data: mmap.mmap, layout: Layout, count: int, is_wanted: bool) -> None:
        self.layout = layout
        self.count = count
        self._is_wanted = is_wanted
        self._timer = clock_column(layout)
        self.is_timed = bool(self._timer) and layout.name not in TABLES
        # A view of a body at every byte of the file: indexing one of its fields copies only the
        # messages of this layout.
        size = max(len(data) - layout.length + 1, 0)
        self._bodies = (
            np.ndarray((size,), layout.dtype, data, 3, (1,)) if count else np.empty(0, layout.dtype)
        )
        rows = count if is_wanted else 0
        self._filled = 0
        self._order = np.empty(rows, dtype=np.int32 if len(data) < 2**31 else np.int64)
        self._texts: dict[str, list[str]] = {}
        self._columns: dict[str, Array] = {}
        for name, letter in zip(layout.columns, layout.format, strict=True):
            if name == self._timer or not is_wanted:
                continue
            if letter in "nNZ":
                self._texts[name] = []
            elif letter != "a":  # arrays, of files and of raw samples of the IMU
                self._columns[name] = np.empty(rows)

    def decode(self, offsets: IntArray, order: IntArray, stamps: Array) -> None:
        """Decode the messages at these offsets, with these numbers."""
        rows = slice(self._filled, self._filled + order.size)
        for i, name in enumerate(self.layout.columns):
            field = self._bodies[f"f{i}"]
            if name == self._timer and self.is_timed:
                stamps[order] = field[offsets] / CLOCKS.get(name, 1e3)
            elif name in self._texts:
                self._texts[name] += [text(value) for value in field[offsets].tolist()]
            elif name in self._columns:
                self._columns[name][rows] = _numbers(field[offsets], self.layout.scale(i))
        if self._is_wanted:
            self._order[rows] = order
            self._filled += order.size

    def messages(self, units: Units, stamps: Array) -> Messages:
        """Return the messages; of those that are not wanted, only their number."""
        if not self._is_wanted:
            no_order = np.broadcast_to(np.intp(0), (self.count,))
            return Messages(self.layout.name, no_order, None, {}, {}, units.columns)
        time = stamps[self._order] if self.is_timed else None
        return Messages(
            self.layout.name,
            self._order,
            time,
            self._columns,
            self._texts,
            units.columns,
            units.instance,
        )


def _numbers(values: NDArray[np.generic], scale: float | None) -> Array:
    with np.errstate(invalid="ignore"):  # damaged floats
        return values.astype(float) if scale is None else values.astype(float) / scale


def clock_column(layout: Layout) -> str:
    """Return the column with the vehicle's own time: the first if it is TimeUS or TimeMS; T of the old GPS messages."""
    if layout.name in ("GPS", "GPS2") and "T" in layout.columns and layout.columns[0] != "TimeUS":
        return "T"  # their TimeMS is that of the GPS week
    return layout.columns[0] if layout.columns and layout.columns[0] in CLOCKS else ""


def _missing(present: set[str], messages: Collection[str] | None) -> tuple[str, ...]:
    """Say which messages were requested, or are needed, but are missing."""
    absent = [name for name in messages or () if name not in present]
    names = ", ".join(sorted(present - {*ABOUT}))
    findings = [
        f"there is no message {name}; the log has {names or 'none'}."
        for name in absent
        if name != "RATE"
    ]
    if "RATE" not in present and ("ATT" in present if messages is None else "RATE" in messages):
        findings.append(ardupilot_metadata.NO_RATE)
    return tuple(findings)


def _damage(positions: Index) -> tuple[str, ...]:
    findings = []
    if positions.skipped:
        places = (
            f"in {positions.places} places, the first" if positions.places > 1 else "in one place,"
        )
        findings.append(
            f"{positions.skipped} bytes {places} at byte {positions.first}, are damaged and were skipped."
        )
    if positions.cut:
        findings.append(
            f"the last message ({positions.cut}) is cut off: the file was truncated, or the power was lost."
        )
    return tuple(findings)
