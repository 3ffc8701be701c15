"""PX4 logs (.ulg), through pyulog, which the extra ``px4`` installs."""

from collections.abc import Collection, Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from greybox.data.record import Record, Recording
from greybox.logs.readers import named_arrays
from greybox.logs.readers.ardupilot_metadata import armed_intervals
from greybox.logs.readers.messages import bare

ARMED = 2  # vehicle_status.arming_state
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


def read(path: str | Path, messages: Collection[str] | None = None) -> Recording:
    """Read a PX4 log.

    Parameters
    ----------
    path : str or Path
    messages : collection of str, optional
        Topics to read, e.g. ``("vehicle_attitude",)``; all by default. Metadata are always read.

    Returns
    -------
    Recording
        Times in s since the vehicle's start, SI values; a PX4 log knows no units. Elements of arrays are signals
        ``q[0]``, ``q[1]`` ...; several instances of a topic are named ``sensor_accel[0]``, ``sensor_accel[1]``.

    Raises
    ------
    ValueError
        If pyulog is not installed, or nothing in the file can be read.
    OSError
        If the file cannot be opened.
    """
    path = Path(path)
    asked = bare(messages)
    if find_spec("pyulog") is None:
        raise ValueError(f"{path} is a PX4 log, which needs pyulog: install it with pip install 'greybox-id[px4]'.")
    found = named_arrays.contents("ulog", path, *(sorted({STATUS, *asked}) if asked else ()))
    whole = named_arrays.recording(path, found, None, found.about["parameters"])
    topics = {name: name.partition("[")[0] for name in whole}
    about = {**_about(found.about), **(_states(whole[STATUS]) if STATUS in topics.values() else {})}
    kept = {name: record for name, record in whole.items() if asked is None or topics[name] in asked}
    missing = tuple(f"there is no topic {name}." for name in sorted({*(asked or ())} - {*topics.values()}))
    return Recording(kept, whole.source, whole.checksum, about, (*missing, *whole.findings))


def _about(said: Mapping[str, Any]) -> dict[str, Any]:
    info = said["info"]
    known = {
        "vehicle": info.get("sys_name"),
        "firmware": info.get("ver_sw"),
        "parameters": {name: float(value) for name, value in said["parameters"].items()},
        "defaults": {name: float(value) for name, value in said["defaults"].items()},
        "texts": tuple((ticks / 1e6, text) for ticks, text in said["texts"]),
    }
    return {key: value for key, value in known.items() if value}


def _states(status: Record) -> dict[str, Any]:
    """Return modes and armed times from the vehicle's status."""
    known: dict[str, Any] = {}
    time = status.time.tolist()
    if "nav_state" in status.signals:
        names = [MODES.get(int(state), f"mode {state:g}") for state in status["nav_state"]]
        known["modes"] = tuple(_changes(zip(time, names, strict=True)))
    if "arming_state" in status.signals:
        armed = (status["arming_state"] == ARMED).tolist()
        changes = list(_changes(zip(time, armed, strict=True)))
        known["armed"] = armed_intervals(changes if armed[0] else changes[1:], (time[0], time[-1]))
    return known


def _changes(states: Iterable[tuple[float, Any]]) -> Iterable[tuple[float, Any]]:
    last = object()
    for time, state in states:
        if state != last:
            yield time, state
        last = state
