"""Measured time histories: one experiment on one time base, and all records of a log file."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property
from itertools import chain
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.checked_array import (
    checked_array,
    out_of_range,
    require,
    require_size,
    within_range,
)
from greybox.data.checksum import checksum_of
from greybox.data.clock import Clock, Gaps, clock_of, described_gaps, lost_rows, require_gaps
from greybox.data.dates import seconds_from_first
from greybox.data.files.arrays import Array, BoolArray, IntArray, Interval
from greybox.data.files.control_characters import all_printable, write_out
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.named_values import Values, array_of, attributes, selected
from greybox.data.files.normalization import normalize
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.spelling import alternatives, nearest
from greybox.data.files.wording import counted, some
from greybox.data.headings import BETWEEN, units_and_holds
from greybox.data.intersample import checked_hold
from greybox.data.pandas_frames import Frame, frame_of, require_frame, table_of
from greybox.data.units import AmbiguousUnitError, to_si

NOT_STORED = {"stored": False}  # in the file of a fit


@frozen
class Record(Printed):
    """One experiment: named signals on one time base, or rows without one.

    Parameters
    ----------
    time : (n,) array, s, or None
        Strictly increasing; dates and time differences count from the first. None for rows that
        have no order in time, as in a table of independent measurements: `time` is then the number
        of each row, `has_time` is False, and only static models can be fitted.
    signals : mapping of name to (n,) array
        Real numbers. NaN or the mask of a masked array marks a missing sample. Values beyond ±1e75
        become NaN, and values below 1e-75 become zero: their sums of squares would overflow or
        vanish.
    units : mapping of name to str
        SI units after `prepare`; before, those of the log.
    name, source : str
        A label, and the name of the file.
    checksum : str
        SHA-256 of that file; by default, of the numbers.
    metadata : mapping
        Vehicle, firmware, parameters and the like, from the log.
    filters : mapping of signal name to tuple
        Known filters that a signal has passed before it was logged, for a model to include.
    hold : mapping of signal name to float, s
        For how long each value lasted, if known, see `greybox.data.intersample`: infinity for a
        signal that keeps its value until the next sample, such as the output of a controller; 0 for
        samples of a continuous signal, such as an attitude; seconds if values lasted for less than
        a step of the log.
    findings : tuple of str
        Problems of the record, in words.
    has_time : bool
        False for rows without a time.
    gaps : "auto", "bridge" or "cut"
        What a long step is: "bridge" if the inputs are known across it, as in a schedule, so that a
        model runs on; "cut" if rows are lost wherever a step is longer than one and a half median
        steps, so that a new stretch begins. By default decided as in `greybox.data.clock`.

    Raises
    ------
    ValueError
        For empty records, different lengths, times that do not increase, units or holds of unknown
        signals, or a hold below 0.

    Examples
    --------
    >>> time = np.arange(0, 1, 0.1)  # s
    >>> record = gb.Record(time, {"u": np.sin(time)}, units={"u": "N"}, hold={"u": np.inf})
    >>> record["u"][:2].round(3)
    array([0. , 0.1])
    >>> len(record.between(0.3, 0.7))
    4
    """

    noun: ClassVar = "record"
    time: Array
    signals: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    name: str = ""
    source: str = ""
    checksum: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict, metadata=NOT_STORED)
    filters: Mapping[str, tuple[Any, ...]] = field(default_factory=dict, metadata=NOT_STORED)
    hold: Values = field(default_factory=dict)
    findings: tuple[str, ...] = field(default=(), metadata=NOT_STORED)
    has_time: bool = True
    gaps: Gaps = "auto"

    def __post_init__(self) -> None:
        """Convert to read-only arrays and check them."""
        for what in ("signals", "units", "hold"):
            given = getattr(self, what)
            if not hasattr(given, "items"):
                raise TypeError(f"{what} is {given!r:.60}: give {{name: values}}.")
            # The columns of a data frame may be numbered.
            normalize(self, **{what: {all_printable(str(name)): x for name, x in given.items()}})
        require_gaps(self.gaps)
        if self.time is None:
            rows = next(map(np.size, self.signals.values()), 0)
            normalize(self, time=np.arange(rows, dtype=float), has_time=False)
        time = _read_only(seconds_from_first(self.time), "time")
        if time.size == 0:
            raise ValueError("the record is empty: give at least one sample.")
        require("time", time, np.isfinite(time), "leave out the samples without a time")
        # Without a time, rows may be in any order.
        with np.errstate(over="ignore"):
            steps = np.diff(time)
        if self.has_time:
            _require_increasing(time, steps)
        if self.has_time and out_of_range(steps).any():
            step = steps[np.argmax(out_of_range(steps))]
            raise ValueError(
                f"time has a step of {step:g} s, whose square is beyond floating-point arithmetic: "
                "give times in s."
            )

        measured = {name: _read_only(x, name) for name, x in self.signals.items()}
        signals = {name: within_range(values) for name, values in measured.items()}
        lost = [
            f"{name} has values beyond 1e75, which count as missing: check its sensor."
            for name, values in measured.items()
            if np.isnan(signals[name][~np.isnan(values)]).any()
        ]
        for name, values in signals.items():
            require_size(name, values, "time" if self.has_time else next(iter(signals)), time.size)
        for what, described in (("units", self.units), ("hold", self.hold)):
            unknown = [name for name in described if name not in signals]
            if unknown:
                raise ValueError(
                    f"{what} names {unknown[0]!r}, which is not a signal; the record has "
                    f"{alternatives(unknown[0], signals)}"
                )
        hold = {name: checked_hold(name, seconds) for name, seconds in self.hold.items()}
        # A given checksum is that of the file: excerpts of one log are recognized by it.
        # The numbers of other stretches are other data.
        stated = () if self.gaps == "auto" else (self.gaps,)
        checksum = self.checksum or checksum_of(
            time, *chain.from_iterable(signals.items()), *stated
        )
        findings = (*self.findings, *lost)
        normalize(self, time=time, signals=signals, hold=hold, checksum=checksum, findings=findings)
        write_out(self, "name", "source", "units", "findings")

    def __len__(self) -> int:
        return self.time.size

    def __getitem__(self, name: str) -> Array:
        if name not in self.signals:
            raise KeyError(
                f"the record has no signal {name!r}; it has {alternatives(name, self.signals)}"
            )
        return self.signals[name]

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields alone: the key of a stored study must not depend on what was asked."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def clock(self) -> Clock:
        """The usual step, and where rows are missing; a step of 1 for rows without a time."""
        if not self.has_time:
            return Clock(1.0, "uniform", np.zeros(0, dtype=int))
        smooth = [x for name, x in self.signals.items() if self.hold.get(name, 0.0) == 0.0]
        return clock_of(self.time, smooth)

    @property
    def step(self) -> float:
        """Usual sampling interval, s; NaN for a single sample, and 1 for rows without a time."""
        return self.clock.step

    @property
    def is_irregular(self) -> bool:
        """Whether more than a tenth of the samples lie off a grid of the steps around them."""
        return self.clock.kind == "irregular"

    @property
    def rate(self) -> float:
        """Sampling rate, Hz, from the median interval."""
        return 1 / self.step

    @property
    def span(self) -> Interval:
        """Times of the first and the last sample, s."""
        return float(self.time[0]), float(self.time[-1])

    @property
    def duration(self) -> float:
        """From the first to the last sample, s, gaps included."""
        return float(self.time[-1] - self.time[0])

    @property
    def pieces(self) -> tuple["Record", ...]:
        """The stretches in which no row is missing, as records; rows without a time are one piece.

        A model runs on from one to the next if its inputs are known in between, see `stretches`.
        """
        if not self.has_time:
            return (self,)
        # As slices, which copy nothing.
        pieces = self.independent_pieces
        return tuple(self.rows(slice(rows[0], rows[-1] + 1)) for rows in pieces)

    @property
    def independent_pieces(self) -> list[IntArray]:
        """The rows of each stretch in which no row is missing; without a time, each by itself."""
        if not self.has_time:
            return list(np.arange(len(self))[:, None])
        ends = self.clock.holes
        if self.gaps != "auto":
            ends = lost_rows(self.time, np.zeros((0, len(self))), self.clock, self.gaps)
        return np.split(np.arange(len(self)), ends + 1)

    def stretches(self, inputs: Sequence[str]) -> list[IntArray]:
        """Return the rows of each stretch through which a model with these inputs runs on.

        A new stretch begins where the inputs are unknown, see `greybox.data.clock`; missing values
        of an input are not regarded. Rows without a time are one stretch.
        """
        if not self.has_time:
            return [np.arange(len(self))]
        values = array_of(self, inputs).reshape(len(inputs), len(self))
        ends = lost_rows(self.time, values, self.clock, self.gaps)
        return np.split(np.arange(len(self)), ends + 1)

    def gaps_described(self, inputs: Sequence[str]) -> str:
        """Return what the long steps are for a model with these inputs, or "" if there is none."""
        if not self.has_time:
            return ""
        cut = len(self.stretches(inputs)) - 1
        return described_gaps(self.time, self.clock, cut, self.gaps)

    def is_same_as(self, other: "Record") -> bool:
        """Return whether another record has the same times, and values of the signals of both.

        What is stated of gaps must be the same, too.
        """
        # The checksum alone does not decide: excerpts of a log have the checksum of the whole log.
        is_same = (self.checksum, self.gaps) == (other.checksum, other.gaps)
        is_same = is_same and np.array_equal(self.time, other.time)
        shared = self.signals.keys() & other.signals.keys()
        return is_same and all(
            np.array_equal(self[name], other[name], equal_nan=True) for name in shared
        )

    def during(self, start: float, end: float) -> BoolArray:
        """Return which samples, (n,), have a time from `start` to `end`, s."""
        return (self.time >= start) & (self.time <= end)

    def between(self, start: float, end: float) -> "Record":
        """Return the samples with start <= time <= end, s on the record's clock."""
        require_time(self, "between")
        rows = np.flatnonzero(self.during(start, end))
        if not rows.size:
            raise ValueError(
                f"the record has no sample from {start:g} to {end:g} s; it runs from "
                f"{self.time[0]:g} to {self.time[-1]:g} s: give two times in it, the earlier first."
            )
        return self.rows(rows)

    def with_signals(
        self, units: Mapping[str, str] | None = None, **signals: ArrayLike
    ) -> "Record":
        """Return the record with signals added or replaced."""
        # The numbers are no longer those of the file, so the checksum is computed again.
        return replace(
            self,
            signals={**self.signals, **signals},
            units={**self.units, **(units or {})},
            checksum="",
        )

    def stated(
        self,
        units: Mapping[str, str] | None = None,
        hold: Mapping[str, float | str] | None = None,
        gaps: Gaps | None = None,
    ) -> "Record":
        """Return the record with what its file does not say of these signals; no number changes.

        Parameters
        ----------
        units : mapping of name to str, optional
        hold : mapping of name to float or str, optional
            Seconds, or "held" and "sampled" as in the header of a table.
        gaps : "auto", "bridge" or "cut", optional

        Examples
        --------
        >>> record = gb.Record([0.0, 0.1, 0.2], {"u": [0, 1, 1], "x": [0, 2, 5]})
        >>> record = record.stated({"x": "mm"}, hold={"u": "held"})
        >>> record.in_si()["x"]
        array([0.   , 0.002, 0.005])
        """
        holds = {name: BETWEEN.get(str(h), h) for name, h in (hold or {}).items()}
        return replace(
            self,
            units={**self.units, **(units or {})},
            hold={**self.hold, **holds},
            gaps=gaps or self.gaps,
        )

    def in_si(self, names: Iterable[str] | None = None) -> "Record":
        """Return the record with these signals in SI units, all by default.

        Units that are not known become findings.

        Raises
        ------
        ValueError
            If a unit has two readings, such as nm.
        """
        signals = dict(self.signals)
        units = dict(self.units)
        findings = [*self.findings]
        for name in self.signals if names is None else names:
            unit = self.units.get(name, "")
            try:
                conversion = to_si(unit)
            except AmbiguousUnitError as error:
                raise ValueError(
                    f"{self.source or 'the record'}: the unit of {name}, {error}, "
                    f"columns={name}=COLUMN:UNIT, or record.stated({{{name!r}: UNIT}})."
                ) from None
            except ValueError as error:
                findings.append(f"{name} was taken as it is, in {unit!r}: {error}.")
                continue
            signals[name] = conversion.apply(self[name])
            units[name] = conversion.si
            findings += [f"{name}: {conversion.remark}."] if conversion.remark else []

        return replace(self, signals=signals, units=units, findings=tuple(findings))

    @classmethod
    def from_pandas(
        cls,
        frame: Frame,
        *,
        time: str | None = None,
        units: Mapping[str, str] | None = None,
        **others: Any,
    ) -> Self:
        """Return the columns of a pandas data frame as signals.

        Parameters
        ----------
        frame : pandas.DataFrame
            Missing values are NaN. Columns are named as in `greybox.data.headings`. The time is the
            index, if this has dates or a name such as ``time``, else the column ``time``, ``t``,
            ``timestamp`` or ``Time (ms)``, else an index of numbers with fractions.
        time : str, optional
            Name of another time column. Dates and time differences count from the first.
        units : mapping of name to str, optional
            By default ``frame.attrs["units"]``, which `to_pandas` writes.
        others
            `name`, `hold` and the rest of a `Record`. ``has_time=False`` for rows without a time.

        Raises
        ------
        TypeError, ValueError
            For anything but a data frame of numbers that makes a record.
        """
        require_frame(frame)
        clock, columns, statements = table_of(frame, time, has_time=others.pop("has_time", True))
        described = selected(frame.attrs, ("units", "hold", "name", "source", "gaps"))
        for what, in_header in zip(("units", "hold"), units_and_holds(statements), strict=True):
            described[what] = {**in_header, **described.get(what, {})}
        described["findings"] = clock.findings if clock else ()
        # Those of columns that were dropped later stay in `attrs`.
        for what in {"units", "hold"} & described.keys():
            described[what] = selected(described[what], columns)
        # What the caller states overrides the attributes of the frame.
        options = described | others | ({} if units is None else {"units": units})

        return cls(clock.time if clock else None, columns, **options)  # type: ignore[arg-type]

    def to_pandas(self) -> Frame:
        """Return the signals as columns of a pandas data frame with the time in s as index.

        ``frame.attrs`` has the units, holds, name, source and what is stated of gaps.

        Raises
        ------
        ModuleNotFoundError
            Without pandas, ``pip install 'greybox-id[pandas]'``.
        """
        about = attributes(self, "units", "hold", "name", "source", "gaps")
        return frame_of(self.signals, self.time, "time" if self.has_time else "row", about)

    def rows(self, rows: IntArray | slice) -> "Record":
        """Return the samples of these indices, (m,), or of a slice, which is not copied."""
        # The checksum stays: the samples are still those of one file.
        signals = {name: values[rows] for name, values in self.signals.items()}
        return replace(self, time=self.time[rows], signals=signals)

    def __str__(self) -> str:
        signals = ", ".join(
            f"{n} ({self.units[n]})" if self.units.get(n) else n for n in self.signals
        )
        name = self.name or "record"
        if not self.has_time:
            return f"{name}: {counted(len(self), 'row')} without a time: {signals}"
        pieces = len(self.pieces)
        rate = "irregular times" if self.is_irregular else f"{self.rate:.4g} Hz"
        return (
            f"{name}: {counted(len(self), 'sample')} at {rate}, {self.duration:.1f} s from "
            f"{self.time[0]:.1f} s{f' in {pieces} pieces' if pieces > 1 else ''}: {signals}"
        )


