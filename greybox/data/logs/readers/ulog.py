"""PX4 logs (.ulg), through pyulog, which the extra ``px4`` installs."""

import re
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.files.named_values import non_empty, without
from greybox.data.logs.parameter_history import parameter_changes
from greybox.data.logs.readers import named_arrays
from greybox.data.logs.readers.messages import MessageNames, bare
from greybox.data.record import Record, Recording

MODES = {  # vehicle_status.nav_state
    0: "MANUAL",
    1: "ALTCTL",
    2: "POSCTL",
    3: "AUTO_MISSION",
    4: "AUTO_LOITER",
    5: "AUTO_RTL",
    10: "ACRO",
    12: "DESCEND",
    13: "TERMINATION",
    14: "OFFBOARD",
    15: "STAB",
    17: "AUTO_TAKEOFF",
    18: "AUTO_LAND",
    19: "AUTO_FOLLOW_TARGET",
    20: "AUTO_PRECLAND",
    21: "ORBIT",
    22: "AUTO_VTOL_TAKEOFF",
}
STATUS = "vehicle_status"
QUATERNIONS = {"vehicle_attitude": "q", "vehicle_attitude_setpoint": "q_d"}
RATES = {  # fields in rad/s
    "vehicle_angular_velocity": r"xyz\[\d\]",
    "vehicle_rates_setpoint": "roll|pitch|yaw",
    "vehicle_attitude": "(roll|pitch|yaw)speed",
    "autotune_attitude_control_status": r"rate_sp\[\d\]",
}


def read(path: Path, messages: MessageNames = None) -> Recording:
    """Read a PX4 log.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Topics to read, e.g. ``("vehicle_attitude",)``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Times in s since the vehicle's start, SI values; a PX4 log knows no units. Elements of
        arrays are signals ``q[0]``, ``q[1]`` ...; of attitudes and their setpoints the angles roll,
        pitch and yaw are added. Several instances of a topic are named ``sensor_accel[0]``,
        ``sensor_accel[1]``.

    Raises
    ------
    ValueError
        If pyulog is not installed, or nothing in the file can be read.
    OSError
        If the file cannot be opened.
    """
    topics_wanted = bare(messages)
    if find_spec("pyulog") is None:
        raise ValueError(
            f"{path} is a PX4 log, which needs pyulog: install it with pip install "
            "'greybox-id[px4]'."
        )

    # The modes are in the status, which is always read for them.
    report, groups = named_arrays.read_contents(
        "ulog", path, *(sorted({STATUS, *topics_wanted}) if topics_wanted else ())
    )
    about = _about(report["about"])
    parameters = about.get("parameters", {})
    recording = named_arrays.recording(path, groups, report["findings"], None, parameters)
    topics = {name: name.partition("[")[0] for name in recording}
    if STATUS in topics.values():
        about |= modes_of(recording[STATUS])
    by_name = {
        name: with_angles(topics[name], record)
        for name, record in recording.items()
        if topics_wanted is None or topics[name] in topics_wanted
    }
    missing = tuple(
        f"there is no topic {name}."
        for name in sorted({*(topics_wanted or ())} - {*topics.values()})
    )

    return Recording(
        by_name, recording.source, recording.checksum, about, (*missing, *recording.findings)
    )


def _about(facts: Mapping[str, Any]) -> dict[str, Any]:
    release, commit = facts["firmware"]
    written = [(0.0, name, value) for name, value in facts["initial"].items()]
    written += [(ticks / 1e6, name, value) for ticks, name, value in facts["changes"]]
    return non_empty(
        {
            "vehicle": facts["vehicle"],
            "firmware": f"{release} ({commit})" if release and commit else release or commit,
            "parameters": {name: float(value) for _, name, value in written},
            "parameter_changes": parameter_changes(written),
            "texts": tuple((ticks / 1e6, text) for ticks, text in facts["texts"]),
        }
    )


def with_angles(name: str, record: Record) -> Record:
    """Add roll, pitch and yaw, rad, to a record of quaternions, and the units of known fields."""
    units = {field: "rad/s" for field in record.signals if re.fullmatch(RATES.get(name, ""), field)}
    # Quaternions w, x, y, z turn from the vehicle to the earth.
    first, *_ = parts = [f"{QUATERNIONS.get(name, '')}[{k}]" for k in range(4)]
    angles: dict[str, Any] = {}
    if {*parts} <= {*record.signals}:
        w, x, y, z = (record[part] for part in parts)
        angles = {
            "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            # Rounding in single precision may exceed one.
            "pitch": np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
            "yaw": np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        }
        angles = without(angles, record.signals)

    hold = dict.fromkeys(angles, record.hold[first]) if first in record.hold else {}

    return replace(
        record,
        signals={**record.signals, **angles},
        units={**record.units, **units, **dict.fromkeys(angles, "rad")},
        hold={**record.hold, **hold},
    )


def modes_of(status: Record) -> dict[str, tuple[tuple[float, str], ...]]:
    """Return the time of every change of the flight mode, s, and the new mode."""
    if "nav_state" not in status.signals:
        return {}
    states = status["nav_state"]
    changes = np.flatnonzero(np.append(True, np.diff(states) != 0))
    names = [MODES.get(int(state), f"mode {state:g}") for state in states[changes]]
    return {"modes": tuple(zip(status.time[changes].tolist(), names, strict=True))}
