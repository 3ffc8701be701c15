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
from greybox.logs.readers.imu_batches import DATA, HEADER, SAMPLES, with_batches
from greybox.logs.readers.mapped_file import release
from greybox.logs.readers.messages import Clocked, Messages, bare, merged, on_one_clock, records

ABOUT = (
    "FMT",
    "FMTU",
    "UNIT",
    "MULT",
    "PARM",
    "MSG",
    "FILE",
)  # about the log or the vehicle: no time histories
ALWAYS = ("PARM", "MSG", "MODE", "VER", "ARM", "EV", HEADER)  # metadata, read whatever is requested
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
    """Make a recording of the messages of an ArduPilot log, binary or text; all of them serve the metadata."""
    restarts, span = log.findings, log.span
    groups, assumed = with_usual_units(log.groups)
    log.groups.clear()
    groups, conflicts = merged(groups)
    groups, incomplete = with_batches(groups)
    wanted = [g for g in groups if g.name not in ABOUT and (messages is None or g.name in messages)]
    metadata = ardupilot_metadata.metadata(groups, span)
    missing = _missing({g.name for g in groups}, messages)
    del groups
    wanted = with_holds(wanted, metadata.get("parameters", {}))
    found, problems = records(wanted, path.name, checksum)
    if not found and not metadata:
        raise ValueError(
            f"{path} holds no ArduPilot message that can be read; copy it from the vehicle again."
        )
    findings = (*findings, *conflicts, *incomplete, *restarts, *missing, *problems, *assumed)
    return Recording(found, path.name, checksum, metadata, findings)


def _checksum(data: mmap.mmap) -> str:
    digest = hashlib.sha256()
    for start in range(0, len(data), PIECE):
        digest.update(data[start : start + PIECE])
        release(data, start, start + PIECE)
    return digest.hexdigest()


def _contents(data: mmap.mmap, messages: Collection[str] | None) -> tuple[Clocked, tuple[str, ...]]:
    """Return the messages on one clock, those that are requested with their columns, and what is damaged.

    What the index takes, of a log of gigabytes as much as a message or two, is not kept.
    """
    found = index(data)
    damage = _damage(found)
    each, stamps = _decoded(data, found, messages)
    del found
    tables = UnitTables(
        one.messages(Units({}, ""), stamps)
        for one in each
        if one.count and one.layout.name in TABLES
    )
    used = [one for one in each if one.count and one.layout.name not in TABLES]
    groups = [one.messages(tables.of(one.layout), stamps) for one in used]
    del each, used
    return on_one_clock(groups, stamps), (*damage, *tables.findings)


def _decoded(
    data: mmap.mmap, found: Index, messages: Collection[str] | None
) -> "tuple[list[_Columns], Array]":
    """Decode every type that is requested, of the others the times; return the columns, and the times of all, s.

    Piece by piece of the file, so that nothing else of it is ever in memory.
    """
    counts = np.bincount(found.which, minlength=len(found.layouts))
    each = [
        _Columns(
            data, layout, count, messages is None or layout.name in {*messages, *ALWAYS, *TABLES}
        )
        for layout, count in zip(found.layouts, counts.tolist(), strict=True)
    ]
    is_timed = np.array([one.is_timed for one in each], dtype=bool)
    stamps = np.empty(int(counts[is_timed].sum()))
    before = 0
    ends = np.searchsorted(found.offsets, np.arange(PIECE, len(data) + PIECE, PIECE)).tolist()
    for piece, (first, last) in enumerate(
        counted_off([*pairwise([0, *ends])], "decoding", "piece")
    ):
        which = found.which[first:last]
        offsets = found.offsets[first:last].astype(np.int64)
        numbers = before + np.cumsum(is_timed[which])
        for k in np.unique(which).tolist():
            rows = np.flatnonzero(which == k)
            each[k].take(offsets[rows], numbers[rows] - 1 if is_timed[k] else rows + first, stamps)
        before = int(numbers[-1]) if numbers.size else before
        release(data, (piece - 1) * PIECE, (piece + 1) * PIECE)
    return each, stamps


class _Columns:
    """The columns of all messages of one layout, filled one piece of the file after the other.

    Those that are not wanted as a `whole` give their times alone, to the stamps of the log, which
    has those of all timed messages by their number. The tables have no part in that: they are
    written anew at times, with any time.
    """

    def __init__(self, data: mmap.mmap, layout: Layout, count: int, whole: bool) -> None:
        self.layout = layout
        self.count = count
        self._whole = whole
        self._timer = clock_column(layout)
        self.is_timed = bool(self._timer) and layout.name not in TABLES
        # A view of a body at every byte of the file; indexing a field of it copies only the
        # messages of this layout.
        size = max(len(data) - layout.length + 1, 0)
        self._bodies = (
            np.ndarray((size,), layout.dtype, data, 3, (1,)) if count else np.empty(0, layout.dtype)
        )
        kept = count if whole else 0
        self._filled = 0
        self._order = np.empty(kept, dtype=np.int32 if len(data) < 2**31 else np.int64)
        letters = dict(zip(layout.columns, layout.format, strict=True))
        letters.pop(self._timer, None)
        self._texts: dict[str, list[str]] = {
            name: []
            for name, letter in letters.items()
            if whole and letter in "nNZ" and layout.name != "FILE"
        }
        arrays = [name for name, letter in letters.items() if letter == "a" and layout.name == DATA]
        self._arrays = {name: np.empty((kept, SAMPLES), dtype=np.int16) for name in arrays}
        self._columns = {
            name: np.empty(kept)
            for name, letter in letters.items()
            if whole and letter not in "anNZ"
        }

    def take(self, offsets: IntArray, numbers: IntArray, stamps: Array) -> None:
        """Decode the messages of these offsets and numbers."""
        here = slice(self._filled, self._filled + numbers.size)
        for i, name in enumerate(self.layout.columns):
            field = self._bodies[f"f{i}"]
            if name == self._timer and self.is_timed:
                stamps[numbers] = field[offsets] / CLOCKS.get(name, 1e3)
            elif name in self._texts:
                self._texts[name] += [text(value) for value in field[offsets].tolist()]
            elif name in self._arrays and self._whole:
                self._arrays[name][here] = field[offsets].view("<i2").reshape(-1, SAMPLES)
            elif name in self._columns:
                self._columns[name][here] = _numbers(field[offsets], self.layout.scale(i))
        if self._whole:
            self._order[here] = numbers
            self._filled += numbers.size

    def messages(self, units: Units, stamps: Array) -> Messages:
        """Return the messages; of those that are not wanted as a whole, how many there are."""
        if not self._whole:
            nothing = np.broadcast_to(np.intp(0), (self.count,))
            return Messages(self.layout.name, nothing, None, {}, {}, units.columns)
        time = stamps[self._order] if self.is_timed else None
        parts = {
            f"{name}[{k}]": values[:, k].astype(float)
            for name, values in self._arrays.items()
            for k in range(SAMPLES)
        }
        columns = {**self._columns, **parts}
        return Messages(
            self.layout.name, self._order, time, columns, self._texts, units.columns, units.instance
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


def _damage(found: Index) -> tuple[str, ...]:
    findings = []
    if found.skipped:
        places = f"in {found.places} places, the first" if found.places > 1 else "in one place,"
        findings.append(
            f"{found.skipped} bytes {places} at byte {found.first}, are damaged and were skipped."
        )
    if found.cut:
        findings.append(
            f"the last message ({found.cut}) is cut off: the file was truncated, or the power was lost."
        )
    return tuple(findings)