@frozen
class Recording(Mapping[str, Record]):
    """The contents of one log file: a `Record` for every kind of message, on its own time base.

    It is a mapping of message name to `Record`: ``recording["ATT"]["Pitch"]``. Messages with
    several instances (lanes, sensors) are named ``"IMU[0]"``, ``"IMU[1]"``; the bare name is the
    first one.

    Attributes
    ----------
    records : mapping of str to Record
    source, checksum : str
        File name and SHA-256 of the file.
    metadata : mapping
        Those that are known of ``vehicle, firmware`` (str), ``parameters`` (name to last value),
        ``parameter_changes`` (tuple of (time, name, previous, value)), ``texts`` (tuple of (time,
        text)), ``modes`` (tuple of (time, name)); times in s.
    findings : tuple of str
        Problems and omissions of the file, in words.
    """

    records: Mapping[str, Record]
    source: str = ""
    checksum: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Write out control characters in names and texts, which come from a file."""
        write_out(self, "records", "source", "metadata", "findings")

    def __getitem__(self, name: str) -> Record:
        if name in self.records:
            return self.records[name]
        # A bare name means the first instance.
        first = [key for key in self.records if key.partition("[")[0] == name]
        if not first:
            raise KeyError(
                f"{self.source or 'the recording'} has no message {name!r}; it has "
                f"{', '.join(self.records)}."
            )
        return self.records[first[0]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.records)

    def __len__(self) -> int:
        return len(self.records)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Every signal, as ``"RATE.POut"``."""
        return tuple(f"{key}.{name}" for key, record in self.items() for name in record.signals)

    @property
    def parameters(self) -> Values:
        """Last value of every parameter of the vehicle; empty if they were not logged."""
        return self.metadata.get("parameters", {})

    def locate(self, signal: str) -> tuple[Record, str]:
        """Return the record and the field that ``"RATE.POut"`` names, or a unique ``"POut"``.

        Raises
        ------
        KeyError
            If no message or several messages have it. The message names the alternatives.
        """
        # Names of messages and of signals may have dots, too.
        for place in [match.start() for match in re.finditer(r"\.", signal)]:
            message, name = signal[:place], signal[place + 1 :]
            if message in self and name in self[message].signals:
                return self[message], name
        holders = [key for key, record in self.records.items() if signal in record.signals]
        message, dot, name = signal.rpartition(".")
        if dot and not holders:
            self[message][name]  # KeyError for an unknown message or field
        if not holders:
            fields = unique(name for record in self.values() for name in record.signals)
            similar = nearest(signal, fields) or some(fields, 12)
            raise KeyError(
                f"there is no signal {signal!r}, but {similar}: write MESSAGE.SIGNAL, or name the "
                f"column of a table, columns={{{signal!r}: ...}}"
            )
        if len(holders) > 1:
            raise KeyError(
                f"several messages have the signal {signal!r}, {', '.join(holders)}: name the one "
                f"that you mean, {holders[0]}.{signal}."
            )

        return self.records[holders[0]], signal

    def __repr__(self) -> str:
        return one_line(
            self, repr(self.source), counted(len(self), "message"), ", ".join(self.records)
        )


