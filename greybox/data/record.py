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
from greybox.data.files.public import public
from greybox.data.files.spelling import alternatives, nearest
from greybox.data.files.wording import counted, some
from greybox.data.headings import BETWEEN, units_and_holds
from greybox.data.intersample import checked_hold
from greybox.data.pandas_frames import Frame, frame_of, require_frame, table_of
from greybox.data.units import AmbiguousUnitError, to_si

NOT_STORED = {"stored": False}  # in the file of a fit


@public
@frozen
class Record(Printed):
    """One experiment: named signals on one time base, or rows without one.

    Parameters
    ----------
    time : (n,) array, s, or None
        Strictly increasing. Dates and time differences are converted to seconds from the first.
        None for rows without an order in time, as in a table of independent measurements. Then
        `time` is the index of each row, `has_time` is False, and only static models can be fitted.
    signals : mapping of name to (n,) array
        Real numbers. NaN or the mask of a masked array marks a missing sample. Values beyond ±1e75
        become NaN, and values below 1e-75 become zero: their sums of squares would overflow or
        vanish.
    units : mapping of name to str
        Units of the signals: those of the log, or SI units after `prepare`.
    name, source : str
        A label for tables and figures, and the name of the file.
    checksum : str
        SHA-256 of the file; by default, of the times and values of this record.
    metadata : mapping
        Vehicle, firmware, parameters and the like, from the log.
    filters : mapping of signal name to tuple
        Known filters that a signal has passed before it was logged. A model should include them.
    hold : mapping of signal name to float, s
        The hold time of each value, if it is known, see `greybox.data.intersample`. Infinity for a
        zero-order hold, in which each value lasts until the next sample, such as the output of a
        controller; 0 for samples of a continuous signal, such as an attitude; a finite time if
        values last for less than a step of the log.
    findings : tuple of str
        Problems of the record, in words.
    has_time : bool
        False for rows without a time.
    gaps : "auto", "bridge" or "cut"
        The meaning of long time steps. "bridge": the inputs are known across them, as in a
        schedule, and a model is simulated across them. "cut": rows are lost in every step of more
        than 1.5 median steps, and a new stretch begins after it. "auto": the rules of
        `greybox.data.clock` decide.

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
            mapping = getattr(self, what)
            if not hasattr(mapping, "items"):
                raise TypeError(f"{what} is {mapping!r:.60}: give {{name: values}}.")
            # Names become strings, because the columns of a data frame may have numbers as names.
            by_name = {all_printable(str(name)): value for name, value in mapping.items()}
            normalize(self, **{what: by_name})
        require_gaps(self.gaps)
        if self.time is None:
            rows = next(map(np.size, self.signals.values()), 0)
            normalize(self, time=np.arange(rows, dtype=float), has_time=False)
        time = _read_only(seconds_from_first(self.time), "time")
        if time.size == 0:
            raise ValueError("the record is empty: give at least one sample.")
        require("time", time, np.isfinite(time), "leave out the samples without a time")
        # Only a record with times needs increasing ones: other rows may be in any order.
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
        overflows = [
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
        # A checksum argument is that of the file. It is kept, because it shows that two records are
        # excerpts of one log. Otherwise the checksum includes `gaps`, because other stretches make
        # other data of the same numbers.
        stated_gaps = () if self.gaps == "auto" else (self.gaps,)
        checksum = self.checksum or checksum_of(
            time, *chain.from_iterable(signals.items()), *stated_gaps
        )
        findings = (*self.findings, *overflows)
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

    def __contains__(self, name: object) -> bool:
        return name in self.signals

    def __iter__(self) -> Iterator[str]:
        """Return the names of the signals, as of a mapping; `len` is the number of samples."""
        return iter(self.signals)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields without cached properties.

        The key of a stored study is computed from this state. It must not depend on which
        properties were read before.
        """
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @cached_property
    def clock(self) -> Clock:
        """The sampling clock: the usual step and the holes; a step of 1 for rows without a time."""
        if not self.has_time:
            return Clock(1.0, "uniform", np.zeros(0, dtype=int))
        # Signals with a hold have steps, so their smoothness shows nothing about the clock.
        smooth = [
            values for name, values in self.signals.items() if self.hold.get(name, 0.0) == 0.0
        ]
        return clock_of(self.time, smooth)

    @property
    def step(self) -> float:
        """Usual sampling interval, s; NaN for a single sample, and 1 for rows without a time."""
        return self.clock.step

    @property
    def is_irregular(self) -> bool:
        """Whether more than a tenth of the steps are no multiple of the usual step around them."""
        return self.clock.kind == "irregular"

    @property
    def rate(self) -> float:
        """Sampling rate, Hz: the reciprocal of the usual step."""
        return 1 / self.step

    @property
    def span(self) -> Interval:
        """Times of the first and the last sample, s."""
        return float(self.time[0]), float(self.time[-1])

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, s, including gaps."""
        return float(self.time[-1] - self.time[0])

    @property
    def pieces(self) -> tuple["Record", ...]:
        """The parts of the record between holes, as records. Rows without a time are one piece.

        A model can be simulated from one piece to the next if its inputs are known across the hole,
        see `stretches`.
        """
        if not self.has_time:
            return (self,)
        # Slices are views of the arrays, so no sample is copied.
        pieces = self.independent_pieces
        return tuple(self.rows(slice(rows[0], rows[-1] + 1)) for rows in pieces)

    @property
    def independent_pieces(self) -> list[IntArray]:
        """The row indices of each part between holes. Without a time, every row is its own part."""
        if not self.has_time:
            return list(np.arange(len(self))[:, None])
        ends = self.clock.holes
        if self.gaps != "auto":
            ends = lost_rows(self.time, np.zeros((0, len(self))), self.clock, self.gaps)
        return np.split(np.arange(len(self)), ends + 1)

    def stretches(self, inputs: Sequence[str]) -> list[IntArray]:
        """Return the row indices of each stretch that a model with these inputs can simulate.

        A new stretch begins after each hole across which an input is unknown, see
        `greybox.data.clock`. A NaN of an input between two samples does not begin a stretch. Rows
        without a time are one stretch.
        """
        if not self.has_time:
            return [np.arange(len(self))]
        values = array_of(self, inputs).reshape(len(inputs), len(self))
        ends = lost_rows(self.time, values, self.clock, self.gaps)
        return np.split(np.arange(len(self)), ends + 1)

    def gaps_described(self, inputs: Sequence[str]) -> str:
        """Return a sentence on the long time steps for a model with these inputs, or ""."""
        if not self.has_time:
            return ""
        cut = len(self.stretches(inputs)) - 1
        return described_gaps(self.time, self.clock, cut, self.gaps)

    def is_same_as(self, other: "Record") -> bool:
        """Return whether another record has the same checksum, times and `gaps` as this one.

        Signals that both records contain must have the same values.
        """
        # The checksum alone does not decide: excerpts of a log have the checksum of the whole log.
        is_same = (self.checksum, self.gaps) == (other.checksum, other.gaps)
        is_same = is_same and np.array_equal(self.time, other.time)
        shared = self.signals.keys() & other.signals.keys()
        return is_same and all(
            np.array_equal(self[name], other[name], equal_nan=True) for name in shared
        )

    def during(self, start: float, end: float) -> BoolArray:
        """Return a mask (n,) of the samples with times from `start` to `end`, s."""
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
        # The values differ from those of the file, so an empty checksum asks for a new one.
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
        """Return the record with information that its file lacks. Times and values do not change.

        Parameters
        ----------
        units : mapping of name to str, optional
            Units of signals.
        hold : mapping of name to float or str, optional
            Hold times of signals in s, or "held" and "sampled" as in the header of a table.
        gaps : "auto", "bridge" or "cut", optional
            The meaning of long time steps.

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
        """Return the record with these signals in SI units; by default with all signals.

        Signals of an unknown unit are not converted, and a finding says so.

        Raises
        ------
        ValueError
            If a unit is ambiguous, such as nm (nanometer or newton meter).
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
            if conversion.remark:
                findings.append(f"{name}: {conversion.remark}.")

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
        """Return a record with the columns of a pandas data frame as signals.

        Parameters
        ----------
        frame : pandas.DataFrame
            Missing values are NaN. Columns are named as in `greybox.data.headings`. The time is the
            index if it contains dates or has a name such as ``time``; otherwise the column
            ``time``, ``t``, ``timestamp`` or ``Time (ms)``; otherwise an index of numbers with
            fractions.
        time : str, optional
            Name of the time column, if it has another name. Dates and time differences are
            converted to seconds from the first.
        units : mapping of name to str, optional
            By default ``frame.attrs["units"]``, which `to_pandas` writes.
        others
            Other fields of `Record`, such as `name` and `hold`. ``has_time=False`` for rows without
            a time.

        Raises
        ------
        TypeError, ValueError
            If `frame` is not a data frame of numbers, or its columns make no valid record.
        """
        require_frame(frame)
        clock, columns, statements = table_of(frame, time, has_time=others.pop("has_time", True))
        described = selected(frame.attrs, ("units", "hold", "name", "source", "gaps"))
        for what, in_header in zip(("units", "hold"), units_and_holds(statements), strict=True):
            described[what] = {**in_header, **described.get(what, {})}
        described["findings"] = clock.findings if clock else ()
        # The attributes of a frame keep units and holds of columns that were dropped later.
        for what in {"units", "hold"} & described.keys():
            described[what] = selected(described[what], columns)
        # Arguments override the attributes of the frame.
        options = described | others | ({} if units is None else {"units": units})

        return cls(clock.time if clock else None, columns, **options)  # type: ignore[arg-type]

    def to_pandas(self) -> Frame:
        """Return a pandas data frame with the signals as columns and the time in s as index.

        Its dictionary ``attrs`` contains the fields units, hold, name, source and gaps.

        Raises
        ------
        ModuleNotFoundError
            If pandas is not installed: ``pip install 'greybox-id[pandas]'``.
        """
        about = attributes(self, "units", "hold", "name", "source", "gaps")
        return frame_of(self.signals, self.time, "time" if self.has_time else "row", about)

    def rows(self, rows: IntArray | slice) -> "Record":
        """Return the samples with these indices (m,), or of a slice, which is not copied."""
        # The checksum is kept, because the samples are still those of the same file.
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


@public
@frozen
class Recording(Mapping[str, Record]):
    """The contents of one log file: one `Record` for each kind of message, on its own time base.

    A recording is a mapping of message name to `Record`: ``recording["ATT"]["Pitch"]``. Messages
    with several instances (lanes, sensors) have names such as ``"IMU[0]"`` and ``"IMU[1]"``; the
    name ``"IMU"`` then means the first instance.

    Attributes
    ----------
    records : mapping of str to Record
    source, checksum : str
        File name and SHA-256 of the file.
    metadata : mapping
        Any of these entries, as far as the log contains them: ``vehicle`` and ``firmware`` (str),
        ``parameters`` (name to last value), ``parameter_changes`` (tuple of (time, name, previous,
        value)), ``texts`` (tuple of (time, text)), ``modes`` (tuple of (time, name)); times in s.
    findings : tuple of str
        Problems of the file and parts that were not read, in words.
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
                f"{alternatives(name, self.records)}"
            )
        return self.records[first[0]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.records)

    def __len__(self) -> int:
        return len(self.records)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The names of all signals with their messages, such as ``"RATE.POut"``."""
        return tuple(f"{key}.{name}" for key, record in self.items() for name in record.signals)

    @property
    def parameters(self) -> Values:
        """The last value of every parameter of the vehicle; empty if none was logged."""
        return self.metadata.get("parameters", {})

    def locate(self, signal: str) -> tuple[Record, str]:
        """Return the record of a signal, and the name of the signal in this record.

        The signal is named with its message, such as ``"RATE.POut"``, or without it, such as
        ``"POut"``, if only one message has it.

        Raises
        ------
        KeyError
            If no message, or more than one, has the signal. The text names the alternatives.
        """
        # Names of messages and of signals may contain dots, so every dot may be the separator.
        for dot_match in re.finditer(r"\.", signal):
            message = signal[: dot_match.start()]
            name = signal[dot_match.end() :]
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
    """Return the indices of each run of increasing `values` (n,) with differences up to `gap`."""
    return np.split(np.arange(len(values)), np.flatnonzero(np.diff(values) > gap) + 1)


def require_time(record: Record, what: str) -> None:
    """Raise ValueError if the record has no time, which the method named `what` needs."""
    if not record.has_time:
        raise ValueError(
            f"{what} needs samples in time, and {record.name or 'the record'} has rows without a "
            "time: give their times, Record(time, ...), or for a table its column of times, "
            "columns=time=COLUMN:s, or a rate."
        )


def unrounded(record: Record) -> Record:
    """Return the record with uniform times instead of coarse time stamps.

    A record without coarse stamps is returned unchanged. In each part between holes, a line is
    fitted to the stamps. The stamps are kept if they deviate from it by more than rounding
    explains, because the clock then drifts.
    """
    if record.clock.kind != "rounded":
        return record
    times = record.time.copy()
    for rows in record.independent_pieces:
        # Least squares for the slope, which is the step of the clock. A part of one row has none,
        # and max(..., 1) avoids a division by zero.
        stamps = record.time[rows]
        row_deviations = rows - rows.mean()
        stamp_deviations = stamps - stamps.mean()
        squares = float(row_deviations @ row_deviations)
        step = row_deviations @ stamp_deviations / max(squares, 1.0)
        # Rounding moves a stamp by up to half a tick; the rest allows for the error of the line.
        residuals = stamp_deviations - step * row_deviations
        if np.abs(residuals).max() < 0.75 * record.clock.tick:
            times[rows] = stamps.mean() + step * row_deviations
    return replace(record, time=times)


def share_samples(a: Record, b: Record) -> bool:
    """Return whether two records have some measured samples in common.

    Records of one file, with the same checksum, have common samples if their times overlap outside
    holes, or without a time if they have a row in common. Records with different checksums have
    common samples if they have the same values at the same times, as after `Record.with_signals`.
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

    # Without a common file, only equal values at equal times are evidence of a common measurement.
    _, rows, other_rows = np.intersect1d(a.time, b.time, assume_unique=True, return_indices=True)
    is_equal = [
        np.isclose(a[name][rows], b[name][other_rows], 0.0, 0.0, equal_nan=True)
        for name in a.signals
        if name in b.signals
    ]

    # A few samples of quantized signals are equal by chance: more than half of the samples at
    # common times must be equal in all common signals.
    if not is_equal or not rows.size:
        return False
    return float(np.mean(np.all(is_equal, axis=0))) > 0.5


def _read_only(values: ArrayLike, name: str) -> Array:
    """Return the values as a read-only array (n,); without a copy if they are one already."""
    # A read-only view is copied if the array that owns its memory may still be changed.
    if type(values) is np.ndarray and values.dtype == float and values.ndim == 1:
        owner = values if values.base is None else values.base
        is_frozen = isinstance(owner, np.ndarray) and not owner.flags.writeable
        if is_frozen and not values.flags.writeable:
            return values
    return checked_array(name, values)


def _require_increasing(time: Array, steps: Array) -> None:
    """Raise ValueError if times (n,), whose differences are `steps` (n - 1,), do not increase."""
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
