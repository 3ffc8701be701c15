"""Finds the messages in a DataFlash log, damaged ones included.

pymavlink has a compiled scan, but it terminates the Python process at the first message of an
unknown type or length, and prints a line for every byte that it skips. This scan is about as fast,
silent, and returns the damaged places. The table of format letters is that of pymavlink.
"""

import mmap
import struct

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.logs.readers.dataflash_layout import Layout, sound_layout

Bytes = bytes | mmap.mmap
HEAD = b"\xa3\x95"  # before every message; the number of its type follows
FMT = 0x80  # the message that describes the others: type, length, name, format, columns
FMT_LENGTH = 89
FMT_BODY = struct.Struct("<BB4s16s64s")

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
