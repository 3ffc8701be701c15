"""Finds the tests in a flight: those of System Identification mode, and sines and sweeps."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np

from greybox.data.clock import ONE_LOST, clock_of, median_step, runs_between_holes
from greybox.data.excited_segment import Segment, Segments
from greybox.data.files.argument_checks import as_names
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.data.logs.ardupilot.signals import ATTITUDE_SETPOINTS, SYSTEMID_AXES, SYSTEMID_DELAY
from greybox.data.logs.betaflight import AXES as BETAFLIGHT_AXES
from greybox.data.logs.flight_controllers import AXES, axis_of
from greybox.data.logs.injected_tests import injected_tests
from greybox.data.logs.px4 import AXES as PX4_AXES
from greybox.data.logs.sine_detection import sines_and_sweeps
from greybox.data.record import Record, Recording, require_time
from greybox.data.units import known_unit

ANNOUNCED = {"segment": "Seg", "axis": "Ax", "omega": "W", "amplitude": "Eta", "offset": "Th0"}
SETPOINTS = (  # searched when none is named
    *ATTITUDE_SETPOINTS,
    *(axis.setpoints[0] for axis in PX4_AXES.values()),
    *(axis.setpoints[0] for axis in BETAFLIGHT_AXES.values()),
    *("r", "setpoint", "reference"),
)

# A test ends after this many seconds, or five intervals of a slow message, without its
# announcement.
PAUSE = 1.0

# s: messages and modes that mark a start or an end are logged ten times a second at most.
EDGE = 0.1

STICK_TRAVEL = {"manual_control_setpoint": 2.0}  # of PX4; that of others is 1000, in µs


@public
def find_segments(
    data: Recording | Record,
    message: str = "",
    fields: Mapping[str, str] | None = None,
    setpoint: str | Sequence[str] = (),
) -> tuple[Segment, ...]:
    """Return the excited segments of a flight, in order of time.

    Runs of ArduPilot's System Identification mode (messages SIDS and SIDD), of Betaflight's chirp
    mode and of PX4's autotuning, and tests announced in `message` come first. Without any, sines
    and sweeps are searched in the setpoint.

    Parameters
    ----------
    data : Recording or Record
        A log, or one record (a prepared one: its signals are then looked up by their bare names).
    message : str
        Message that announces a sine test while it runs.
    fields : mapping
        The fields of that message: keys ``omega`` (rad/s) or ``frequency`` (Hz), and, if there are
        such fields, ``segment`` (number of the test), ``axis``, ``amplitude``, ``offset``. Default:
        the fields of `ANNOUNCED` that the message has. A test ends where one of these changes, or
        where the message pauses for a second.
    setpoint : str or sequence of str
        Signals to search for sines, ``"ATT.DesPitch"``; default: those of `SETPOINTS` that exist.

    Raises
    ------
    KeyError, ValueError
        If the message, a field or a setpoint that was named does not exist; the sentence says what
        there is.
    """
    if isinstance(data, Record):
        require_time(data, "a test segment")
    else:
        data = replace(
            data, records={name: record for name, record in data.items() if record.has_time}
        )
    # The autopilot's statements about its own tests are exact; a search in the setpoint is not.
    segments = [*_system_identification(data)]
    if not (message or setpoint):
        segments += injected_tests(data)
    if message or (fields and isinstance(data, Record)):
        segments += _announced(data, message, fields)
    if not segments:
        for name in as_names(setpoint or ()) or present(data, SETPOINTS):
            # A gap of up to a second need not end a test: a lost crossing ends a sine anyway.
            unit, parts = stretches(data, name, PAUSE)
            segments += [
                replace(run, axis=name, unit=unit, source=f"setpoint {name}")
                for time, values in parts
                for run in sines_and_sweeps(time, values)
            ]
    sines = [s for s in segments if s.kind == "sine" and s.source != "SIDS"]
    checked = (_checked(s, data, sines) for s in segments)
    return tuple(sorted(checked, key=lambda s: (s.start, s.axis)))


def _system_identification(data: Recording | Record) -> Iterator[Segment]:
    """Yield the runs of System Identification mode, one for each valid SIDS message."""
    if not isinstance(data, Recording) or "SIDS" not in data:
        return
    settings = data["SIDS"]
    # A run lasts until the next one begins, if nothing ends it before.
    for k, (start, end) in enumerate(pairwise([*settings.time.tolist(), math.inf])):
        run = {name: float(values[k]) for name, values in settings.signals.items()}
        if all(0 < run.get(name, 0) < math.inf for name in ("Ax", "FSt", "FSp", "TR")):
            yield _one_run(data, start + SYSTEMID_DELAY, end, run)


def _one_run(data: Recording, start: float, until: float, setting: Values) -> Segment:
    """Return one run from its settings; the waveform lasts TR, fades included."""
    planned_end = start + setting["TR"]
    axis = int(setting["Ax"])
    low, high = sorted((math.tau * setting["FSt"], math.tau * setting["FSp"]))
    segment = Segment(
        start,
        planned_end,
        kind="sine" if low == high else "sweep",
        axis=SYSTEMID_AXES[axis - 1] if 1 <= axis <= len(SYSTEMID_AXES) else str(axis),
        omega=low if low == high else math.nan,
        band=(low, high),
        amplitude=setting.get("Mag", math.nan),
        source="SIDS",
    )
    stop, reason = _stop_of_run(data, start - SYSTEMID_DELAY, until)
    if stop <= start:
        return segment.refused(f"ended before the waveform began{reason}")

    if stop < planned_end - EDGE:
        text = f"ended early, after {stop - start:.1f} of {planned_end - start:.1f} s{reason}"
        return replace(segment, end=stop).refused(text)

    return segment


def _stop_of_run(data: Recording, start: float, until: float) -> tuple[float, str]:
    """Return when a run stopped: where its data end, or where a text says so."""
    # Messages of the excitation are logged only while it runs.
    time = data["SIDD"].time if "SIDD" in data else np.array([until])
    last = float(time[(time >= start) & (time <= until)].max(initial=start))
    for moment, text in data.metadata.get("texts", ()):
        if start < moment < min(until, last) and text.startswith(
            ("SystemID Stop", "SystemID Land", "SystemID Par")
        ):
            return float(moment), f" ({text})"
    return last, ""


def _announced(
    data: Recording | Record, message: str, fields: Mapping[str, str] | None
) -> Iterator[Segment]:
    record = data[message] if isinstance(data, Recording) else data
    chosen = dict(fields) if fields else {k: v for k, v in ANNOUNCED.items() if v in record.signals}
    if not set(chosen) <= {*ANNOUNCED, "frequency"} or not {"omega", "frequency"} & set(chosen):
        raise ValueError(
            f"the fields of {message or 'the record'} are {', '.join(chosen) or 'not known'}: "
            "name omega or frequency and, if there are such fields, segment, axis, amplitude and "
            f"offset, as in fields={{'omega': 'W'}}; it has {', '.join(record.signals)}."
        )

    columns = {key: record[name] for key, name in chosen.items()}
    if "frequency" in columns:
        columns["omega"] = math.tau * columns.pop("frequency")
    for rows in _tests(record.time, columns):
        value: dict[str, Any] = {key: float(x[rows[0]]) for key, x in columns.items()}
        start, end = record.time[rows[[0, -1]]].tolist()
        axis = f"{value.pop('axis'):g}" if "axis" in value else ""
        value.pop("segment", None)
        unit = record.units.get(chosen.get("amplitude", ""), "")
        yield Segment(start, end, axis=axis, unit=unit, source=message or "record", **value)


def _tests(time: Array, columns: Mapping[str, Array]) -> list[IntArray]:
    """Return the rows of each test, which ends if a field changes or the message pauses."""
    change = np.diff(time) > max(PAUSE, 5 * median_step(time))
    for values in columns.values():
        # NaN differs from itself, and would cut a test at every sample.
        change = change | (np.diff(np.nan_to_num(values)) != 0)
    groups = np.split(np.arange(time.size), np.flatnonzero(change) + 1)
    return [rows for rows in groups if rows.size > 1 and columns["omega"][rows[0]] > 0]


def _checked(segment: Segment, data: Recording | Record, sines: Segments) -> Segment:
    """Refuse a test that is too short, not excited, flown by hand, or cut by a change of mode.

    Refuse a sine also if it is much shorter, or much weaker, than the others of the flight.
    """
    texts = []
    if segment.periods < 1:
        texts.append(f"shorter than one period ({segment.periods:.2f} of one)")
    if segment.amplitude == 0:
        texts.append("barely excited: the amplitude is 0")
    stick = _moving_stick(segment, data) if segment.source.startswith("setpoint ") else ""
    if stick:
        texts.append(
            f"flown by hand: the stick {stick} moves with it, and a hand varies in frequency"
        )
    for moment, mode in data.metadata.get("modes", ()):
        if segment.start + EDGE < moment < segment.end - EDGE and segment.source != "SIDS":
            texts.append(f"the mode changed to {mode} at {moment:.1f} s, during the test")

    # With two sines, neither can be called the exception.
    if segment in sines and len(sines) > 2:
        periods = median(s.periods for s in sines)
        duration = median(s.duration for s in sines)
        largest = max(s.amplitude for s in sines if s.unit == segment.unit)
        # Both, since sines of low frequency have fewer periods, and those of high frequency are
        # shorter.
        if segment.periods < 0.5 * periods and segment.duration < 0.75 * duration:
            texts.append(
                f"ended early, after {segment.periods:.1f} periods where others have about "
                f"{periods:.0f}"
            )
        if 0 < segment.amplitude < 0.01 * largest:
            texts.append(
                f"barely excited: amplitude {segment.amplitude:.3g} where others reach "
                f"{largest:.3g}"
            )
    return segment.refused(*texts) if texts else segment


def _moving_stick(segment: Segment, data: Recording | Record) -> str:
    """Return the stick of the segment's axis that moved during it, or an empty name."""
    axis = axis_of(segment.axis)
    if not axis or not isinstance(data, Recording):
        return ""
    for stick in present(data, AXES[axis].sticks):
        record, field = data.locate(stick)
        finite = np.isfinite(record[field])
        # Some logs have the stick at 10 Hz, and two samples do not show whether it moved.
        during = finite & record.during(segment.start, segment.end)
        if during.sum() > 2:
            travel = max(
                float(np.ptp(record[field][finite])),
                STICK_TRAVEL.get(stick.rpartition(".")[0], 1000.0),
            )
            # In a travel of 1000 µs, a stick at rest wanders by 1 to 5, a dead zone takes 20 to 30,
            # and a hand that flies a sine moves the stick further.
            if np.ptp(record[field][during]) > 0.05 * travel:
                return stick

    return ""


