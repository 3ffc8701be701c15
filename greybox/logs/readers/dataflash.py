"""ArduPilot DataFlash logs, binary (.BIN): decoded one whole column at a time.

`dataflash_index` finds the messages in the file; what the numbers mean (scales of the format letters, unit and
multiplier tables) follows pymavlink, and the values are equal to pymavlink's to the last bit.
"""

import hashlib
import mmap
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Recording
from greybox.logs.readers import ardupilot_metadata
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.dataflash_index import Index, Layout, index, text
from greybox.logs.readers.dataflash_units import Units, UnitTables, with_usual_units
from greybox.logs.readers.messages import Messages, bare, merged, on_one_clock, records

ABOUT = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE")  # about the log or the vehicle: no time histories
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
    found = index(data)
    checksum = hashlib.sha256(data).hexdigest()
    return recording(_groups(data, found, messages), path, checksum, messages, _damage(found))


def recording(
    groups: Iterable[Messages],
    path: Path,
    checksum: str,
    messages: Collection[str] | None,
    findings: Sequence[str],
) -> Recording:
    """Make a recording of the messages of an ArduPilot log, binary or text; all of them serve the metadata."""
    groups, assumed = with_usual_units(list(groups))
    groups, conflicts = merged(groups)
    groups, restarts = on_one_clock(groups)

    wanted = [g for g in groups if g.name not in ABOUT and (messages is None or g.name in messages)]
    metadata = ardupilot_metadata.metadata(groups)
    found, problems = records(with_holds(wanted, metadata.get("parameters", {})), path.name, checksum)
    if not found and not metadata:
        raise ValueError(f"{path} holds no ArduPilot message that can be read; copy it from the vehicle again.")
    missing = _missing({g.name for g in groups}, messages)
    findings = (*findings, *conflicts, *restarts, *missing, *problems, *assumed)
    return Recording(found, path.name, checksum, metadata, findings)


def _groups(data: mmap.mmap, found: Index, messages: Collection[str] | None) -> list[Messages]:
    """Decode every type that is requested, and of the others the times."""
    layouts = [(layout, found.of(i)) for i, layout in enumerate(found.layouts)]
    layouts = [(layout, rows) for layout, rows in layouts if rows.size]
    no_units = Units({}, "")
    tables = UnitTables(
        _decode(data, found, layout, rows, no_units) for layout, rows in layouts if layout.name in TABLES
    )
    groups = []
    for layout, rows in layouts:
        if layout.name not in TABLES:
            whole = messages is None or layout.name in {*messages, *ALWAYS}
            groups.append(_decode(data, found, layout, rows, tables.of(layout), whole))
    return groups


def _decode(
    data: mmap.mmap, found: Index, layout: Layout, rows: NDArray[np.intp], units: Units, whole: bool = True
) -> Messages:
    """Return the messages of one layout; without `whole` only their times."""
    timer = clock_column(layout)
    offsets = found.offsets[rows]

    # A view of a body at every byte of the file; indexing a field of it copies only the messages of this layout.
    bodies = np.ndarray((len(data) - layout.length + 1,), layout.dtype, data, 3, (1,))
    time = None
    columns = {}
    texts = {}
    for i, name in enumerate(layout.columns):
        if name == timer:
            time = bodies[f"f{i}"][offsets] / CLOCKS.get(name, 1e3)
        elif whole and layout.format[i] in "nNZ" and layout.name != "FILE":
            texts[name] = [text(value) for value in bodies[f"f{i}"][offsets].tolist()]
        elif whole and layout.format[i] not in "anNZ":
            columns[name] = _numbers(bodies[f"f{i}"][offsets], layout.scale(i))
    return Messages(layout.name, rows, time, columns, texts, units.columns, units.instance if whole else "")


def _numbers(values: NDArray[np.generic], scale: float | None) -> NDArray[np.float64]:
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
    findings = [f"there is no message {name}; the log has {names or 'none'}." for name in absent if name != "RATE"]
    if "RATE" not in present and ("ATT" in present if messages is None else "RATE" in messages):
        findings.append(ardupilot_metadata.NO_RATE)
    return tuple(findings)


def _damage(found: Index) -> tuple[str, ...]:
    findings = []
    if found.skipped:
        places = f"in {found.places} places, the first" if found.places > 1 else "in one place,"
        findings.append(f"{found.skipped} bytes {places} at byte {found.first}, are damaged and were skipped.")
    if found.cut:
        findings.append(f"the last message ({found.cut}) is cut off: the file was truncated, or the power was lost.")
    return tuple(findings)
