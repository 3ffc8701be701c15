"""MAVLink telemetry logs (.tlog), as ground stations write them: packets of one or several senders.

Packets with the sender's own time (``time_boot_ms``, ``time_usec``) have this time, which is free
of the jitter of the link. The others have their time of reception. Both are on one clock, which
starts with the vehicle.

Metadata of a telemetry log: firmware, parameters, texts, modes.

Finds the packets of a telemetry log; pymavlink decodes them and verifies their checksums.

Before every packet, 8 bytes have the time of reception, in µs since 1970, big-endian.
"""

import math
import mmap
import re
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavutil import interpret_px4_mode

from greybox.data.record import Recording
from greybox.files.arrays import (
    Array,
    BoolArray,
    IntArray,
)
from greybox.files.named_values import Values, non_empty, without
from greybox.files.progress import bar
from greybox.logs.readers import time_stamps
from greybox.logs.readers.ardupilot_metadata import mode_name, unit, vehicle_in
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.messages import MessageNames, Messages, bare, checksum_of, mapped, records

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


HULLS = {  # MAV_TYPE of a vehicle with ArduPilot, and its firmware
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), "ArduCopter"),
    **dict.fromkeys((1, 16, 19, 20, 21, 22, 23, 24, 25, 28), "ArduPlane"),
    **dict.fromkeys((10, 11), "ArduRover"),
    12: "ArduSub",
    7: "Blimp",
}
# MAV_PARAM_TYPE of the integers that PX4 sends byte by byte in the place of the float
INTEGERS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}


class Heartbeats(NamedTuple):
    """The heartbeats of the first autopilot: its sender, fields, and which of all they are.

    The sender is 256 · system + component, or -1 without a heartbeat; `autopilot` is its
    MAV_AUTOPILOT, or that of no autopilot.
    """

    sender: int
    autopilot: int
    fields: Mapping[str, Array]
    rows: BoolArray


def metadata(
    kinds: Mapping[str, Kind], times: Mapping[str, Array], beats: Heartbeats
) -> dict[str, Any]:
    """Return the metadata that were sent; `times` are those of each kind, (n,), s."""
    texts = ()
    if "STATUSTEXT" in kinds:
        written = kinds["STATUSTEXT"].texts["text"]
        texts = tuple(zip(times["STATUSTEXT"].tolist(), written, strict=True))
    firmware = _firmware(beats, [text for _, text in texts])
    return non_empty(
        {
            **firmware,
            "parameters": _parameters(kinds.get("PARAM_VALUE"), beats),
            "texts": texts,
            "modes": _modes(beats, times, firmware.get("vehicle", "")),
        }
    )


def heartbeats(kinds: Mapping[str, Kind]) -> Heartbeats:
    """Return the heartbeats of the first autopilot in the log."""
    nobody = Heartbeats(-1, mavlink.MAV_AUTOPILOT_INVALID, {}, np.zeros(0, dtype=bool))
    if "HEARTBEAT" not in kinds:
        return nobody
    senders = np.asarray(kinds["HEARTBEAT"].senders)
    fields = kinds["HEARTBEAT"].columns
    # Ground stations, cameras and gimbals send heartbeats, too.
    flying = (fields["autopilot"] != mavlink.MAV_AUTOPILOT_INVALID) & (
        fields["type"] != mavlink.MAV_TYPE_GCS
    )
    if not flying.any():
        return nobody
    first = flying.argmax()
    sender = int(senders[first])
    # Modes of another vehicle on the same link are not those of this one.
    rows = flying & (senders == sender)

    autopilot = int(fields["autopilot"][first])
    return Heartbeats(sender, autopilot, {name: x[rows] for name, x in fields.items()}, rows)


def _firmware(beats: Heartbeats, texts: Sequence[str]) -> Mapping[str, str]:
    for text in texts:
        if vehicle := vehicle_in(text):
            return {"vehicle": vehicle, "firmware": text}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return {"vehicle": "PX4"}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return {"vehicle": HULLS.get(int(beats.fields["type"][0]), "ArduPilot")}

    return {}


def _parameters(sent: Kind | None, beats: Heartbeats) -> Values:
    """Return the last value of every parameter."""
    if sent is None:
        return {}
    values = sent.columns["param_value"].tolist()
    # PX4 sends the bytes of an integer, ArduPilot its value.
    if beats.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        codes = [INTEGERS.get(int(kind), "f") for kind in sent.columns["param_type"]]
        values = [
            float(struct.unpack_from(f"<{code}", struct.pack("<f", value))[0])
            for code, value in zip(codes, values, strict=True)
        ]

    return dict(zip(sent.texts["param_id"], values, strict=True))


def _modes(
    beats: Heartbeats, times: Mapping[str, Array], vehicle: str
) -> tuple[tuple[float, str], ...]:
    """Return (time, name) at every change."""
    modes: list[tuple[float, str]] = []
    if not beats.rows.any():
        return ()
    moments = times["HEARTBEAT"][beats.rows].tolist()
    states = (beats.fields[name].astype(int).tolist() for name in ("base_mode", "custom_mode"))
    for time, base, custom in zip(moments, *states, strict=True):
        name = interpret_px4_mode(base, custom) if vehicle == "PX4" else mode_name(vehicle, custom)
        # Every heartbeat has the mode, and only changes matter.
        if not modes or modes[-1][1] != name:
            modes.append((time, name))
    return tuple(modes)


ABOUT = ("HEARTBEAT", "PARAM_VALUE", "STATUSTEXT")  # the metadata are made of these
SENDER = "sender"  # the text column that distinguishes senders and instances


