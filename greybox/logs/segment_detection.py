"""The excited parts of a flight: System Identification mode, announced sine tests, or sines seen in a setpoint."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment

Array = NDArray[np.float64]
ANNOUNCED = {"segment": "Seg", "axis": "Ax", "omega": "W", "amplitude": "Eta", "offset": "Th0"}
SETPOINTS = (
    "ATT.DesRoll",
    "ATT.DesPitch",
    "ATT.DesYaw",
    "r",
    "setpoint",
    "reference",
)  # looked through when no setpoint is named
DELAY = 1.0  # s, SYSTEM_ID_DELAY: the waveform starts this long after the mode (ArduCopter/mode_systemid.cpp)
AXES = (  # SID_AXIS of ArduCopter, from 1
    "input roll,input pitch,input yaw,recovery roll,recovery pitch,recovery yaw,rate roll,rate pitch,rate yaw,"
    "mixer roll,mixer pitch,mixer yaw,mixer thrust,measured lateral position,measured longitudinal position,"
    "measured lateral velocity,measured longitudinal velocity,input lateral velocity,input longitudinal velocity"
).split(",")


def find_segments(
    data: Recording | Record,
    message: str = "",
    fields: Mapping[str, str] | None = None,
    setpoint: str | Sequence[str] = (),
) -> tuple[Segment, ...]:
    """Return the excited segments of a flight, in order of time.

    Looked for in this order: runs of ArduPilot's System Identification mode (messages SIDS and SIDD); tests announced
    in `message`; if neither gave anything, runs of nearly constant frequency (and sweeps) in the setpoint itself.

    Parameters
    ----------
    data : Recording or Record
        A log, or one record (a prepared one: its signals are then looked up by their bare names).
    message : str
        Message that announces a sine test while it runs.
    fields : mapping
        Which field of that message says what: keys ``omega`` (rad/s) or ``frequency`` (Hz), and, if there are such
        fields, ``segment`` (number of the test), ``axis``, ``amplitude``, ``offset``. Default: `ANNOUNCED`, as far as
        the message has them. A test ends where one of these changes, or where the message pauses for a second.
    setpoint : str or sequence of str
        Signals to look through for sines, ``"ATT.DesPitch"``; default: those of `SETPOINTS` that exist.

    Raises
    ------
    KeyError, ValueError
        If the message, a field or a setpoint that was named does not exist; the sentence says what there is.
    """
    found = [*_system_identification(data)]
    if message or (fields and isinstance(data, Record)):
        found += _announced(data, message, fields)
    if not found:
        names = [setpoint] if isinstance(setpoint, str) and setpoint else setpoint
        found = [s for name in names or _there(data) for s in _in_setpoint(data, name)]
    found = _flag_early_ends([_checked(s, data) for s in found])
    return tuple(sorted(found, key=lambda s: (s.start, s.axis)))


def _system_identification(data: Recording | Record) -> list[Segment]:
    """Return the runs of ArduPilot's System Identification mode, one for each SIDS message that makes sense."""
    if not isinstance(data, Recording) or "SIDS" not in data:
        return []
    settings = data["SIDS"]
    ends = [*settings.time[1:].tolist(), math.inf]
    runs = [{name: float(values[k]) for name, values in settings.signals.items()} for k in range(len(ends))]
    return [
        _one_run(data, float(start) + DELAY, end, run)
        for start, end, run in zip(settings.time, ends, runs, strict=True)
        if all(0 < run.get(name, 0) < math.inf for name in ("Ax", "FSt", "FSp", "TR"))
    ]


def _one_run(data: Recording, start: float, until: float, value: Mapping[str, float]) -> Segment:
    """Return one run from its settings; the waveform lasts TR, fades included."""
    planned, axis = start + value["TR"], int(value["Ax"])
    low, high = sorted((2 * math.pi * value["FSt"], 2 * math.pi * value["FSp"]))
    kind, omega = ("sine", low) if low == high else ("sweep", math.nan)
    name = AXES[axis - 1] if 1 <= axis <= len(AXES) else str(axis)
    size = value.get("Mag", math.nan)
    segment = Segment(start, planned, kind, name, omega, (low, high), amplitude=size, source="SIDS")
    stop, reason = _stop_of_run(data, start - DELAY, until)
    if stop <= start:
        return segment.refused(f"ended before the waveform began{reason}")
    if stop < planned - 0.1:
        text = f"ended early, after {stop - start:.1f} of {planned - start:.1f} s{reason}"
        return replace(segment, end=stop).refused(text)
    return segment


