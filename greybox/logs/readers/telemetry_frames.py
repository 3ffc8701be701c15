"""Finds the packets in a telemetry log and decodes their fields in bulk; 8 bytes of reception time precede each.

Names, types, units and checksums are from pymavlink's table of MAVLink messages.
"""

import mmap
import re
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.files.progress import reading
from greybox.logs.readers.mapped_file import release

PIECE = 2**20  # bytes after which the bar moves on
WINDOW = (
    2**23
)  # bytes of which packets are decoded at once: the file is mapped, and what was touched is in memory
SAMPLED = 10_000  # stamps whose median is the middle of the log: of all of them it would take twice their memory
STAMP = 8  # bytes of time before a packet: µs since 1970, big-endian
MARK = re.compile(b"[\xfd\xfe]")  # the first byte of a packet of MAVLink 2 or 1
SIGNED = 1
SIGNATURE = 13  # flag and length of a signed packet
TYPES = {
    **{
        f"{sign}int{bits}_t": f"<{sign or 'i'}{bits // 8}"
        for sign in ("", "u")
        for bits in (8, 16, 32, 64)
    },
    "float": "<f4",
    "double": "<f8",
    "char": "S",
}
KINDS: Mapping[int, Any] = mavlink.mavlink_map


@dataclass(frozen=True, eq=False)
class Frames:
    """All sound packets in the order of the file, and what was wrong.

    Attributes
    ----------
    kinds, senders, starts, lengths : (n,) array
        Message number, 256 · system + component, and where the payload lies, bytes; small ones,
        since a log has a packet every 50 bytes.
    received : (n,) array, s
        Reception time, from the middle of the log.
    skipped, places : int
        Bytes that belong to no packet, in how many places.
    unknown : int
        Packets of kinds that pymavlink does not know.
    """

    kinds: NDArray[np.uint32]
    senders: NDArray[np.uint16]
    starts: IntArray
    lengths: NDArray[np.uint8]
    received: Array
    skipped: int
    places: int
    unknown: int

    def only(self, chosen: BoolArray) -> "Frames":
        """Return some packets, chosen (n,), of the same file."""
        arrays = ("kinds", "senders", "starts", "lengths", "received")
        return replace(self, **{name: getattr(self, name)[chosen] for name in arrays})


def find_packets(data: mmap.mmap) -> Frames:
    """Find every packet in `data` whose checksum is right."""
    size = len(data)
    kinds, senders, lengths, stamps = array("I"), array("H"), array("B"), array("q")
    starts = array("I" if size < 2**32 else "q")
    at = 0
    skipped = 0
    places = 0
    unknown = 0
    bar, seen = reading(size, "finding packets"), 0
    while at + STAMP < size:
        if at - seen > PIECE:
            bar.update(at - seen)
            release(data, seen, at)
            seen = at
        frame = _frame(data, at + STAMP)
        if frame is None:
            next_packet = _next_sound(data, at + STAMP + 1) - STAMP
            skipped += next_packet - at
            places += 1
            at = next_packet
            continue

        kind, sender, start, length, end = frame
        if kind in KINDS:
            kinds.append(kind)
            senders.append(sender)
            starts.append(start)
            lengths.append(length)
            stamps.append(int.from_bytes(data[at : at + STAMP], "big") & 2**63 - 1)
        else:
            unknown += 1
        at = end

    bar.close()
    ticks = np.asarray(stamps)
    if ticks.size:  # 53 bits would not hold µs since 1970 in s
        ticks -= np.int64(np.median(ticks[:: max(ticks.size // SAMPLED, 1)]))
    received = np.divide(ticks, 1e6, out=ticks.view(float))
    where = np.asarray(starts), np.asarray(lengths)
    return Frames(
        np.asarray(kinds), np.asarray(senders), *where, received, skipped, places, unknown
    )


def _frame(data: mmap.mmap, at: int) -> tuple[int, int, int, int, int] | None:
    """Return kind, sender, payload start and length, and end of the packet at `at`; None if there is no sound one."""
    head = data[at : at + 10]
    if len(head) < 8:
        return None
    if head[0] == 0xFE:
        kind = head[5]
        sender = head[3] << 8 | head[4]
        start = at + 6
        tail = 2
    elif head[0] == 0xFD and len(head) == 10 and head[2] in (0, SIGNED):
        kind = int.from_bytes(head[7:10], "little")
        sender = head[5] << 8 | head[6]
        start = at + 10
        tail = 2 + SIGNATURE * head[2]
    else:
        return None

    stop = start + head[1]
    if stop + tail > len(data):
        return None
    if kind in KINDS:
        crc = mavlink.x25crc(data[at + 1 : stop] + bytes((KINDS[kind].crc_extra,))).crc
        sound = crc == data[stop] | data[stop + 1] << 8
    else:
        sound = _starts(
            data, stop + tail + STAMP
        )  # the checksum of an unknown kind cannot be checked
    return (kind, sender, start, head[1], stop + tail) if sound else None


def _starts(data: mmap.mmap, at: int) -> bool:
    return at - STAMP == len(data) or data[at : at + 1] in (b"\xfd", b"\xfe")


def _next_sound(data: mmap.mmap, at: int) -> int:
    """Return where the next packet of a known kind with a right checksum starts; the end and a stamp without one."""
    for mark in MARK.finditer(data, at):
        frame = _frame(data, mark.start())
        if frame and frame[0] in KINDS:
            return mark.start()
    return len(data) + STAMP


@cache
def layout(kind: int) -> np.dtype:
    """Return the payload of one kind as a packed numpy type, with the fields in the order of the wire."""
    known = KINDS[kind]
    types = dict(zip(known.fieldnames, known.fieldtypes, strict=True))
    fields = []
    for name, count in zip(known.ordered_fieldnames, known.array_lengths, strict=True):
        code = TYPES[types[name]]
        if code == "S":
            fields.append((name, f"S{count or 1}"))
        else:
            fields.append((name, code, (count,)) if count else (name, code))
    return np.dtype(fields)


def payloads(data: mmap.mmap, frames: Frames, kind: int, field: str = "") -> NDArray[Any]:
    """Return the packets of one kind, structured, or one field of them; what a packet leaves out at its end is zero."""
    chosen = frames.kinds == kind
    starts = frames.starts[chosen]
    lengths = frames.lengths[chosen]
    dtype = layout(kind)
    raw = np.frombuffer(data, dtype=np.uint8)
    found = np.empty(starts.size, dtype[field] if field else dtype)
    edges = np.append(np.arange(0, len(data), WINDOW), len(data))
    ends = np.searchsorted(starts, edges.astype(starts.dtype)).tolist()
    for begin, (first, last) in zip(edges.tolist(), pairwise(ends), strict=False):
        here = slice(first, last)
        rows = np.zeros((here.stop - here.start, dtype.itemsize), dtype=np.uint8)
        for length in np.unique(lengths[here]):
            same = lengths[here] == length
            width = min(int(length), dtype.itemsize)
            if width:
                rows[same, :width] = np.lib.stride_tricks.sliding_window_view(raw, width)[
                    starts[here][same]
                ]
        packets = rows.view(dtype)[:, 0]
        found[here] = packets[field] if field else packets
        release(data, begin, begin + 2 * WINDOW)  # the last packet of a window ends in the next one
    return found
