"""Raw samples of the IMU in ArduPilot logs: ISBH describes a batch, ISBD messages hold 32 samples each.

Sources: AP_InertialSensor/BatchSampler.cpp and LogStructure.h of ArduPilot;
https://ardupilot.org/copter/docs/common-imu-batchsampling.html.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from greybox.files.arrays import Array, IntArray
from greybox.logs.readers.messages import Messages

HEADER = "ISBH"
DATA = "ISBD"
AXES = ("x", "y", "z")
SAMPLES = 32  # in a message
KINDS = {0: ("accel", "m/s²"), 1: ("gyro", "rad/s")}  # ISBH.type
NEEDED = ("N", "type", "instance", "mul", "smp_rate", "SampleUS")


class _Batch(NamedTuple):
    sensor: str
    unit: str
    time: Array
    values: Array
    order: IntArray


def with_batches(groups: Sequence[Messages]) -> tuple[list[Messages], tuple[str, ...]]:
    """Return the messages with ISBD as samples in time, one group for each sensor, and findings.

    The groups become the records ``ISBD[gyro0]``, ``ISBD[accel1]`` ..., with signals x, y, z in
    rad/s and m/s². Between batches there are gaps.
    """
    by_name = {group.name: group for group in groups}
    header = by_name.get(HEADER)
    data = by_name.get(DATA)
    remaining = [group for group in groups if group.name != DATA]
    if data is None or not len(data):
        return list(groups), ()
    if header is None or header.time is None or not set(NEEDED) <= header.columns.keys():
        return remaining, (
            f"{DATA}: its batches have no {HEADER} that describes them and were left out.",
        )
    fields = [f"{axis}[{k}]" for axis in AXES for k in range(SAMPLES)]
    if not {"N", "seqno", *fields} <= data.columns.keys():
        return remaining, (f"{DATA}: its batches have no samples and were left out.",)

    samples = np.array([data.columns[name] for name in fields]).reshape(3, SAMPLES, -1)
    bounds = [*np.searchsorted(data.order, header.order).tolist(), len(data)]
    batches = []
    for k in range(len(header)):
        setting = {name: float(header.columns[name][k]) for name in NEEDED}
        rows = np.arange(bounds[k], bounds[k + 1])  # up to the next header
        rows = rows[data.columns["N"][rows] == setting["N"]]
        is_sound = setting["type"] in KINDS and setting["mul"] > 0 and setting["smp_rate"] > 0
        if not rows.size or not is_sound:
            continue
        logged = float(header.time[k])
        start = setting["SampleUS"] / 1e6
        if not 0 <= logged - start < 10:  # s; older stamps are of another clock
            start = logged
        place = data.columns["seqno"][rows][:, None] * SAMPLES + np.arange(SAMPLES)
        kind, unit = KINDS[int(setting["type"])]
        batches.append(
            _Batch(
                f"{kind}{setting['instance']:g}",
                unit,
                start + place.ravel() / setting["smp_rate"],
                samples[:, :, rows].transpose(0, 2, 1).reshape(3, -1) / setting["mul"],
                np.repeat(data.order[rows], SAMPLES),
            )
        )
    lost = len(header) - len(batches)
    findings = (
        (f"{DATA}: {lost} batches have no sound {HEADER} or no samples and were left out.",)
        if lost
        else ()
    )
    sensors = dict.fromkeys(batch.sensor for batch in batches)
    joined = [_joined([b for b in batches if b.sensor == sensor]) for sensor in sensors]
    return [*remaining, *joined], findings


def _joined(batches: Sequence[_Batch]) -> Messages:
    time = np.concatenate([batch.time for batch in batches])
    values = np.concatenate([batch.values for batch in batches], axis=1)
    sorting = np.argsort(time, kind="stable")
    return Messages(
        DATA,
        np.concatenate([batch.order for batch in batches])[sorting],
        time[sorting],
        {axis: x[sorting] for axis, x in zip(AXES, values, strict=True)},
        {"sensor": [batches[0].sensor] * time.size},
        dict.fromkeys(AXES, batches[0].unit),
        "sensor",
    )