def _stop_of_run(data: Recording, start: float, until: float) -> tuple[float, str]:
    """Return when a run stopped: its data end, or a text says that it was stopped (the data then go on)."""
    time = data["SIDD"].time if "SIDD" in data else np.array([until])
    last = float(time[(time >= start) & (time <= until)][-1:].sum()) or start
    for moment, text in data.metadata.get("texts", ()):
        if start < moment < min(until, last) and text.startswith(("SystemID Stop", "SystemID Land", "SystemID Par")):
            return float(moment), f" ({text})"
    return last, ""


def _announced(data: Recording | Record, message: str, fields: Mapping[str, str] | None) -> list[Segment]:
    record = data[message] if isinstance(data, Recording) else data
    chosen = dict(fields) if fields else {k: v for k, v in ANNOUNCED.items() if v in record.signals}
    unknown = set(chosen) - {*ANNOUNCED, "frequency"}
    if unknown or not {"omega", "frequency"} & set(chosen):
        what = f"{sorted(unknown)[0]!r} is not one of them" if unknown else "neither omega nor frequency is among them"
        raise ValueError(
            f"the fields of {message or 'the record'} must be given as {', '.join(ANNOUNCED)} or frequency, but {what}"
            f': write fields={{"omega": "W"}}; the message has {", ".join(record.signals)}.'
        )
    columns = {key: record[name] for key, name in chosen.items()}
    if "frequency" in columns:
        columns["omega"] = 2 * np.pi * columns.pop("frequency")
    unit = record.units.get(chosen.get("amplitude", ""), "")
    return [_one_test(record, rows, columns, unit, message) for rows in _tests(record.time, columns)]


def _tests(time: Array, columns: Mapping[str, Array]) -> list[NDArray[np.intp]]:
    """Return the rows of each test: cut where a field changes or the message pauses; omega 0 or NaN is no test."""
    change = np.diff(time) > max(1.0, 5 * float(np.median(np.diff(time)))) if time.size > 1 else np.zeros(0, bool)
    for values in columns.values():
        change = change | (np.diff(np.nan_to_num(values)) != 0)
    groups = np.split(np.arange(time.size), np.flatnonzero(change) + 1)
    return [rows for rows in groups if rows.size > 1 and columns["omega"][rows[0]] > 0]


def _one_test(record: Record, rows: NDArray[np.intp], columns: Mapping[str, Array], unit: str, message: str) -> Segment:
    value = {key: float(values[rows[0]]) for key, values in columns.items()}
    start, end = float(record.time[rows[0]]), float(record.time[rows[-1]])
    axis, source = f"{value['axis']:g}" if "axis" in value else "", message or "record"
    omega, size, offset = (value.get(key, math.nan) for key in ("omega", "amplitude", "offset"))
    return Segment(start, end, axis=axis, omega=omega, amplitude=size, offset=offset, unit=unit, source=source)


def _checked(segment: Segment, data: Recording | Record) -> Segment:
    """Refuse a test that is too short, not excited, or during which the flight mode changed: the pilot took over."""
    texts = []
    if segment.periods < 1:
        texts.append(f"shorter than one period ({segment.periods:.2f} of one)")
    if segment.amplitude == 0:
        texts.append("barely excited: the amplitude is 0")
    for moment, mode in data.metadata.get("modes", ()):
        if segment.start + 0.1 < moment < segment.end - 0.1 and segment.source != "SIDS":
            texts.append(f"the mode changed to {mode} at {moment:.1f} s, during the test")
    return segment.refused(*texts) if texts else segment


def _flag_early_ends(segments: list[Segment]) -> list[Segment]:
    """Refuse sines with less than half of the periods and less than 3/4 of the time that the others have."""
    sines = [s for s in segments if s.kind == "sine" and s.source != "SIDS"]
    if len(sines) < 3:
        return segments
    periods = float(np.median([s.periods for s in sines]))
    duration = float(np.median([s.duration for s in sines]))
    loudest = {s.unit: max(t.amplitude for t in sines if t.unit == s.unit) for s in sines}

    def flagged(s: Segment) -> Segment:
        if s not in sines:
            return s
        if s.periods < 0.5 * periods and s.duration < 0.75 * duration:
            s = s.refused(f"ended early, after {s.periods:.1f} periods where others have about {periods:.0f}")
        if 0 < s.amplitude < 0.01 * loudest[s.unit]:
            s = s.refused(f"barely excited: amplitude {s.amplitude:.3g} where others reach {loudest[s.unit]:.3g}")
        return s

    return [flagged(s) for s in segments]


