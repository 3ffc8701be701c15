"""MAVLink telemetry logs (.tlog), as ground stations write them: packets of one or several senders.

A packet that carries the sender's own time (``time_boot_ms``, ``time_usec``) is put there, without
the jitter of the link; the others are put where they were received. Both are on one clock, the
vehicle's since its first start.
"""

import hashlib
import mmap
import sys
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Recording
from greybox.files.arrays import Array
from greybox.logs.readers import telemetry_metadata, time_stamps
from greybox.logs.readers.ardupilot_metadata import unit
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.dataflash_index import text
from greybox.logs.readers.messages import Messages, bare, records
from greybox.logs.readers.telemetry_frames import KINDS, SAMPLED, Frames, find_packets, payloads

TICKS = {
    "time_boot_ms": 1e3,
    "time_boot_us": 1e6,
    "time_usec": 1e6,
}  # the sender's time, ticks per second
BLOCK = 2**16  # packets whose times are set at once
EPOCH = 1e9  # s; a larger time counts from 1970, not from the sender's start
ABOUT = ("PARAM_VALUE", "STATUSTEXT")  # part of the metadata; no time histories
SENDER = "sender"  # the text column that distinguishes senders and instances


def read(path: str | Path, messages: Collection[str] | None = None) -> Recording:
    """Read a MAVLink telemetry log.

    Parameters
    ----------
    path : str or Path
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
        If the file holds no MAVLink packet that can be read.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    messages = bare(messages)
    with open(path, "rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    frames = find_packets(data)
    if not frames.kinds.size:
        raise ValueError(
            f"{path} holds no MAVLink packet that can be read; copy it from the ground station again."
        )

    sender_time = _sender_times(data, frames)
    timed = np.unique(frames.kinds[np.isfinite(sender_time)])
    time, restarts = _common_clock(
        frames, sender_time, telemetry_metadata.vehicle_sender(data, frames)
    )
    del sender_time
    names = {kind: KINDS[kind].msgname for kind in np.unique(frames.kinds).tolist()}
    wanted = [
        k
        for k, name in names.items()
        if (name not in ABOUT if messages is None else name in messages)
    ]
    about = telemetry_metadata.metadata(data, frames, time)
    frames = frames.only(
        np.isin(frames.kinds, wanted)
    )  # the other packets of a long log fill hundreds of MB
    time = frames.received  # the common clock has put them there
    groups = (_messages(data, frames, kind, time) for kind in wanted)
    found, problems = records(with_holds(groups, about.get("parameters", {})), path.name, checksum)
    findings = (
        *_damage(frames),
        *restarts,
        *_missing(names.values(), messages),
        *_received(set(wanted) - set(timed.tolist())),
        *problems,
    )
    return Recording(found, path.name, checksum, about, findings)


def _sender_times(data: mmap.mmap, frames: Frames) -> Array:
    """Time of every packet by its sender's clock since the sender's start, s; NaN where it carries none."""
    sender_time = np.full(frames.kinds.size, np.nan)
    for kind in np.unique(frames.kinds).tolist():
        timer = next((name for name in TICKS if name in KINDS[kind].fieldnames), "")
        if timer:
            ticks = payloads(data, frames, kind, timer) / TICKS[timer]
            sender_time[frames.kinds == kind] = np.where(
                (ticks > 0) & (ticks < EPOCH), ticks, np.nan
            )
    return sender_time


def _common_clock(
    frames: Frames, sender_time: Array, vehicle: int
) -> tuple[Array, tuple[str, ...]]:
    """Return the time of every packet, s since the vehicle's first start, and where senders restarted.

    The median difference between reception and the sender's time is the sender's start; it changes
    when it restarts. These times take the place of the reception times: a log has ten million
    packets.
    """
    time = frames.received
    findings = []
    zero = None
    senders = np.unique(frames.senders).tolist()
    for sender in sorted(senders, key=lambda s: s != vehicle):
        rows = np.flatnonzero((frames.senders == sender) & np.isfinite(sender_time)).astype(
            frames.starts.dtype
        )
        starts = (0, *time_stamps.restarts(sender_time[rows]))
        for piece in np.split(rows, starts[1:]) if rows.size else ():
            some = piece[:: max(piece.size // SAMPLED, 1)]
            start = float(np.median(time[some] - sender_time[some]))
            zero = start if zero is None else zero
            for begin in range(0, piece.size, BLOCK):
                block = piece[begin : begin + BLOCK]
                time[block] = sender_time[block] + start
        findings += [
            f"sender {_address(sender)} restarted at {time[rows[i]] - (zero or 0.0):.1f} s; its clock continues there."
            for i in starts[1:]
        ]
    time -= float(time[0]) if zero is None else zero
    return time, tuple(findings)


def _messages(data: mmap.mmap, frames: Frames, kind: int, time: Array) -> Messages:
    """Return the packets of one kind, in the order of their times: a link may deliver them in another."""
    known = KINDS[kind]
    rows = np.flatnonzero(frames.kinds == kind)
    packets = payloads(data, frames, kind)
    if np.any(np.diff(time[rows]) < 0):
        sorting = np.argsort(time[rows], kind="stable")
        rows, packets = rows[sorting], packets[sorting]

    columns: dict[str, Array] = {}
    texts: dict[str, Sequence[str]] = {}
    units: dict[str, str] = {}
    for name in known.fieldnames:
        if name in TICKS:
            continue
        for label, values in _columns(name, packets[name]):
            if values.dtype.kind == "S":
                texts[label] = [text(value) for value in values.tolist()]
            else:
                columns[label] = values.astype(float)
                units[label] = unit(known.fieldunits_by_name.get(name, ""))

    labels = _labels(frames.senders[rows], known.instance_field, columns, texts)
    texts = {**texts, SENDER: labels} if labels else texts
    columns.pop(known.instance_field, None)
    return Messages(
        known.msgname, rows, time[rows], columns, texts, units, SENDER if labels else ""
    )


def _columns(name: str, values: NDArray[Any]) -> list[tuple[str, NDArray[Any]]]:
    """Return a field, or the elements of an array field as ``name[0]``, ``name[1]`` ..."""
    if values.ndim == 1:
        return [(name, values)]
    return [(f"{name}[{i}]", values[:, i]) for i in range(values.shape[1])]


def _labels(
    senders: NDArray[np.uint16],
    instance: str | None,
    columns: dict[str, Array],
    texts: dict[str, Sequence[str]],
) -> list[str]:
    """Return the labels of senders and instances of one kind; nothing if there is only one.

    Equal ones are one text in memory: a log has millions.
    """
    parts: list[Iterable[str]] = []
    if np.unique(senders).size > 1:
        parts.append(_address(int(sender)) for sender in senders)
    if instance in texts:
        parts.append(texts[instance])
    elif instance in columns:
        parts.append(f"{value:g}" for value in columns[instance])
    return [sys.intern(":".join(part)) for part in zip(*parts, strict=True)]


def _address(sender: int) -> str:
    return f"{sender >> 8}:{sender & 0xFF}"


def _received(untimed: Collection[int]) -> tuple[str, ...]:
    """Say which kinds have their reception time."""
    names = [KINDS[kind].msgname for kind in sorted(untimed)]
    if not names:
        return ()
    return (
        f"these carry no time stamp and are given their time of reception: {', '.join(names)}.",
    )


def _missing(present: Collection[str], messages: Collection[str] | None) -> tuple[str, ...]:
    absent = [name for name in messages or () if name not in present]
    return tuple(
        f"there is no message {name}; the log has {', '.join(present)}." for name in absent
    )


def _damage(frames: Frames) -> tuple[str, ...]:
    findings = []
    if frames.skipped:
        findings.append(
            f"{frames.skipped} bytes in {frames.places} places are damaged and were skipped."
        )
    if frames.unknown:
        findings.append(
            f"{frames.unknown} packets of kinds that pymavlink does not know were left out."
        )
    return tuple(findings)