def runs_between_gaps(values: Array | IntArray, gap: float) -> list[IntArray]:
    """Return the places of every run of `values` (n,) whose steps are at most `gap`."""
    return np.split(np.arange(len(values)), np.flatnonzero(np.diff(values) > gap) + 1)


def require_time(record: Record, what: str) -> None:
    """Raise ValueError for rows without a time, which `what` needs."""
    if not record.has_time:
        raise ValueError(
            f"{what} needs samples in time, and {record.name or 'the record'} has rows without a "
            "time: give their times, Record(time, ...), or for a table its column of times, "
            "columns=time=COLUMN:s, or a rate."
        )


def unrounded(record: Record) -> Record:
    """Return a record in coarse stamps with the times of its uniform clock, others as they are.

    Stamps of a clock that drifts by more than they round stay, too.
    """
    if record.clock.kind != "rounded":
        return record
    times = record.time.copy()
    for rows in record.independent_pieces:
        # The best line through the stamps.
        ticks, stamps = (values - values.mean() for values in (rows, record.time[rows]))
        step = ticks @ stamps / max(float(ticks @ ticks), 1.0)
        if np.abs(stamps - step * ticks).max() < 0.75 * record.clock.tick:
            times[rows] = record.time[rows].mean() + step * ticks
    return replace(record, time=times)


