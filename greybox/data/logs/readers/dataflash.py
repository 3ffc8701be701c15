"""ArduPilot DataFlash logs, binary (.BIN): decoded one column at a time.

`dataflash_index` finds the messages in the file; what the numbers mean (scales of the format
letters, unit and multiplier tables) follows pymavlink, and the values are equal to pymavlink's to
the last bit.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.progress import bar
from greybox.data.files.wording import counted
from greybox.data.logs.readers import ardupilot_metadata
from greybox.data.logs.readers.controller_outputs import with_holds
from greybox.data.logs.readers.dataflash_index import Bytes, Index, index, text
from greybox.data.logs.readers.dataflash_layout import Layout
from greybox.data.logs.readers.dataflash_units import Units, UnitTables, with_usual_units
from greybox.data.logs.readers.messages import (
    MessageNames,
    Messages,
    bare,
    checksum_of,
    mapped,
    on_one_clock,
    records,
)
from greybox.data.logs.readers.sample_times import at_sample_times
from greybox.data.record import Recording

# About the log or the vehicle: no time histories.
ABOUT = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "FILE", "ISBH", "ISBD")
ALWAYS = ("PARM", "MSG", "MODE", "VER")  # metadata, read whatever is requested
TABLES = ("FMT", "FMTU", "UNIT", "MULT")
CLOCKS = {"TimeUS": 1e6, "TimeMS": 1e3}  # ticks per second


def read(path: Path, messages: MessageNames = None) -> Recording:
    """Read a DataFlash log.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Types to read, e.g. ``("ATT", "RATE")``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Times in s since the vehicle's start; values and units as pymavlink gives them.

    Raises
    ------
    ValueError
        If the file holds no message that can be read, or is one of PX4's old logger.
    OSError
        If the file cannot be opened.
    """
    messages = bare(messages)
    groups, damage = _contents(mapped(path), messages)
    return recording(groups, path, messages, damage)


def recording(
    groups: list[Messages],
    path: Path,
    messages: MessageNames,
    findings: Sequence[str],
) -> Recording:
    """Make a recording of the messages of an ArduPilot log, binary or text."""
    if any(group.name == "TIME" and group.time is None for group in groups):
        raise ValueError(
            f"{path} is a log of sdlog2, PX4's old logger, whose messages have no times of their "
            "own: make a table of it with PX4's sdlog2_dump.py (-t TIME), and name its clock, "
            "columns=time=TIME_StartTime:us."
        )
    checksum = checksum_of(path)
    groups, restarts = on_one_clock(groups)
    # Before the messages are chosen: any unit in the log shows that it has tables of units.
    groups, assumed = with_usual_units(groups)
    wanted = [g for g in groups if g.name not in ABOUT and (messages is None or g.name in messages)]
    metadata = ardupilot_metadata.metadata(groups)
    missing = _missing({g.name for g in groups}, messages)
    wanted = with_holds(at_sample_times(wanted), metadata.get("parameters", {}))
    by_name, problems = records(wanted, path.name, checksum)
    if not by_name and not metadata:
        raise ValueError(
            f"{path} holds no ArduPilot message that can be read; copy it from the vehicle again."
        )
    findings = (*findings, *restarts, *missing, *problems, *assumed)

    return Recording(by_name, path.name, checksum, metadata, findings)


def _contents(data: Bytes, messages: MessageNames) -> tuple[list[Messages], tuple[str, ...]]:
    """Return the messages, the requested ones with their columns, and findings."""
    positions = index(data)
    # One sort instead of a comparison for each type: a file may describe many types.
    order = np.argsort(positions.numbers, kind="stable")
    counts = np.bincount(positions.numbers, minlength=len(positions.layouts))
    rows = dict(zip(positions.layouts, np.split(order, np.cumsum(counts)[:-1]), strict=True))

    def decoded(layout: Layout, units: Units) -> Messages:
        return _decoded(
            data, layout, positions.offsets[rows[layout]], rows[layout], units, messages
        )

    # The log may describe one name in two ways. A damaged description yields a few messages.
    largest = {layout.name: layout for layout in sorted(rows, key=lambda x: rows[x].size)}
    used = [layout for layout in rows if rows[layout].size]
    present = [layout for layout in used if largest[layout.name] is layout]
    lost = [
        f"{x.name}: {rows[x].size} messages with another layout than the rest were left out."
        for x in used
        if x not in present
    ]
    tables = UnitTables(decoded(x, Units({}, "")) for x in present if x.name in TABLES)
    # The unit tables are written again and again, with any time: they take no part in the clock.
    timed = [layout for layout in present if layout.name not in TABLES]
    groups = [decoded(x, tables.of(x)) for x in bar(timed, desc="decoding", unit="message")]
    return groups, (*_damage(positions), *tables.findings, *lost)


def _decoded(
    data: Bytes,
    layout: Layout,
    offsets: IntArray,
    order: IntArray,
    units: Units,
    messages: MessageNames,
) -> Messages:
    """Return the messages of one layout; of messages that are not requested, only the times.

    The clock of the whole log needs these times.
    """
    # A view with a body at every byte of the file: indexing copies the messages of this layout.
    size = len(data) - layout.length + 1
    bodies = np.ndarray((size,), layout.dtype, data, 3, (1,))[offsets]
    timer = clock_column(layout)
    time = None
    columns: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    for i, (name, letter) in enumerate(zip(layout.columns, layout.format, strict=True)):
        values = bodies[f"f{i}"]
        if name == timer:
            time = values / CLOCKS.get(name, 1e3)
        elif not is_wanted(layout.name, messages):
            continue
        elif letter in "nNZ":
            texts[name] = [text(value) for value in values.tolist()]
        elif letter != "a":  # arrays, of files and of raw samples of the IMU
            with np.errstate(invalid="ignore"):  # damaged floats
                columns[name] = values.astype(float)
            if scale := layout.scale(i):
                columns[name] /= scale

    return Messages(layout.name, order, time, columns, texts, units.columns, units.instance)


def is_wanted(name: str, messages: MessageNames) -> bool:
    """Return whether messages of this name are read, for their signals or as metadata."""
    if messages is None:
        return name != "FILE"  # whole files of the vehicle, as text
    return name in {*messages, *ALWAYS, *TABLES}


def clock_column(layout: Layout) -> str:
    """Return the column with the vehicle's time: the first, or T in old GPS messages."""
    if layout.name in ("GPS", "GPS2") and "T" in layout.columns and layout.columns[0] != "TimeUS":
        return "T"  # TimeMS of these messages counts from the start of the GPS week
    return layout.columns[0] if layout.columns and layout.columns[0] in CLOCKS else ""


def _missing(present: set[str], messages: MessageNames) -> Iterator[str]:
    """Yield findings on requested or necessary messages that are missing."""
    # A missing RATE has a finding of its own, with the cure.
    names = ", ".join(sorted(present - {*ABOUT}))
    for name in messages or ():
        if name not in (*present, "RATE"):
            yield f"there is no message {name}; the log has {names or 'none'}."
    if "RATE" not in present and ("ATT" in present if messages is None else "RATE" in messages):
        yield ardupilot_metadata.NO_RATE


def _damage(positions: Index) -> Iterator[str]:
    if positions.damage:
        skipped = sum(end - start for start, end in positions.damage)
        yield (
            f"{skipped} bytes in {counted(len(positions.damage), 'place')}, the first at byte "
            f"{positions.damage[0][0]}, are damaged and were skipped."
        )
    if positions.cut:
        yield (
            f"the last message ({positions.cut}) is cut off: the file was truncated, or the power "
            "was lost."
        )
