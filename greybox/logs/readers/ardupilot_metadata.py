"""Metadata of an ArduPilot log: vehicle, firmware, parameters, texts, modes; names of units."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pymavlink.mavutil import mode_mapping_bynumber

from greybox.logs.parameter_history import parameter_changes
from greybox.logs.readers.messages import Messages

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
    about: dict[str, Any] = {
        **_firmware(by_name),
        "parameters": _parameters(by_name.get("PARM")),
        "parameter_changes": _changes(by_name.get("PARM")),
        "texts": _texts(by_name.get("MSG")),
    }
    about["modes"] = _modes(by_name.get("MODE"), about.get("vehicle", ""))
    return {key: value for key, value in about.items() if value}


def mode_name(vehicle: str, number: int) -> str:
    """Return the name of a flight mode, such as ``SYSTEMID``; ``mode 25`` when it is not known."""
    table = mode_mapping_bynumber(VEHICLES.get(vehicle, -1)) or {}
    return str(table.get(number, f"mode {number}"))


def _firmware(by_name: Mapping[str, Messages]) -> dict[str, Any]:
    """Return vehicle and firmware, from VER or else from a text message."""
    # Older firmware has no VER message.
    texts = list(by_name["VER"].texts.get("FWS", ())) if "VER" in by_name else []
    texts += by_name["MSG"].texts.get("Message", ()) if "MSG" in by_name else ()
    for text in texts:
        vehicle = vehicle_in(text)
        if vehicle:
            return {"vehicle": vehicle, "firmware": text}
    return {}


def vehicle_in(text: str) -> str:
    """Return the firmware that a text such as ``ArduCopter V4.6.0`` names, or nothing."""
    name = text.partition(" ")[0]
    return name if name in VEHICLES else ""


def _parameters(parm: Messages | None) -> dict[str, float]:
    if parm is None or "Name" not in parm.texts or "Value" not in parm.columns:
        return {}
    return dict(zip(parm.texts["Name"], parm.columns["Value"].tolist(), strict=True))


def _changes(parm: Messages | None) -> tuple[tuple[float, str, float, float], ...]:
    if parm is None or parm.time is None or not _parameters(parm):
        return ()
    names, values = parm.texts["Name"], parm.columns["Value"].tolist()
    return parameter_changes(zip(parm.time.tolist(), names, values, strict=True))


def _texts(msg: Messages | None) -> tuple[tuple[float, str], ...]:
    if msg is None or msg.time is None or "Message" not in msg.texts:
        return ()
    return tuple(zip(msg.time.tolist(), msg.texts["Message"], strict=True))


def _modes(mode: Messages | None, vehicle: str) -> tuple[tuple[float, str], ...]:
    """Return (time, name): by number, or by the name that text logs write."""
    if mode is None or mode.time is None:
        return ()
    numbers = mode.columns.get("ModeNum", mode.columns.get("Mode"))
    if "Mode" in mode.texts:
        names = [name.upper() for name in mode.texts["Mode"]]
    elif numbers is not None:
        names = [
            mode_name(vehicle, int(number)) if math.isfinite(number) else "?" for number in numbers
        ]
    else:
        return ()

    return tuple(zip(mode.time.tolist(), names, strict=True))
