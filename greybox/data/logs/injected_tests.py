"""Tests in which a flight controller injects a signal of its own and logs it.

Betaflight's chirp mode adds a chirp to the setpoint of one angular velocity, and PX4's autotuning
adds steps or sweeps to it.

Sources: DEBUG_CHIRP in pid.c of https://github.com/betaflight/betaflight;
AutotuneAttitudeControlStatus.msg of https://github.com/PX4/PX4-Autopilot.
"""

import math
from collections.abc import Iterator

import numpy as np

from greybox.data.excited_segment import Segment
from greybox.data.files.arrays import Array, BoolArray, IntArray, Interval
from greybox.data.record import Record, Recording, runs_between_gaps

INJECTED = "injected "  # begins the source of such a test, and the signal follows
AXES = ("roll", "pitch", "yaw")
CHIRP, PHASE = "chirp", "debug[0]"
AUTOTUNE = "autotune_attitude_control_status"


def injected_tests(data: Recording | Record) -> Iterator[Segment]:
    """Yield the tests of Betaflight's chirp mode and of PX4's autotuning."""
    records = data.records if isinstance(data, Recording) else {data.name: data}
    for name, record in records.items():
        if CHIRP in record.signals and PHASE in record.signals:
            yield from _chirps(record)
        elif name == AUTOTUNE:
            yield from _autotuning(record)


def _chirps(record: Record) -> Iterator[Segment]:
    """Yield the runs of Betaflight's chirp mode."""
    phase = np.nan_to_num(record[PHASE]) / 5000  # counts in a radian
    for rows in _runs(record.time, phase > 0):
        # Only firmware since 2026 logs the axis: it is the one whose control moves with the chirp.
        turning = np.exp(1j * phase[rows])
        controls = [record.signals.get(f"axisSum[{k}]", 0 * phase)[rows] for k in range(3)]
        axis = AXES[np.argmax([abs(np.mean(control * turning)) for control in controls])]
        low, high, count = _band(record.time[rows], phase[rows])
        yield _segment(record, rows[:count], CHIRP, axis, "sweep", (low, high))


def _autotuning(record: Record) -> Iterator[Segment]:
    """Yield the stretches in which PX4's autotuning moves the setpoint of one axis."""
    for k, axis in enumerate(AXES):
        name = f"rate_sp[{k}]"
        values = record.signals.get(name, np.zeros(len(record)))
        for rows in _runs(record.time, np.nan_to_num(values) != 0):
            lasts = float(record.time[rows[-1]] - record.time[rows[0]])
            # The message gives no band: from six periods, the fewest of an estimate, upward.
            band = (12 * math.pi / lasts, math.pi / record.step)
            yield _segment(record, rows, f"{AUTOTUNE}.{name}", axis, "noise", band)


def _runs(time: Array, active: BoolArray) -> list[IntArray]:
    """Return the samples of every stretch of activity without a pause."""
    samples = np.flatnonzero(active)
    # The phase of a chirp is zero for moments, and the steps of an autotuning cross zero.
    runs = [samples[run] for run in runs_between_gaps(time[samples], 1.0)]
    # A shorter one is an aborted start.
    return [run for run in runs if run.size > 1 and time[run[-1]] - time[run[0]] > 2.0]


def _segment(
    record: Record,
    rows: IntArray,
    signal: str,
    axis: str,
    kind: str,
    band: Interval,
) -> Segment:
    start, end = record.time[rows[[0, -1]]]
    size = float(np.nanmax(np.abs(record[signal.rpartition(".")[2]][rows])))
    return Segment(
        float(start), float(end), kind, axis, band=band, amplitude=size, source=INJECTED + signal
    )


def _band(time: Array, phase: Array) -> tuple[float, float, int]:
    """Return the first and the last frequency of a chirp, rad/s, and its number of samples."""
    steps = np.diff(phase) % math.tau
    # Beyond half the sampling rate, steps of the phase are over half a turn.
    beyond = np.flatnonzero(np.convolve(steps > math.pi, np.ones(3), "valid") == 3)
    last = int(beyond[0]) if beyond.size else time.size
    frequency = steps[: last - 1] / np.diff(time[:last])
    edge = max(last // 50, 2)
    return float(np.median(frequency[:edge])), float(np.median(frequency[-edge:])), last