def _there(data: Recording | Record) -> list[str]:
    """Return those of the usual setpoints that the data have."""
    if isinstance(data, Record):
        return [name for name in SETPOINTS if name in data.signals]
    fields = {f"{key}.{name}" for key, record in data.items() for name in record.signals}
    table = set(next(iter(data.values())).signals) if len(data) == 1 else set()  # its columns go by their bare names
    return [name for name in SETPOINTS if name in fields | table]


def _in_setpoint(data: Recording | Record, name: str) -> list[Segment]:
    record, field = data.locate(name) if isinstance(data, Recording) else (data, name)
    words = {"axis": name, "unit": record.units.get(field, ""), "source": f"setpoint {name}"}
    known = [(piece, np.isfinite(piece[field])) for piece in record.pieces]
    return [replace(s, **words) for piece, k in known for s in steady_runs(piece.time[k], piece[field][k])]


def steady_runs(time: Array, values: Array) -> list[Segment]:
    """Return the sines (two periods at least) and sweeps in one signal, (n,) arrays.

    Half periods end where the signal crosses the middle between turning points, of several least heights. Crossings on
    one line form a piece. A piece whose fitted sine explains 85 % of the variance is a sine, unless its phase bends;
    three or more bent pieces on end, ever faster or ever slower, are a sweep.
    """
    if time.size < 8 or not 1e-100 < np.ptp(values) < 1e100:
        return []
    corners, candidates = np.arange(time.size), []
    for height in np.ptp(values) * np.array([0.01, 0.03, 0.1, 0.25, 0.5]):
        corners = _turning_points(values, corners, float(height))
        crossings, swings = _crossings(time, values, corners)
        pieces = [_fitted(time, values, crossings[a:b]) for a, b in _runs(crossings, swings)]
        candidates += [s for s in pieces if s is not None and s.kind == "sine"]
        candidates += _sweeps([s for s in pieces if s is not None and s.kind == "sweep"])
    kept: list[Segment] = []
    for run in sorted(candidates, key=lambda s: -s.duration):
        if all(min(run.end, k.end) - max(run.start, k.start) < 0.1 * run.duration for k in kept):
            kept.append(run)
    alone = [s for s in kept if not any(_part_of(s, w) for w in kept if w.kind == "sweep")]
    return sorted(alone, key=lambda s: s.start)


def _turning_points(values: Array, corners: NDArray[np.intp], height: float) -> NDArray[np.intp]:
    """Return those of the indices `corners` where the signal turns by at least `height`."""
    found, up, extreme = [], 0, int(corners[0])
    levels = values[corners].tolist()
    low = high = top = levels[0]
    for index, level in zip(corners.tolist(), levels, strict=True):
        if up == 0:
            low, high = min(low, level), max(high, level)
            up = (level - low >= height) - (high - level >= height)
            extreme, top = index, level
        elif (level - top) * up > 0:
            extreme, top = index, level
        elif (top - level) * up >= height:
            found.append(extreme)
            up, extreme, top = -up, index, level
    return np.array([corners[0], *found, extreme], dtype=np.intp)


