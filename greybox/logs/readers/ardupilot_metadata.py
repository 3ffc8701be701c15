"""Metadata of an ArduPilot log: vehicle, firmware, parameters, modes, arming; its names of units."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pymavlink.mavutil import mode_mapping_bynumber

from greybox.logs.readers.messages import Messages

VEHICLES = {  # the firmware's name for itself, and its MAV_TYPE of MAVLink, by which pymavlink knows the modes
    "ArduCopter": 2,
    "ArduPlane": 1,
    "ArduRover": 10,
    "APMrover2": 10,
    "ArduSub": 12,
    "AntennaTracker": 5,
    "Blimp": 7,
}
FORMER_NAMES = {
    "APM:Copter": "ArduCopter",
    "APM:Plane": "ArduPlane",
    "APM:Rover": "ArduRover",
    "APM:Sub": "ArduSub",
}
FRAME_CLASSES: Mapping[float, str] = dict(
    enumerate(("QUAD", "HEXA", "OCTA", "OCTAQUAD", "Y6", "HELI", "TRI", "SINGLE", "COAX"), start=1)
)
FRAME_TYPES: Mapping[float, str] = {0: "PLUS", 1: "X", 2: "V", 3: "H"}
# The board and the serial number of its processor, as ``CubeOrange 0036002A 30325105 37383433``.
BOARD = re.compile(r"(\S+) [0-9A-F]{8} [0-9A-F]{8} [0-9A-F]{8}")
EVENT_ARMED, EVENT_DISARMED = 10, 11  # EV.Id, ArduPilot's LogEvent
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
    "there is no RATE message, so neither the rate setpoints nor the controls (ROut, POut, YOut) were logged; "
    "set LOG_BITMASK to log fast attitude and rates before the next flight."
)


def unit(label: str) -> str:
    """Return a unit in the notation of greybox: deg for headings, m/s² for m/s/s."""
    return UNITS.get(label, label.replace("/s/s", "/s²"))


def metadata(groups: Iterable[Messages], span: tuple[float, float]) -> dict[str, Any]:
    """Return the metadata of a recording from MSG, VER, PARM, MODE, ARM and EV; only what is known.

    The `span` is the first and the last time of the log, s.
    """
    by_name = {group.name: group for group in groups}
    about = {
        **_firmware(by_name),
        **_parameters(by_name.get("PARM")),
        "texts": _texts(by_name.get("MSG")),
    }
    texts = by_name["MSG"].texts.get("Message", ()) if "MSG" in by_name else ()
    about |= frame_and_board(texts, about.get("parameters", {}))
    about["modes"] = _modes(by_name.get("MODE"), about.get("vehicle", ""))
    about["armed"] = armed_intervals(_arming(by_name), span)
    return {key: value for key, value in about.items() if value}


def mode_name(vehicle: str, number: int) -> str:
    """Return the name of a flight mode, such as ``SYSTEMID``; ``mode 25`` when it is not known."""
    table = mode_mapping_bynumber(VEHICLES.get(vehicle, -1)) or {}
    return str(table.get(number, f"mode {number}"))


def armed_intervals(
    changes: Sequence[tuple[float, bool]], span: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """Return (start, end), s, of the armed times; a log that starts with a disarming was armed before."""
    intervals: list[tuple[float, float]] = []
    start: float | None = None
    for i, (time, armed) in enumerate(sorted(changes)):
        if armed and start is None:
            start = time
        elif not armed and (start is not None or i == 0):
            intervals.append((span[0] if start is None else start, time))
            start = None
    return (*intervals, (start, span[1])) if start is not None else tuple(intervals)


def _firmware(by_name: Mapping[str, Messages]) -> dict[str, Any]:
    """Return vehicle and firmware, from VER or else from a text message at the start."""
    texts = list(by_name["VER"].texts.get("FWS", ())) if "VER" in by_name else []
    texts += by_name["MSG"].texts.get("Message", ()) if "MSG" in by_name else ()
    for text in texts:
        vehicle = vehicle_in(text)
        if vehicle:
            return {"vehicle": vehicle, "firmware": text}
    return {}


def vehicle_in(text: str) -> str:
    """Return the vehicle whose firmware a text names, as ``APM:Copter V3.4-rc2`` does; empty for other texts."""
    name = text.partition(" ")[0]
    name = FORMER_NAMES.get(name, name)
    return name if name in VEHICLES else ""


def frame_and_board(texts: Iterable[str], parameters: Mapping[str, float]) -> dict[str, str]:
    """Return the frame, as ``QUAD/X``, and the board, as far as texts or parameters tell."""
    frame = board = ""
    for text in texts:
        frame = frame or (text.removeprefix("Frame: ") if text.startswith("Frame: ") else "")
        match = BOARD.fullmatch(text.strip())
        board = board or (match[1] if match else "")
    if not frame and "FRAME_CLASS" in parameters:
        kind = FRAME_CLASSES.get(parameters["FRAME_CLASS"], "")
        shape = FRAME_TYPES.get(parameters.get("FRAME_TYPE", math.nan), "")
        frame = "/".join(part for part in (kind, shape) if part)
    elif (
        not frame and "FRAME" in parameters
    ):  # before version 3.5, whose firmware is made for one class
        frame = FRAME_TYPES.get(parameters["FRAME"], "")
    return {"frame": frame, "board": board}


def _parameters(parm: Messages | None) -> dict[str, Any]:
    if parm is None or "Name" not in parm.texts or "Value" not in parm.columns:
        return {}
    names = parm.texts["Name"]
    result = {"parameters": dict(zip(names, parm.columns["Value"].tolist(), strict=True))}
    if "Default" in parm.columns:
        defaults = zip(names, parm.columns["Default"].tolist(), strict=True)
        result["defaults"] = {name: value for name, value in defaults if not math.isnan(value)}
    return result


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


def _arming(by_name: Mapping[str, Messages]) -> list[tuple[float, bool]]:
    """Return (time, armed) from ARM and from EV; most vehicles log both."""
    changes: list[tuple[float, bool]] = []
    arm = by_name.get("ARM")
    event = by_name.get("EV")
    if arm is not None and arm.time is not None and "ArmState" in arm.columns:
        changes += [
            (t, bool(s))
            for t, s in zip(arm.time.tolist(), arm.columns["ArmState"].tolist(), strict=True)
        ]
    if event is not None and event.time is not None and "Id" in event.columns:
        pairs = zip(event.time.tolist(), event.columns["Id"].tolist(), strict=True)
        changes += [(t, i == EVENT_ARMED) for t, i in pairs if i in (EVENT_ARMED, EVENT_DISARMED)]
    return [(time, state) for time, state in changes if not math.isnan(time)]
