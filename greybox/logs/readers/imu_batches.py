"""Batches of raw IMU samples in ArduPilot logs: ISBH describes a batch, ISBD messages hold 32 samples of it each.

Sources: AP_InertialSensor/BatchSampler.cpp and LogStructure.h of ArduPilot;
https://ardupilot.org/copter/docs/common-imu-batchsampling.html.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.files.arrays import Array, IntArray
from greybox.logs.readers.messages import Messages

HEADER, DATA = "ISBH", "ISBD"
AXES = ("x", "y", "z")
SAMPLES = 32  # in a message
KINDS = {0: ("accel", "m/s²"), 1: ("gyro", "rad/s")}  # ISBH.type
SENSOR = "sensor"
STARTED = (
    10.0  # s before its header, at most, that a batch began: older stamps are of another clock
)
NEEDED = ("N", "type", "instance", "mul", "smp_rate", "SampleUS")


def with_batches(groups: Sequence[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Return the messages of a log with ISBD as samples in time, one record a sensor, and what was left out.

    The records are ``ISBD[gyro0]``, ``ISBD[accel1]`` ..., with signals x, y, z in rad/s and m/s².
    Between batches there are gaps.
    """
    by_name = {group.name: group for group in groups}
    header, data = by_name.get(HEADER), by_name.get(DATA)
    others = [group for group in groups if group.name != DATA]
    if data is None or not len(data):
        return list(groups), ()
    if header is None or header.time is None or not set(NEEDED) <= header.columns.keys():
        return others, (
            f"{DATA}: its batches have no {HEADER} that describes them and were left out.",
        )
    if not {"N", "seqno"} <= data.columns.keys() or not _holds_samples(data):
        return others, (f"{DATA}: its batches have no samples and were left out.",)

    samples = np.stack(
        [np.stack([data.columns[f"{a}[{k}]"] for k in range(SAMPLES)], axis=1) for a in AXES]
    )
    bounds = [*np.searchsorted(data.order, header.order).tolist(), len(data)]
    parts = []
    lost = 0
    for k in range(len(header)):
        number, kind, instance, divisor, rate, begin = (
            float(header.columns[name][k]) for name in NEEDED
        )
        rows = np.arange(bounds[k], bounds[k + 1])  # up to the next header
        rows = rows[data.columns["N"][rows] == number]
        if not rows.size or kind not in KINDS or not (divisor > 0 and rate > 0):
            lost += 1
            continue
        start = (
            begin / 1e6 if 0 <= header.time[k] - begin / 1e6 < STARTED else float(header.time[k])
        )
        place = data.columns["seqno"][rows][:, None] * SAMPLES + np.arange(SAMPLES)
        values = samples[:, rows].reshape(3, -1) / divisor
        label = f"{KINDS[int(kind)][0]}{instance:g}"
        parts.append(
            (start + place.ravel() / rate, values, np.repeat(data.order[rows], SAMPLES), label)
        )
    findings = (
        (f"{DATA}: {lost} batches have no sound {HEADER} or no samples and were left out.",)
        if lost
        else ()
    )
    made = [
        _joined([part for part in parts if part[3] == label])
        for label in dict.fromkeys(part[3] for part in parts)
    ]
    return [*others, *made], findings


def _holds_samples(data: Messages) -> bool:
    return all(f"{axis}[{k}]" in data.columns for axis in AXES for k in (0, SAMPLES - 1))


def _joined(
    parts: Sequence[tuple[Array, Array, IntArray, str]],
) -> Messages:
    time, values, order = (np.concatenate([part[k] for part in parts], axis=-1) for k in range(3))
    sorting = np.argsort(time, kind="stable")
    label = parts[0][3]
    unit = next(unit for kind, unit in KINDS.values() if label.startswith(kind))
    named = Messages(
        DATA,
        order,
        time,
        dict(zip(AXES, values, strict=True)),
        {SENSOR: [label] * time.size},
        dict.fromkeys(AXES, unit),
        SENSOR,
    ).rows(sorting)
    return replace(
        named,
        columns={name: np.ascontiguousarray(column) for name, column in named.columns.items()},
    )
