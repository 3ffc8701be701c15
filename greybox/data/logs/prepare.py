"""Puts signals of a log on one time base, in SI, without aliasing or interpolation across gaps."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from greybox.data.clock import (
    ONE_LOST,
    Gaps,
    clock_of,
    lost_rows,
    require_gaps,
    runs_between_holes,
)
from greybox.data.files.argument_checks import as_names, is_finite_number, require_kind
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.data.intersample import HELD, intersample
from greybox.data.logs.ardupilot.truncated_angles import untruncated
from greybox.data.logs.flight_controllers import passed_filters
from greybox.data.record import Record, Recording, require_time, unrounded
from greybox.data.units import to_si

# Edges of the pass band and the stop band of the anti-alias filter, relative to the new sampling
# rate. The stop band begins at the new Nyquist frequency. A wider pass band affects more samples at
# the ends of a stretch: the length of the filter is 5.0 / (STOP - PASS) new samples.
PASS = 0.35
STOP = 0.5

# s, rounding error of a time that is computed from start and rate: a sample at the very end of a
# run still counts as inside.
TIME_ROUNDING = 1e-9

# Shortest step of a run, as a share of the usual one, below which no spline is drawn through its
# samples. The slope between two close samples is that of their noise: a spline carries it on, and
# overshoots by 0.2 standard deviations of the noise over this share.
CLOSE = 0.1

# Share of the rows with a value, below which the column is a slower sensor in a wide table. A
# column that merely lost samples has more.
FEWEST_VALUES = 0.5


@frozen
class Derived:
    """A signal computed from others on the common time base: ``compute(*inputs) -> (n,)``."""

    inputs: tuple[str, ...]
    compute: Callable[..., Array]
    unit: str


@public
def horizontal_velocity(
    north: str = "XKF1.VN",
    east: str = "XKF1.VE",
    yaw: str = "ATT.Yaw",
    axis: Literal["pitch", "roll", "forward", "right"] = "pitch",
) -> Derived:
    """Return the horizontal velocity along a body axis, for `prepare`.

    "pitch" and "roll" are the paper's v, which grows with a positive tilt angle: a nose that goes
    up accelerates backward, so that it is the negative of "forward"; with the right side down it
    accelerates to the "right".
    """
    # The rotation of each axis from "forward", rad.
    turns = {"forward": 0.0, "pitch": np.pi, "right": np.pi / 2, "roll": np.pi / 2}
    if axis not in turns:
        raise ValueError(f"axis {axis!r} is not known: use 'pitch', 'roll', 'forward' or 'right'.")
    return Derived(
        (north, east, yaw),
        lambda n, e, psi: n * np.cos(psi + turns[axis]) + e * np.sin(psi + turns[axis]),
        "m/s",
    )


@public
def prepare(
    recording: Recording | Record,
    signals: Mapping[str, str | Derived],
    rate: float | None = None,
    *,
    start: float = -math.inf,
    end: float = math.inf,
    held: Sequence[str] = (),
    gaps: Gaps | None = None,
) -> Record:
    """Put signals of different messages and rates on one uniform time base, by their time stamps.

    Angles are unwrapped and units become SI, see `greybox.data.units`. Unknown units are not
    converted; the findings name them and ambiguous ones. A signal that is sampled faster than
    `rate` first passes a zero-phase anti-alias filter, flat to 0.35 of the new rate. Signals are
    not interpolated across holes of more than one lost row: the record has the same holes, and
    `Record.pieces` are the stretches between them. `greybox.data.clock` defines holes, and replaces
    coarse time stamps by the uniform clock that they round.

    ArduPilot truncates angles to hundredths of a degree. Half a hundredth is added, see
    `greybox.data.logs.ardupilot.truncated_angles`.

    A signal with a zero-order hold, such as the output of a controller, remains held if `rate` is
    its own rate or a higher one: each new sample is the mean of the signal over the new sampling
    interval. If `rate` is lower, the anti-alias filter removes the steps, and `Record.hold` stores
    the hold time of the original signal.

    Parameters
    ----------
    recording : Recording or Record
        What `read` returned, or one record.
    signals : mapping of new name to "MESSAGE.Field" or Derived
        E.g. ``{"u": "RATE.POut", "theta": "ATT.Pitch", "v": horizontal_velocity()}``.
    rate : float, Hz, optional
        By default that of the slowest signal.
    start, end : float, s
        Cut to this stretch of the log's clock.
    held : sequence of str
        New names of signals that are held until their next sample, if the log does not say so.
    gaps : "auto", "bridge" or "cut", optional
        "bridge" interpolates across every hole; "cut" makes a hole of every step of more than one
        and a half median steps. By default as `recording` states, see `Record`.

    Returns
    -------
    Record
        With `checksum`, `source` and `metadata` of the recording, and the known filters and holds
        of each signal.

    Raises
    ------
    KeyError
        For a signal that does not exist.
    ValueError
        For a bad rate, or if the signals have no time in common.

    Examples
    --------
    >>> from greybox.problems import sitl_pitch
    >>> log = gb.read(sitl_pitch.LOG)  # a part of a simulated flight, included with greybox
    >>> record = gb.prepare(log, {"u": "RATE.POut", "theta": "ATT.Pitch"})
    >>> record.units["theta"]  # degrees in the log
    'rad'
    """
    require_kind("recording", recording, Recording | Record, "what gb.read returns, or a Record")
    if isinstance(recording, Record):
        records = {recording.name or "record": recording}
        recording = Recording(records, recording.source, recording.checksum, recording.metadata)
    require_kind("signals", signals, Mapping, "{'u': 'RATE.POut'} and so on")
    if gaps is not None:
        require_gaps(gaps)
    if not signals:
        raise ValueError("signals is empty: name at least one, e.g. {'u': 'RATE.POut'}.")

    held = as_names(held)
    unknown = [name for name in held if name not in signals]
    if unknown:
        raise ValueError(
            f"held names {unknown[0]!r}, which is not among the signals {', '.join(signals)}."
        )

    derived = {
        name: item if isinstance(item, Derived) else Derived((item,), np.asarray, "")
        for name, item in signals.items()
    }
    sources = {
        name: _source(recording, name, start, end, gaps)
        for item in derived.values()
        for name in item.inputs
    }
    for signal in held:
        for name in derived[signal].inputs:
            sources[name] = replace(sources[name], hold=HELD)

    rate = 1 / max(source.step for source in sources.values()) if rate is None else rate
    grid = _grid(sources, rate, start, end)
    sampled = {name: _on_grid(source, grid, rate) for name, source in sources.items()}
    # A gap in one signal is a gap of the record, because a model needs all signals at once.
    keep = np.isfinite([*sampled.values()]).all(axis=0)
    if keep.sum() < 2:
        raise ValueError(
            f"{', '.join(sources)} are never present at the same time from {grid[0]:.1f} to "
            f"{grid[-1]:.1f} s: choose signals, or a start and an end, that overlap."
        )

    values = {}
    units = {}
    for name, item in derived.items():
        values[name] = item.compute(*(sampled[source][keep] for source in item.inputs))
        units[name] = item.unit or sources[item.inputs[0]].unit

    return Record(
        grid[keep],
        values,
        units,
        name=recording.source,
        source=recording.source,
        checksum=recording.checksum,
        metadata=recording.metadata,
        hold=_known_holds(derived, sources, rate),
        filters=_known_filters(recording, derived),
        findings=unique(text for source in sources.values() for text in source.findings),
        gaps=_common_gaps(sources),
    )


@frozen
class _Source:
    """One field of one message, in SI units and unwrapped, without missing samples."""

    time: Array
    values: Array
    unit: str
    findings: tuple[str, ...]
    hold: float | None
    step: float  # s, usual step between start and end: the rate may differ elsewhere
    gaps: Gaps

    @property
    def runs(self) -> list[IntArray]:
        """The indices of the samples of each run within which values are interpolated."""
        clock = clock_of(self.time)
        if self.gaps == "auto":
            return runs_between_holes(self.time, clock, ONE_LOST * self.step)
        ends = lost_rows(self.time, self.values[None], clock, self.gaps)
        return np.split(np.arange(self.time.size), ends + 1)

    @property
    def is_held(self) -> bool:
        """Whether each value lasts until the next sample: a zero-order hold."""
        return self.hold is not None and intersample(self.hold, self.step).held

    def is_filtered(self, rate: float) -> bool:
        """Return whether a record at this rate needs the anti-alias filter."""
        # If the rates differ by less than 5 %, only the highest 5 % of the frequencies can alias.
        return rate < 0.95 / self.step

    def hold_at(self, rate: float) -> float | None:
        """Return the hold time of the values in a record at this rate, s; None if unknown."""
        if not self.is_held:
            return self.hold
        return self.step if self.is_filtered(rate) else HELD


def _common_gaps(sources: Mapping[str, _Source]) -> Gaps:
    """Return the meaning of long steps that all sources state, or "auto" if they differ."""
    stated: tuple[Gaps, ...] = unique(source.gaps for source in sources.values())
    return stated[0] if len(stated) == 1 else "auto"


def _source(
    recording: Recording, signal: str, start: float, end: float, gaps: Gaps | None
) -> _Source:
    record, field = recording.locate(signal)
    require_time(record, "prepare")
    finite = np.isfinite(record[field])
    time = unrounded(record).time[finite]
    values = record[field][finite]
    if time.size < 2:
        raise ValueError(
            f"{signal} has {counted(time.size, 'value')} in {counted(len(record), 'sample')}, too "
            f"few for a time base.{''.join(f' {text}' for text in record.findings)}"
        )
    unit = record.units.get(field, "")
    findings = record.findings
    try:
        conversion = to_si(unit)
    except ValueError as error:
        findings += (f"{signal} is in {unit!r}, as in the log, not in SI: {error}.",)
    else:
        # The truncation is corrected before the conversion: in degrees, its steps are exact.
        if unit == "deg":
            values = untruncated(signal, values)
        values = conversion.apply(values)
        unit = conversion.si
        if conversion.remark:
            findings += (f"{signal}: {conversion.remark}.",)

    if finite.mean() < FEWEST_VALUES:
        findings += (
            f"fewer than half of the rows have a value of {signal}, and the others are "
            "interpolated: for a fit, take the rows as they are, record = gb.read(FILE, "
            "columns={NAME: COLUMN, ...})[TABLE].",
        )

    requested = time[(time >= start) & (time <= end)]
    step = clock_of(requested if requested.size > 1 else time).step
    # Angles are unwrapped before filter and interpolation, which would smear a jump from 2π to 0.
    if unit == "rad":
        values = np.unwrap(values)

    gaps = record.gaps if gaps is None else gaps
    return _Source(time, values, unit, findings, record.hold.get(field), step, gaps)


def _grid(sources: Mapping[str, _Source], rate: float, start: float, end: float) -> Array:
    if math.isnan(start) or math.isnan(end):
        raise ValueError(
            f"start {start} and end {end} must be numbers of seconds on the log's clock."
        )
    first = max(start, *(source.time[0] for source in sources.values()))
    last = min(end, *(source.time[-1] for source in sources.values()))
    if not (is_finite_number(rate) and rate > 0):
        raise ValueError(f"rate {rate!r} must be a finite number of Hz above 0.")

    # A rate in rad/s or a step in ms would make a record of interpolated samples.
    fastest = 1 / min(source.step for source in sources.values())
    if rate > 10 * fastest:
        raise ValueError(
            f"rate {rate:g} Hz is more than ten times that of the fastest signal, {fastest:.4g} "
            "Hz: lower it."
        )
    # Without the small margin, rounding could lose the last sample.
    count = math.floor((last - first) * rate + 1e-6) + 1
    if count < 2:
        spans = "; ".join(
            f"{n} from {s.time[0]:.1f} to {s.time[-1]:.1f} s" for n, s in sources.items()
        )
        raise ValueError(
            f"the signals do not overlap in time ({spans}): check start, end and the messages."
        )

    return first + np.arange(count) / rate


def _on_grid(source: _Source, grid: Array, rate: float) -> Array:
    """Return the signal at the times `grid` (n,), s; NaN in its holes and beyond its ends."""
    # 0.25 s to import
    from scipy.interpolate import CubicSpline, PchipInterpolator  # noqa: PLC0415

    result = np.full(grid.size, np.nan)
    for run in source.runs:
        time, values = source.time[run], source.values[run]
        in_run = (grid >= time[0] - TIME_ROUNDING) & (grid <= time[-1] + TIME_ROUNDING)
        if time.size < 2 or not in_run.any():
            continue
        times = np.clip(grid[in_run], time[0], time[-1])
        if source.is_filtered(rate):
            time, values = _low_passed(time, values, source.step, rate)
        elif source.is_held:
            # Each new sample is the mean over the interval that begins with it, so the signal is
            # not shifted in time. The mean is a difference of the integral, which is linear between
            # the samples.
            step = 1 / rate
            ends = np.append(time[1:], time[-1] + step)
            integral = np.append(0.0, np.cumsum(values * (ends - time)))
            bounds = np.append(time[0], ends)
            before = np.interp(times, bounds, integral)
            after = np.interp(times + step, bounds, integral)
            result[in_run] = (after - before) / step
            continue
        is_even = np.diff(time).min() > CLOSE * source.step
        curve = CubicSpline if is_even else PchipInterpolator
        result[in_run] = curve(time, values)(times)

    return result


def _known_holds(
    derived: Mapping[str, Derived], sources: Mapping[str, _Source], rate: float
) -> dict[str, float]:
    """Return the hold times, s, of the derived signals for which they are known."""
    holds = {}
    for name, item in derived.items():
        source_holds = {sources[source].hold_at(rate) for source in item.inputs}
        # A signal that is computed from sources with different holds has no hold of a known form.
        if len(source_holds) != 1:
            continue
        hold = source_holds.pop()
        if hold is not None:
            holds[name] = hold
    return holds


def _low_passed(time: Array, values: Array, step: float, rate: float) -> tuple[Array, Array]:
    """Return uniform times and the low-pass filtered values at the rate of the source.

    The filter has zero phase. Point reflection extends the values at both ends.
    """
    from scipy.signal import firwin, kaiserord, oaconvolve  # noqa: PLC0415  (0.33 s to import)

    uniform = np.linspace(time[0], time[-1], max(round((time[-1] - time[0]) / step) + 1, 2))
    samples = np.interp(uniform, time, values)
    nyquist = 0.5 / step
    # An attenuation of 80 dB leaves 1e-4 of the amplitudes that would alias.
    taps, beta = kaiserord(80.0, (STOP - PASS) * rate / nyquist)
    # An odd number of taps has a center. The filter must not be longer than the reflected ends.
    taps = min(taps | 1, 2 * ((samples.size - 1) // 2) + 1)
    window: Any = ("kaiser", beta)
    # A symmetric kernel delays all frequencies equally. Centered on its sample, it delays none.
    kernel = firwin(taps, (PASS + STOP) / 2 * rate, window=window, fs=2 * nyquist)
    half = taps // 2
    # An odd reflection continues value and slope, so that the filter makes no step at the ends.
    padded = np.pad(samples, half, mode="reflect", reflect_type="odd")
    return uniform, oaconvolve(padded, kernel, mode="valid")


def _known_filters(
    recording: Recording, derived: Mapping[str, Derived]
) -> dict[str, tuple[Any, ...]]:
    """Return the known filters of the derived signals: those of the first input that has any."""
    filters = {}
    for name, item in derived.items():
        for source in item.inputs:
            record, field = recording.locate(source)
            # The record may state its filters. Otherwise those of the flight controller count.
            passed = record.filters.get(field, passed_filters(recording, source))
            if passed:
                filters[name] = passed
                break
    return filters