def read(path: Path, messages: MessageNames = None) -> Recording:
    """Read a MAVLink telemetry log.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Kinds to read, e.g. ``("ATTITUDE",)``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Values as sent, units from the MAVLink definitions (cdeg, mm ...). A kind that several
        systems or components send is named ``ATTITUDE[1:1]`` (system:component), one with instances
        of its own ``BATTERY_STATUS[0]``.

    Raises
    ------
    ValueError
        If the file contains no MAVLink packet that can be read.
    OSError
        If the file cannot be opened.
    """
    messages = bare(messages)
    checksum = checksum_of(path)
    packets = Packets(mapped(path))
    kinds: dict[str, Kind] = {}
    first_received = 0.0  # µs
    for number, (received, packet) in enumerate(packets):
        name = packet.get_type()
        if name not in kinds:
            is_stored = messages is None or name in (*ABOUT, *messages)
            kinds[name] = Kind(type(packet), is_stored)
        first_received = first_received or received
        kinds[name].append(number, received, packet)
    if not kinds:
        raise ValueError(
            f"{path} holds no MAVLink packet that can be read; copy it from the ground station "
            "again."
        )

    # Times count from the start of the vehicle, or else of another sender, or from the first
    # packet.
    stamps, boots = _clocks(kinds)
    beats = heartbeats(kinds)
    zero, *_ = boots.get(beats.sender) or next(iter(boots.values()), [first_received])
    times = {name: (stamps[kind.numbers] - zero) / 1e6 for name, kind in kinds.items()}
    about = metadata(kinds, times, beats)
    wanted = [
        name for name in kinds if (name not in ABOUT[1:] if messages is None else name in messages)
    ]
    untimed = sorted(name for name in wanted if not np.isfinite(kinds[name].sent).any())
    without_stamps = (
        [f"these carry no time stamp and are given their time of reception: {', '.join(untimed)}."]
        if untimed
        else []
    )
    missing = [name for name in messages or () if name not in kinds]
    present = ", ".join(sorted(kinds))
    # One kind after the other is released: the columns of a long log fill the memory.
    groups = (_messages(kinds.pop(name), times.pop(name)) for name in wanted)
    by_name, problems = records(
        with_holds(groups, about.get("parameters", {})), path.name, checksum
    )
    restarted = (
        f"sender {_address(sender)} restarted at {(start - zero) / 1e6:.1f} s; its clock continues "
        "there."
        for sender, starts in boots.items()
        for start in starts[1:]
    )
    findings = (
        *_damage(packets),
        *restarted,
        *(f"there is no message {name}; the log has {present}." for name in missing),
        *without_stamps,
        *problems,
    )

    return Recording(by_name, path.name, checksum, about, findings)


def _clocks(kinds: Mapping[str, Kind]) -> tuple[Array, dict[int, list[float]]]:
    """Return the time of every packet by its number, and the start of every boot of each sender.

    All times are in µs since 1970.
    """
    numbers, senders, received, sent = (
        np.concatenate([getattr(kind, name) for kind in kinds.values()])
        for name in ("numbers", "senders", "received", "sent")
    )
    stamps = np.full(1 + numbers.max(initial=-1), np.nan)
    stamps[numbers] = received
    # A restart shows in the order in which the packets came, whatever their kinds.
    order = np.argsort(numbers)
    order = order[np.isfinite(sent[order])]

    boots: dict[int, list[float]] = {}
    for sender in np.unique(senders[order]).tolist():
        rows = order[senders[order] == sender]
        for boot in np.split(rows, time_stamps.restarts(sent[rows])):
            # The median is insensitive to the jitter of the link.
            start = float(np.median(received[boot] - 1e6 * sent[boot]))
            boots.setdefault(sender, []).append(start)
            stamps[numbers[boot]] = start + 1e6 * sent[boot]

    return stamps, boots


def _messages(kind: Kind, time: Array) -> Messages:
    """Return the packets of one kind, in the order of their times: a link may deliver them late."""
    texts = {**kind.texts}
    columns = without(kind.columns, TICKS)
    units = kind.definition.fieldunits_by_name
    instance = kind.definition.instance_field
    labels = _labels(np.asarray(kind.senders), texts.get(instance), columns.pop(instance, None))
    if labels:
        texts[SENDER] = labels

    messages = Messages(
        kind.definition.msgname,
        np.asarray(kind.numbers),
        time,
        columns,
        texts,
        {label: unit(units.get(label.partition("[")[0], "")) for label in columns},
        SENDER if labels else "",
    )
    if np.all(np.diff(time) >= 0):
        return messages

    return messages.rows(np.argsort(time, kind="stable"))


def _labels(senders: IntArray, names: Sequence[str] | None, instances: Array | None) -> list[str]:
    """Return the parts of ``system:component:instance`` that differ between packets, if any."""
    # Equal labels share one text: a log has millions.
    addresses = {sender: _address(sender) for sender in np.unique(senders).tolist()}
    columns = [[addresses[sender] for sender in senders.tolist()]] if len(addresses) > 1 else []
    if instances is not None:
        names = [f"{value:g}" for value in instances]
    columns += [] if names is None else [names]
    return [":".join(parts) for parts in zip(*columns, strict=True)]


def _address(sender: int) -> str:
    return f"{sender >> 8}:{sender & 0xFF}"


def _damage(packets: Packets) -> Iterator[str]:
    if packets.skipped:
        yield f"{packets.skipped} bytes in {packets.places} places are damaged and were skipped."
    if packets.unknown:
        yield f"{packets.unknown} packets of kinds that pymavlink does not know were left out."
