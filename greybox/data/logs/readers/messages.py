"""From messages to records: one per instance, on one clock, with increasing times."""

import hashlib
import mmap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values
from greybox.data.files.wording import counted
from greybox.data.logs.readers import time_stamps
from greybox.data.record import Record

MessageNames = Collection[str] | None  # all if None


@frozen
class Messages:
    """All messages of one type, column by column.

    Attributes
    ----------
    name : str
    order : (n,) array
        Number of each among all messages of the file.
    time : (n,) array, s, or None
        On the log's clock; None when the messages have no time.
    columns : mapping of str to (n,) array
        Numeric columns, without the time.
    texts : mapping of str to sequence of str
        Columns of text.
    units : mapping of str to str
    hold : mapping of str to float
        For how long the values of a column lasted, if known, see `greybox.data.intersample`.
    instance : str
        The column, of numbers or text, that distinguishes several senders; empty for one sender.
    """

    name: str
    order: IntArray
    time: Array | None
    columns: Mapping[str, Array]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    instance: str = ""
    hold: Values = field(default_factory=dict)

    def __len__(self) -> int:
        return self.order.size

    def rows(self, rows: IntArray) -> "Messages":
        """Return the messages of these indices."""
        return replace(
            self,
            order=self.order[rows],
            time=None if self.time is None else self.time[rows],
            columns={name: values[rows] for name, values in self.columns.items()},
            texts={name: [values[i] for i in rows] for name, values in self.texts.items()},
        )


def mapped(path: Path) -> mmap.mmap:
    """Return the bytes of a log: the system reads only pages that are needed, and releases them."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def checksum_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def bare(messages: MessageNames) -> tuple[str, ...] | None:
    """Return names without instances: a request for ``IMU[0]`` reads all of IMU."""
    return None if messages is None else unique(name.partition("[")[0] for name in messages)


def on_one_clock(groups: Sequence[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Return the messages on one clock that never restarts, and findings; see `time_stamps`."""
    timed = [group for group in groups if group.time is not None and len(group)]
    # In the order of the file, in which restarts show across all types of messages.
    stamps = np.full(max((1 + int(group.order.max()) for group in timed), default=0), np.nan)
    for group in timed:
        stamps[group.order] = group.time
    shifted, findings = time_stamps.one_clock(stamps)
    return [
        group if group.time is None else replace(group, time=shifted[group.order])
        for group in groups
    ], findings


def records(
    groups: Iterable[Messages], source: str, checksum: str
) -> tuple[dict[str, Record], tuple[str, ...]]:
    """Return a record for every type and instance with a time and a number, and findings."""
    by_name: dict[str, Record] = {}
    findings: list[str] = []
    for name, part in chain.from_iterable(map(_instances, groups)):
        if part.time is None:
            findings.append(f"{name}: its {len(part)} messages have no time and were left out.")
            continue
        record = _record(name, part, source, checksum)
        if record is None:
            findings.append(
                f"{name}: none of its {len(part)} messages has a plausible time; it was left out."
            )
            continue
        by_name[name] = record
        findings += record.findings

    return by_name, (*findings, *_gaps(by_name))


def _gaps(by_name: Mapping[str, Record]) -> list[str]:
    """Return findings on the gaps of regular messages; many gaps at once are one finding."""
    texts = []
    longest = []
    for name, record in by_name.items():
        steps = np.diff(record.time)
        wide = record.clock.holes.size
        # 20 steps show the usual one. A message with gaps in 5 % of its steps comes irregularly.
        if steps.size >= 20 and 0 < wide <= 0.05 * steps.size:
            start = record.time[steps.argmax()]
            texts.append(
                f"{name}: {counted(wide, 'gap')}, the longest {steps.max():.3g} s at {start:.1f} s."
            )
            longest.append(steps.max())
    # Gaps in many messages have one cause: logging stopped.
    if len(texts) <= 3:
        return texts

    return [f"{len(texts)} messages have gaps. {texts[np.argmax(longest)]}"]


def _instances(group: Messages) -> Iterator[tuple[str, Messages]]:
    """Yield the instances as NAME[0], NAME[1] in order, or the group if it has none or no time."""
    if not group.columns or not len(group):
        return
    if not group.instance or group.time is None:
        yield group.name, group
        return
    # Telemetry distinguishes senders by a text, DataFlash by a number.
    values = np.array({**group.columns, **group.texts}[group.instance])
    columns = {name: column for name, column in group.columns.items() if name != group.instance}

    for value in np.unique(values).tolist():
        label = value if isinstance(value, str) else f"{value:g}"
        part = replace(group, columns=columns).rows(np.flatnonzero(values == value))
        yield f"{group.name}[{label}]", part


def _record(name: str, part: Messages, source: str, checksum: str) -> Record | None:
    assert part.time is not None
    rows = time_stamps.increasing(part.time)
    if not rows.size:
        return None
    time = part.time
    columns = part.columns
    findings = ()
    dropped = time.size - rows.size
    if dropped:
        wrong = np.count_nonzero(~np.isfinite(time))
        reasons = [f"{wrong} with implausible times"] if wrong else []
        reasons += [f"{dropped - wrong} whose time does not increase"] if dropped > wrong else []
        has_several = 2 * dropped > time.size + wrong
        cure = "; save each run, or each device, in a file of its own" if has_several else ""
        findings = (
            f"{name}: {dropped} of {time.size} samples dropped: {', '.join(reasons)}{cure}.",
        )
        time = time[rows]
        columns = {column: values[rows] for column, values in columns.items()}
    for values in (time, *columns.values()):
        # A record copies arrays that could still be changed.
        values.setflags(write=False)
    units = {column: part.units.get(column, "") for column in columns}
    # The number of an instance is no signal, whichever column a damaged log says it is.
    hold = {column: period for column, period in part.hold.items() if column in columns}

    return Record(time, columns, units, name, source, checksum, hold=hold, findings=findings)
