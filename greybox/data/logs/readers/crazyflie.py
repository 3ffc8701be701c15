"""Logs that a Crazyflie writes to its memory card: events with variables of the firmware.

A header describes the events. Each event is then its number, a time in µs (version 2) or ms
(version 1) and the values of its variables, little-endian and packed. A CRC-32 ends the file.

Source: https://github.com/bitcraze/crazyflie-firmware, docs/userguides/logparam (units) and
tools/usdlog/cfusdlog.py (layout).
"""

import re
import struct
import zlib
from array import array
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import IntArray
from greybox.data.logs.readers.dataflash_index import Bytes
from greybox.data.logs.readers.messages import (
    MessageNames,
    Messages,
    checksum_of,
    mapped,
    on_one_clock,
    records,
)
from greybox.data.record import Recording

MAGIC = 0xBC
STAMPS = {1: ("u4", 1e3), 2: ("u8", 1e6)}  # by version: the type of the stamps, ticks per second
TIME = "(time)"
CHECKSUM = 4  # bytes of the CRC-32 at the end
LONGEST_NAME = 256  # bytes; the firmware's names have up to 60
VARIABLE = re.compile(
    r"([^()]+)\(([bBhHiIqQfd])\)"
)  # a name and the letter of `struct` for its type

# Units of the firmware's log variables; a log has none. Motors are counts from 0 to 65535.
UNITS = {
    r"gyro\.[xyz]": "deg/s",
    r"acc\.[xyz]": "9.80665 m/s²",
    r"stabilizer\.(roll|pitch|yaw)": "deg",
    r"stateEstimate\.(roll|pitch|yaw)": "deg",
    r"stateEstimate\.[xyz]": "m",
    r"stateEstimate\.v[xyz]": "m/s",
    r"stateEstimate\.a[xyz]": "9.80665 m/s²",
    r"pm\.vbat": "V",
}


class _Header:
    """Reads the description of the events from the start of a log."""

    def __init__(self, data: Bytes) -> None:
        self.data = data
        self.place = 1  # behind MAGIC

    def number(self) -> int:
        """Return the next 2 bytes."""
        (value,) = struct.unpack_from("<H", self.data, self.place)
        self.place += 2
        return value

    def text(self) -> str:
        """Return the next text, which a zero ends."""
        end = self.data.find(b"\0", self.place, self.place + LONGEST_NAME)
        if end < 0:
            raise ValueError("a name in its header has no end")
        text = self.data[self.place : end].decode("ascii", "replace")
        if not (text.isascii() and text.isprintable()):
            raise ValueError("a name in its header is not a text")
        self.place = end + 1
        return text

    def event(self, stamp: str) -> np.dtype:
        """Return the layout of the next event."""
        # No variable has a bracket in its name.
        fields = [("(number)", "<u2"), (TIME, f"<{stamp}")]
        for _ in range(self.number()):
            described = self.text()
            match = VARIABLE.fullmatch(described)
            if match is None:
                raise ValueError(f"it has no type for the variable {described!r}")
            fields.append((match[1], "<" + np.dtype(match[2]).str[1:]))
        return np.dtype(fields)  # ValueError for two variables of one name


def read(path: Path, messages: MessageNames = None) -> Recording:
    """Read a log of a Crazyflie's memory card.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Events to read, e.g. ``("fixedFrequency",)``; all by default.

    Returns
    -------
    Recording
        A record for every event: times in s since the vehicle's start, values as in the log, with
        the units of the firmware's documentation where a variable is known.

    Raises
    ------
    ValueError
        If the header is damaged, or no event can be read.
    OSError
        If the file cannot be opened.
    """
    data = mapped(path)
    try:
        layouts, names, ticks, start = _header(data)
    except (ValueError, struct.error) as problem:
        raise ValueError(
            f"{path} is damaged in its header ({problem}): copy it from the card again."
        ) from None
    end, findings = _end(data)
    events, stop = _events(data, layouts, start, end)
    if end - stop > CHECKSUM:
        findings.append(f"its last {end - stop} bytes are damaged or cut off and were left out.")

    in_order = np.sort(np.concatenate([*events.values()]))
    groups = []
    for number, layout in layouts.items():
        if messages is None or names[number] in messages:
            order = np.searchsorted(in_order, events[number])
            groups.append(_messages(data, names[number], layout, events[number], order, ticks))
    missing = [name for name in messages or () if name not in names.values()]
    findings += [f"there is no event {name}." for name in missing]

    checksum = checksum_of(path)
    groups, restarts = on_one_clock(groups)
    by_name, dropped = records(groups, path.name, checksum)
    if not by_name:
        raise ValueError(f"{path} holds no event that can be read; copy it from the card again.")
    return Recording(by_name, path.name, checksum, {}, (*findings, *restarts, *dropped))


def _header(data: Bytes) -> tuple[dict[int, np.dtype], dict[int, str], float, int]:
    """Return layouts and names of the events by number, ticks per second, and the header's end."""
    header = _Header(data)
    version = header.number()
    if version not in STAMPS:
        raise ValueError(f"its version is {version}, greybox reads 1 and 2")
    stamp, ticks = STAMPS[version]
    layouts: dict[int, np.dtype] = {}
    names: dict[int, str] = {}
    for _ in range(header.number()):
        number = header.number()
        name = header.text()
        layout = header.event(stamp)
        if number in layouts or name in names.values():
            raise ValueError(f"it describes the event {name} twice")
        layouts[number] = layout
        names[number] = name
    return layouts, names, ticks, header.place


def _end(data: Bytes) -> tuple[int, list[str]]:
    """Return where the events end, and a finding if the checksum is not that of the file."""
    end = len(data) - CHECKSUM
    stored = int.from_bytes(data[end:], "little")
    if zlib.crc32(memoryview(data)[:end]) == stored:
        return end, []
    return len(data), [
        "its checksum is wrong: the log was cut off (power lost?), or values in it are damaged."
    ]


def _events(
    data: Bytes, layouts: dict[int, np.dtype], start: int, end: int
) -> tuple[dict[int, IntArray], int]:
    """Return the positions of all events by their number, and where the last one ends."""
    places = {number: array("q") for number in layouts}
    sizes = {number: layout.itemsize for number, layout in layouts.items()}
    place = start
    while place + 2 <= end:
        number = data[place] | data[place + 1] << 8
        size = sizes.get(number)
        if size is None or place + size > end:
            break
        places[number].append(place)
        place += size
    return {number: np.asarray(where) for number, where in places.items()}, place


def _messages(
    data: Bytes, name: str, layout: np.dtype, places: IntArray, order: IntArray, ticks: float
) -> Messages:
    """Return the events of one layout."""
    # A view with an event at every byte of the file: indexing copies the events of this layout.
    size = max(len(data) - layout.itemsize + 1, 0)
    events = np.ndarray((size,), layout, data, 0, (1,))[places]
    columns = {key: events[key].astype(float) for key in (layout.names or ())[2:]}
    units = {key: unit for key in columns if (unit := _unit(key))}
    return Messages(name, order, events[TIME] / ticks, columns, units=units)


def _unit(variable: str) -> str:
    for pattern, unit in UNITS.items():
        if re.fullmatch(pattern, variable):
            return unit
    return ""
