"""MAVLink telemetry logs (.tlog), as ground stations write them: packets of one or several senders.

Packets with the sender's own time (``time_boot_ms``, ``time_usec``) have this time, which is free
of the jitter of the link. The others have their time of reception. Both are on one clock, which
starts with the vehicle.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.named_values import without
from greybox.data.logs.readers import time_stamps
from greybox.data.logs.readers.ardupilot_metadata import unit
from greybox.data.logs.readers.controller_outputs import with_holds
from greybox.data.logs.readers.messages import (
    MessageNames,
    Messages,
    bare,
    checksum_of,
    mapped,
    records,
)
from greybox.data.logs.readers.telemetry_metadata import heartbeats, metadata
from greybox.data.logs.readers.telemetry_packets import TICKS, Kind, Packets
from greybox.data.record import Recording

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