def _crossings(time: Array, values: Array, corners: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return when the signal crosses the middle between successive turning points, s, and how far apart these are."""
    times = []
    for a, b in pairwise(corners):
        part = (values[a : b + 1] - (values[a] + values[b]) / 2) * np.sign(values[b] - values[a])
        last, first = a + np.flatnonzero(part <= 0)[-1:], a + np.flatnonzero(part >= 0)[:1]
        times.append((time[last[0]] + time[first[0]]) / 2 if last.size and first.size else time[a])
    return np.array(times), np.abs(np.diff(values[corners]))


def _runs(crossings: Array, swings: Array) -> list[tuple[int, int]]:
    """Return first and one past the last of the crossings that lie on one line and are of one height, five at least."""
    runs, start, end = [], 0, 3
    while end <= crossings.size:
        if end < crossings.size and _keeps(crossings[start : end + 1][-400:], swings[start : end + 1][-5:]):
            end += 1
            continue
        long = end - start >= 5
        runs += [(start, end)] if long else []
        start = end - 1 if long else start + 1
        end = start + 3
    return runs


def _keeps(crossings: Array, swings: Array) -> bool:
    """Tell whether the last crossing lies within 0.2 of where the line through the others has it, and is as high."""
    n = crossings.size - 1
    past, count = crossings[:-1], np.arange(n) - (n - 1) / 2
    half = 12 * float(count @ past) / (n * (n * n - 1))
    off = abs(crossings[-1] - past.mean() - half * (n + 1) / 2)
    return bool(off < 0.2 * half and 0.6 < swings[-1] / np.median(swings[:-1]) < 1.6)


def _fitted(time: Array, values: Array, crossings: Array) -> Segment | None:
    """Fit offset, trend, sine and its frequency, then stretch the ends as far as the signal follows."""
    index, apart = np.arange(crossings.size), crossings.size // 2
    half = float(np.median(crossings[apart:] - crossings[:-apart])) / apart
    off = np.abs(crossings - half * index - np.median(crossings - half * index))
    good = crossings[off < max(0.03 * half, 5 * float(np.median(off)))]  # the first and the last may be transients
    if good.size < 5 or good[-1] - good[0] < 8 * float(np.median(np.diff(time))):
        return None
    start, end, omega, period = float(good[0]), float(good[-1]), math.pi / half, 2 * half
    around = slice(*np.searchsorted(time, (start - period, end + period)))
    time, values, reach = time[around], values[around], float(np.ptp(values))
    rows = (time >= start) & (time <= end)
    t, x = time[rows], values[rows]
    if t.size < 8 * (end - start) / period:
        return None
    c, middle = np.zeros(6), (start + end) / 2
    for _ in range(4):  # a sin + b cos changes with omega by a t cos - b t sin
        c = np.linalg.lstsq(_waves(t - middle, omega, 6), x, rcond=None)[0]
        step = (c[2] * c[4] + c[3] * c[5]) / (c[2] ** 2 + c[3] ** 2 + 1e-300)
        omega += float(np.clip(step, -0.1 * omega, 0.1 * omega))
    bow = np.linalg.lstsq(_waves(t - middle, omega, 8), x, rcond=None)[0]
    bent = abs(c[2] * bow[7] - c[3] * bow[6]) / (c[2] ** 2 + c[3] ** 2 + 1e-300) * (end - start) ** 2 / 4  # rad
    c = np.linalg.lstsq(_waves(t - middle, omega, 4), x, rcond=None)[0]
    off = np.abs(values - _waves(time - middle, omega, 4) @ c)
    amplitude, error = math.hypot(c[2], c[3]), float(np.sqrt(np.mean(off[rows] ** 2)))
    if amplitude < 0.005 * reach or error**2 > (0.5 if bent > 0.12 else 0.15) * (amplitude**2 / 2 + error**2):
        return None
    if bent > 0.12:
        return Segment(start, float(crossings[-1]), "sweep", band=(omega, omega), amplitude=amplitude)
    bad = time[off > max(0.05 * amplitude, 4 * error)]
    first, last = bad[bad < start].max(initial=time[0]), bad[bad > end].min(initial=time[-1])
    run = Segment(float(first), float(last), omega=omega, amplitude=amplitude, offset=float(c[0]))
    return run if run.duration >= 1.0 else None


def _sweeps(pieces: list[Segment]) -> list[Segment]:
    """Join pieces on end whose frequency moves one way, three at least and by 30 % at least."""
    chains: list[list[Segment]] = []
    for piece in pieces:
        chain = chains[-1] if chains else [piece]
        ways = {b.band[0] > a.band[0] for a, b in pairwise([*chain, piece])}
        if chains and len(ways) == 1 and piece.start - chain[-1].end < 2 * math.pi / piece.band[0]:
            chain.append(piece)
        else:
            chains.append([piece])
    ends = [(c[0], c[-1], *sorted((c[0].band[0], c[-1].band[0]))) for c in chains if len(c) > 2]
    return [replace(a, end=b.end, band=(low, high)) for a, b, low, high in ends if high > 1.3 * low]


def _part_of(sine: Segment, sweep: Segment) -> bool:
    """Tell whether a "sine" is the slow start or the end of a sweep: short, and next to it."""
    reach = 0.3 * sweep.duration if sine.duration < 0.05 * sweep.duration else 2 * sine.duration
    near = max(sweep.start - sine.end, sine.start - sweep.end) < reach
    edge = sweep.band[0] / 1.5 < sine.omega < sweep.band[1] * 1.5 and sine.duration < 0.15 * sweep.duration
    return sine.kind == "sine" and near and (edge or sine.periods < 4)


def _waves(x: Array, omega: float, columns: int) -> Array:
    """Return the columns 1, x, sin, cos, x cos, -x sin, x² sin, x² cos, as many as asked for."""
    s, c = np.sin(omega * x), np.cos(omega * x)
    return np.stack([np.ones_like(x), x, s, c, x * c, -x * s, x * x * s, x * x * c][:columns], axis=-1)