def present(data: Recording | Record, names: Iterable[str]) -> list[str]:
    """Return the names of signals that the data have; the columns of a table have bare names."""
    records = [data] if isinstance(data, Record) else [*data.values()]
    fields = set(records[0].signals) if len(records) == 1 else set()
    if isinstance(data, Recording):
        fields |= {*data.signal_names}
    # Beside p or q, a column r is a yaw rate, and no setpoint.
    return [name for name in names if name in fields and not (name == "r" and fields & {"p", "q"})]


def stretches(
    data: Recording | Record, name: str, longest_gap: float = 0.0
) -> tuple[str, list[tuple[Array, Array]]]:
    """Return the unit of a signal, and time and values of every stretch between its gaps.

    Missing samples are left out, angles are unwrapped, and gaps up to `longest_gap`, s, are
    ignored.
    """
    record, field = data.locate(name) if isinstance(data, Recording) else (data, name)
    unit = record.units.get(field, "")
    if not record.has_time:
        return unit, []
    finite = np.isfinite(record[field])
    time = record.time[finite]
    values = record[field][finite]
    # A whole turn in the unit of an angle, the jump of a heading at north.
    conversion = known_unit(unit)
    turn = math.tau / conversion.factor if conversion and conversion.si == "rad" else 0.0
    return unit, [
        (time[run], np.unwrap(values[run], period=turn) if turn else values[run])
        for run in runs_between_holes(
            time, clock_of(time), max(longest_gap, ONE_LOST * record.step)
        )
    ]


def announcing(recording: Recording) -> tuple[str, ...]:
    """Return the messages that look like announcements of tests, with the fields of `ANNOUNCED`."""
    fields = {ANNOUNCED[key] for key in ("segment", "omega", "amplitude")}
    return tuple(
        name
        for name, record in recording.items()
        if record.has_time and fields <= set(record.signals)
    )