def share_samples(a: Record, b: Record) -> bool:
    """Return whether two records have some measured samples in common.

    Records of one file do if their times overlap outside gaps, or if they have a row in common.
    Other records do if they have the same values at the same times, as after `Record.with_signals`.
    """
    if a.has_time != b.has_time:
        return False
    if a.checksum == b.checksum:
        if not a.has_time:
            return bool(np.intersect1d(a.time, b.time).size)
        return any(
            piece.time[0] <= other_piece.time[-1] and other_piece.time[0] <= piece.time[-1]
            for piece in a.pieces
            for other_piece in b.pieces
        )

    # Without a common file, only equal values at equal times show a common measurement.
    _, rows, other_rows = np.intersect1d(a.time, b.time, assume_unique=True, return_indices=True)
    alike = [
        np.isclose(a[name][rows], b[name][other_rows], 0.0, 0.0, equal_nan=True)
        for name in a.signals
        if name in b.signals
    ]

    # A few samples of quantized signals are equal by chance: more than half of the samples at
    # common times must be equal in all common signals.
    return bool(alike) and rows.size > 0 and float(np.mean(np.all(alike, axis=0))) > 0.5


def _read_only(values: ArrayLike, name: str) -> Array:
    """Return a read-only array (n,), without a copy if it is read-only already."""
    # A read-only view of an array that its owner may still change does not count.
    if type(values) is np.ndarray and values.dtype == float and values.ndim == 1:
        owner = values if values.base is None else values.base
        is_frozen = isinstance(owner, np.ndarray) and not owner.flags.writeable
        if is_frozen and not values.flags.writeable:
            return values
    return checked_array(name, values)


def _require_increasing(time: Array, steps: Array) -> None:
    """Raise ValueError if times (n,), with these `steps` (n - 1,), do not increase."""
    back = np.flatnonzero(steps <= 0)
    if not back.size:
        return
    cure = "sort the samples"
    if not steps[back].any():
        cure = (
            "two samples have one time. Remove samples that are stored twice; give replicates as "
            "one record each, gb.several(model, [first, second])"
        )
    raise ValueError(
        f"time does not increase after {time[back[0]]:.6f} s (index {back[0]}): {cure}."
    )
