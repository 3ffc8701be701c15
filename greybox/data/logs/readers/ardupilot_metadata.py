"""Metadata of an ArduPilot log: vehicle, firmware, parameters, texts, modes; names of units."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

from pymavlink.mavutil import mode_mapping_bynumber

from greybox.data.files.named_values import non_empty
from greybox.data.logs.parameter_history import parameter_changes
from greybox.data.logs.readers.messages import Messages

# The firmware's names for itself, and its MAV_TYPE of MAVLink, by which pymavlink knows the modes.
VEHICLES = {
    "ArduCopter": 2,
    "ArduPlane": 1,
    "ArduRover": 10,
    "APMrover2": 10,
    "ArduSub": 12,
    "AntennaTracker": 5,
    "Blimp": 7,
    "APM:Copter": 2,  # this and the next until 2017
    "APM:Plane": 1,
    "APM:Rover": 10,
    "APM:Sub": 12,
}
UNITS = {  # of the log, where greybox writes them differently
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "instance": "",
    "UNKNOWN": "",
    "Watt": "W",
    "us": "µs",
    "satellites": "",
}
NO_RATE = (
    "there is no RATE message, so neither the rate setpoints nor the controls (ROut, POut, YOut) "
    "were logged; set LOG_BITMASK to log fast attitude and rates before the next flight."
)


def unit(label: str) -> str:
    """Return a unit in the notation of greybox: deg for headings, m/s² for m/s/s."""
    return UNITS.get(label, label.replace("/s/s", "/s²"))


def metadata(groups: Iterable[Messages]) -> dict[str, Any]:
    """Return the known metadata of a recording from MSG, VER, PARM and MODE."""
    by_name = {group.name: group for group in groups}
    parm, msg = by_name.get("PARM"), by_name.get("MSG")
    texts = column(msg, "Message")
    names = column(parm, "Name")
    values = [float(value) for value in column(parm, "Value")]
    # Older firmware has no VER message.
    firmware = next(filter(vehicle_in, (*column(by_name.get("VER"), "FWS"), *texts)), "")
    vehicle = vehicle_in(firmware)
    return non_empty(
        {
            "vehicle": vehicle,
            "firmware": firmware,
            "parameters": dict(zip(names, values, strict=False)),
            "parameter_changes": parameter_changes(zip(_times(parm), names, values, strict=False)),
            "texts": tuple(zip(_times(msg), texts, strict=False)),
            "modes": _modes(by_name.get("MODE"), vehicle),
        }
    )


def column(group: Messages | None, *names: str) -> Sequence[Any]:
    """Return the first of these columns that messages have, of numbers or texts; empty if none."""
    columns = {**group.columns, **group.texts} if group else {}
    return next((columns[name] for name in names if name in columns), ())


def _times(group: Messages | None) -> list[float]:
    return [] if group is None or group.time is None else group.time.tolist()


def mode_name(vehicle: str, number: int) -> str:
    """Return the name of a flight mode, such as ``SYSTEMID``; ``mode 25`` when it is not known."""
    table = mode_mapping_bynumber(VEHICLES.get(vehicle, -1)) or {}
    return str(table.get(number, f"mode {number}"))


def vehicle_in(text: str) -> str:
    """Return the firmware that a text such as ``ArduCopter V4.6.0`` names, or nothing."""
    name = text.partition(" ")[0]
    return name if name in VEHICLES else ""


def _modes(mode: Messages | None, vehicle: str) -> tuple[tuple[float, str], ...]:
    """Return (time, name): by number, or by the name that text logs write."""
    # In binary logs, Mode is the number that ModeNum is.
    modes = column(mode, "Mode", "ModeNum")
    names = [
        value.upper()
        if isinstance(value, str)
        else mode_name(vehicle, int(value))
        if math.isfinite(value)
        else "?"
        for value in modes
    ]
    return tuple(zip(_times(mode), names, strict=False))
