"""From the messages of a log of any format to records: one per instance, on one clock, with increasing times."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from greybox.data.record import Record
from greybox.files.arrays import Array, IntArray
from greybox.logs.readers import time_stamps


@dataclass(frozen=True, eq=False)
class Messages:
    """All messages of one type, column by column.

    Attributes
    ----------
    name : str
    order : (n,) array
        Number of each among all messages of the file, of the timed ones among these.
    time : (n,) array, s, or None
        On the log's clock; None when the messages have no time.
    columns : mapping of str to (n,) array
        Numeric columns, without the time.
    texts : mapping of str to sequence of str
        Columns of text.
    units : mapping of str to str
    hold : mapping of str to float
        For how long the values of a column lasted, as far as that is known, see
        `greybox.data.intersample`.
    instance : str
        The column, numeric or text, that distinguishes several senders; empty if there is one.
    """

    name: str
    order: IntArray
    time: Array | None
    columns: Mapping[str, Array]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    instance: str = ""
    hold: Mapping[str, float] = field(default_factory=dict)

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


def bare(messages: Collection[str] | None) -> tuple[str, ...] | None:
    """Return names without instances: a request for ``IMU[0]`` reads all of IMU."""
    return (
        None
        if messages is None
        else tuple(dict.fromkeys(name.partition("[")[0] for name in messages))
    )


def merged(groups: Iterable[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Join messages of one name that the log describes twice if their columns agree; otherwise keep the larger lot."""
    by_name: dict[str, list[Messages]] = {}
    for group in groups:
        by_name.setdefault(group.name, []).append(group)

    joined = []
    findings = []
    for name, lots in by_name.items():
        largest = max(lots, key=len)
        alike = [lot for lot in lots if _alike(lot, largest)]
        lost = sum(map(len, lots)) - sum(map(len, alike))
        if lost:
            findings.append(
                f"{name}: {lost} messages with other fields than the rest were left out."
            )
        joined.append(_joined(alike) if len(alike) > 1 else largest)
    return joined, tuple(findings)


def _alike(a: Messages, b: Messages) -> bool:
    return (
        a.columns.keys() == b.columns.keys()
        and a.texts.keys() == b.texts.keys()
        and (a.time is None) == (b.time is None)
    )


def _joined(lots: Sequence[Messages]) -> Messages:
    order = np.concatenate([lot.order for lot in lots])
    texts = {name: [text for lot in lots for text in lot.texts[name]] for name in lots[0].texts}
    columns = {
        name: np.concatenate([lot.columns[name] for lot in lots]) for name in lots[0].columns
    }
    time = (
        None
        if lots[0].time is None
        else np.concatenate([lot.time for lot in lots if lot.time is not None])
    )
    return replace(lots[0], order=order, time=time, columns=columns, texts=texts).rows(
        np.argsort(order)
    )


@dataclass(frozen=True, eq=False)
class Clocked:
    """Messages on one clock that never restarts, what was found, and the first and last time of the log, s."""

    groups: list[Messages]
    findings: tuple[str, ...]
    span: tuple[float, float]


def on_one_clock(groups: Iterable[Messages], stamps: Array | None = None) -> Clocked:
    """Put all timed messages on one clock that never restarts; see `time_stamps.one_clock`.

    The `stamps` are the times of all messages of the log by their number, where not all are among
    the groups.
    """
    groups = list(groups)
    stamps = stamps_of(groups) if stamps is None else stamps
    shifted, findings = time_stamps.one_clock(stamps)
    if shifted is not stamps:
        groups = [
            group if group.time is None else replace(group, time=shifted[group.order])
            for group in groups
        ]
    finite = np.isfinite(shifted)
    span = (
        float(shifted.min(where=finite, initial=np.inf)),
        float(shifted.max(where=finite, initial=-np.inf)),
    )
    return Clocked(groups, findings, span if finite.any() else (0.0, 0.0))


