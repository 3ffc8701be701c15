"""The packets of a telemetry log; pymavlink decodes them and verifies their checksums.

Before every packet, 8 bytes have the time of reception, in µs since 1970, big-endian.
"""

import math
import mmap
import re
from array import array
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from greybox.data.files.arrays import Array
from greybox.data.files.progress import bar

STAMP = 8  # bytes of time before a packet
MARK = re.compile(b"[\xfd\xfe]")  # the first byte of a packet of MAVLink 2 or 1
TICKS = {"time_boot_ms": 1e3, "time_boot_us": 1e6, "time_usec": 1e6}  # sender's ticks per second


class Packets:
    """The packets of a file; iteration counts the damaged bytes.

    Attributes
    ----------
    skipped, places : int
        Bytes that belong to no packet, and the number of places where they are.
    unknown : int
        Packets of kinds that pymavlink does not know.
    """

    def __init__(self, data: mmap.mmap) -> None:
        self.skipped = 0
        self.places = 0
        self.unknown = 0
        self._data = data
        self._link = mavlink.MAVLink(None)

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Yield the time of reception, µs since 1970, and the packet."""
        end = 0  # of the previous packet
        at = STAMP
        with bar(total=len(self._data), desc="reading packets", unit="B", unit_scale=True) as shown:
            while mark := MARK.search(self._data, at):
                at = mark.start()
                packet, following = self._decoded(at, is_expected=at == end + STAMP)
                if packet is None:
                    at += 1
                    continue
                self._count_damage(end, at - STAMP)
                if isinstance(packet, mavlink.MAVLink_unknown):
                    self.unknown += 1
                else:
                    # Some ground stations use the highest bit as a flag.
                    yield int.from_bytes(self._data[at - STAMP : at], "big") & 2**63 - 1, packet
                end = following
                at = end + STAMP
                if at - shown.n > 2**20:
                    shown.update(at - shown.n)
        self._count_damage(end, len(self._data))

    def _count_damage(self, start: int, end: int) -> None:
        self.skipped += end - start
        self.places += end > start

    def _decoded(self, at: int, is_expected: bool) -> tuple[Any, int]:
        """Return the packet at a byte, None for none, and where it ends."""
        head = self._data[at : at + 3]
        if len(head) < 3:
            return None, at
        signature = 13 * (head[2] & mavlink.MAVLINK_IFLAG_SIGNED)
        end = at + head[1] + (8 if head[0] == 0xFE else 12 + signature)
        try:
            packet = self._link.decode(bytearray(self._data[at:end]))
        except (mavlink.MAVError, UnicodeError):
            return None, at
        # The checksum of an unknown packet cannot be verified, so it counts only between other
        # packets.
        is_sound = not isinstance(packet, mavlink.MAVLink_unknown) or (
            is_expected and (end == len(self._data) or MARK.match(self._data, end + STAMP))
        )
        return (packet, end) if is_sound else (None, at)


class Kind:
    """The packets of one kind: their senders, their times, and their fields if they are stored.

    Attributes
    ----------
    definition : type
        pymavlink's class of the message.
    numbers, senders : (n,) array
        Number of each packet among all packets of the file, and 256 · system + component.
    received, sent : (n,) array
        Time of reception, µs since 1970; time since the sender's start by its own clock, s, NaN
        without one.
    texts : dict of str to list of str
        The fields of text.
    """

    def __init__(self, definition: Any, is_stored: bool) -> None:
        self.definition = definition
        self.texts: dict[str, list[str]] = {}
        self.timer = next((name for name in TICKS if name in definition.fieldnames), "")
        self._is_stored = is_stored
        self._labels: list[str] = []
        self.numbers = array("q")
        self.senders = array("H")
        self.received = array("d")
        self.sent = array("d")
        self._values = array("d")

    def append(self, number: int, received: float, packet: Any) -> None:
        """Append a packet, unless its kind is neither timed nor stored."""
        if not (self.timer or self._is_stored):
            return
        self.numbers.append(number)
        self.senders.append(packet.get_srcSystem() << 8 | packet.get_srcComponent())
        self.received.append(received)
        seconds = getattr(packet, self.timer) / TICKS[self.timer] if self.timer else math.nan
        # Some senders fill in zero, or the time since 1970 instead of that since their start.
        self.sent.append(seconds if 0 < seconds < 1e9 else math.nan)
        if not self._is_stored:
            return
        first = len(self.numbers) == 1
        for name in self.definition.fieldnames:
            value = getattr(packet, name)
            if isinstance(value, str):
                self.texts.setdefault(name, []).append(value)
            elif isinstance(value, list):
                self._values.extend(value)
                self._labels += [f"{name}[{i}]" for i in range(len(value))] if first else []
            else:
                self._values.append(value)
                self._labels += [name] if first else []

    @property
    def columns(self) -> Mapping[str, Array]:
        """The numeric fields, (n,) arrays; those of an array are ``name[0]``, ``name[1]``."""
        table = np.asarray(self._values).reshape(len(self.numbers), -1)
        return {label: table[:, k].copy() for k, label in enumerate(self._labels)}