def stamps_of(groups: Iterable[Messages]) -> Array:
    """Return the times of all messages by their number, NaN for those without."""
    timed = [group for group in groups if group.time is not None and len(group)]
    stamps = np.full(max((1 + int(group.order.max()) for group in timed), default=0), np.nan)
    for group in timed:
        stamps[group.order] = group.time
    return stamps


def records(
    groups: Iterable[Messages], source: str, checksum: str
) -> tuple[dict[str, Record], tuple[str, ...]]:
    """Return a record for every type and instance with a time and a number, and findings.

    A list of groups is emptied, so that no column is in memory twice.
    """
    by_name: dict[str, Record] = {}
    findings: list[str] = []
    gapped: dict[str, time_stamps.Gaps] = {}
    for name, part in chain.from_iterable(map(_instances, _consumed(groups))):
        if part.time is None:
            findings.append(f"{name}: its {len(part)} messages have no time and were left out.")
            continue
        record = _record(name, part, source, checksum, gapped)
        if record is None:
            findings.append(
                f"{name}: none of its {len(part)} messages has a plausible time; it was left out."
            )
            continue
        by_name[name] = record
        findings += [
            text
            for text in record.findings
            if name not in gapped or text != f"{name}: {gapped[name]}"
        ]
    return by_name, (*findings, *time_stamps.all_gaps(gapped))


def _consumed(groups: Iterable[Messages]) -> Iterator[Messages]:
    if not isinstance(groups, list):
        yield from groups
        return
    groups.reverse()
    while groups:
        yield groups.pop()


def _instances(group: Messages) -> Iterator[tuple[str, Messages]]:
    """Yield the instances as NAME[0], NAME[1] in order; a single nameless one without brackets, as without a time."""
    if not group.columns or not len(group):
        return
    if not group.instance or group.time is None:
        yield group.name, group
        return
    labels = group.texts.get(group.instance)
    values = np.array(labels) if labels is not None else group.columns[group.instance]
    columns = {name: column for name, column in group.columns.items() if name != group.instance}
    without_columns, name = replace(group, columns={}), group.name
    del group  # whose columns go one by one
    rows = {value: np.flatnonzero(values == value) for value in np.unique(values).tolist()}
    split: dict[object, dict[str, Array]] = {value: {} for value in rows}
    for column in list(columns):
        values_of_all = columns.pop(column)
        for value, places in rows.items():
            split[value][column] = values_of_all[places]
    for value, places in rows.items():
        label = str(value) if labels is not None else f"{value:g}"
        yield f"{name}[{label}]", replace(without_columns.rows(places), columns=split.pop(value))


def _record(
    name: str, part: Messages, source: str, checksum: str, gapped: dict[str, time_stamps.Gaps]
) -> Record | None:
    """Return a record, and put its gaps among those of the others."""
    assert part.time is not None
    rows = time_stamps.increasing(part.time)
    if not rows.size:
        return None
    time = part.time
    columns = part.columns
    findings = ()
    if rows.size < time.size:
        findings = (_dropped(name, time.size - rows.size, time),)
        time = time[rows]
        columns = {column: values[rows] for column, values in columns.items()}
    for values in (time, *columns.values()):
        values.setflags(write=False)  # a record keeps, without a copy, what nobody can change
    units = {column: part.units.get(column, "") for column in columns}
    gaps = time_stamps.gaps(time)
    if gaps is not None:
        gapped[name] = gaps
        findings += (f"{name}: {gaps}",)
    return Record(time, columns, units, name, source, checksum, hold=part.hold, findings=findings)


def _dropped(name: str, dropped: int, time: Array) -> str:
    wrong = int(np.count_nonzero(~np.isfinite(time)))
    reasons = [f"{wrong} with implausible times"] if wrong else []
    reasons += [f"{dropped - wrong} whose time does not increase"] if dropped > wrong else []
    return f"{name}: {dropped} of {time.size} samples dropped: {', '.join(reasons)}."
