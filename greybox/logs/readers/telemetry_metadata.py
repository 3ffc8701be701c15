"""Metadata of a telemetry log: firmware, parameters, texts, modes, arming."""

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavutil import interpret_px4_mode

from greybox.files.arrays import Array, IntArray
from greybox.logs.readers.ardupilot_metadata import VEHICLES, armed_intervals, mode_name
from greybox.logs.readers.dataflash_index import text
from greybox.logs.readers.telemetry_frames import Frames, payloads

NO_VEHICLE = (
    mavlink.MAV_AUTOPILOT_INVALID,
)  # in the heartbeats of ground stations, cameras and gimbals
HULLS = {  # MAV_TYPE of a vehicle with ArduPilot, and its firmware
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), "ArduCopter"),
    **dict.fromkeys((1, 16, 19, 20, 21, 22, 23, 24, 25, 28), "ArduPlane"),
    **dict.fromkeys((10, 11), "ArduRover"),
    12: "ArduSub",
    7: "Blimp",
}
INTEGERS = {
    1: "u1",
    2: "i1",
    3: "<u2",
    4: "<i2",
    5: "<u4",
    6: "<i4",
}  # MAV_PARAM_TYPE, sent byte by byte by PX4


def vehicle_sender(data: mmap.mmap, frames: Frames) -> int:
    """Return who sends the first heartbeat of an autopilot, as 256 · system + component; -1 for none."""
    beats, rows = _heartbeats(data, frames)
    return int(frames.senders[rows[0]]) if beats.size else -1


def metadata(data: mmap.mmap, frames: Frames, time: Array) -> dict[str, Any]:
    """Return the metadata of a recording, as far as they were sent; times in s, see `telemetry`."""
    beats, rows = _heartbeats(data, frames)
    texts = _texts(data, frames, time)
    known = {
        **_firmware(beats, [said for _, said in texts]),
        "parameters": _parameters(data, frames, beats),
        "texts": texts,
    }
    known["modes"] = _modes(beats, time[rows], known.get("vehicle", ""))
    known["armed"] = _armed(beats, time[rows])
    return {key: value for key, value in known.items() if value}


def _heartbeats(data: mmap.mmap, frames: Frames) -> tuple[NDArray[Any], IntArray]:
    """Return the heartbeats of the first autopilot, and which packets they are."""
    rows = np.flatnonzero(frames.kinds == mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    beats = payloads(data, frames, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
    flying = ~np.isin(beats["autopilot"], NO_VEHICLE) & (beats["type"] != mavlink.MAV_TYPE_GCS)
    if flying.any():
        flying &= frames.senders[rows] == frames.senders[rows[flying.argmax()]]
    return beats[flying], rows[flying]


def _firmware(beats: NDArray[Any], texts: list[str]) -> dict[str, str]:
    for said in texts:
        if said.split(" ")[0] in VEHICLES:
            return {"vehicle": said.split(" ")[0], "firmware": said}
    if beats.size and beats["autopilot"][0] == mavlink.MAV_AUTOPILOT_PX4:
        return {"vehicle": "PX4"}
    if beats.size and beats["autopilot"][0] == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return {"vehicle": HULLS.get(int(beats["type"][0]), "ArduPilot")}
    return {}


def _parameters(data: mmap.mmap, frames: Frames, beats: NDArray[Any]) -> dict[str, float]:
    """Return name to value, the last sent. PX4 sends the bytes of its integers in the place of the float."""
    sent = payloads(data, frames, mavlink.MAVLINK_MSG_ID_PARAM_VALUE)
    bytewise = beats.size and beats["autopilot"][0] == mavlink.MAV_AUTOPILOT_PX4
    values = {}
    for packet in sent:
        kind = INTEGERS.get(int(packet["param_type"])) if bytewise else None
        raw = packet["param_value"]
        values[text(packet["param_id"])] = float(np.frombuffer(raw.tobytes(), kind or "<f4")[0])
    return values


def _texts(data: mmap.mmap, frames: Frames, time: Array) -> tuple[tuple[float, str], ...]:
    """Return (time, text); long ones, sent in pieces of one id and sender, put together."""
    rows = np.flatnonzero(frames.kinds == mavlink.MAVLINK_MSG_ID_STATUSTEXT)
    joined: list[tuple[float, str]] = []
    last = None
    for row, packet in zip(
        rows, payloads(data, frames, mavlink.MAVLINK_MSG_ID_STATUSTEXT), strict=True
    ):
        words = text(packet["text"])
        source = (int(frames.senders[row]), int(packet["id"]))
        if packet["id"] and packet["chunk_seq"] and source == last:
            joined[-1] = (joined[-1][0], joined[-1][1] + words)
        else:
            joined.append((float(time[row]), words))
        last = source
    return tuple(joined)


def _modes(beats: NDArray[Any], time: Array, vehicle: str) -> tuple[tuple[float, str], ...]:
    """Return (time, name) at every change."""
    modes: list[tuple[float, str]] = []
    for at, base, custom in zip(
        time.tolist(), beats["base_mode"].tolist(), beats["custom_mode"].tolist(), strict=True
    ):
        name = interpret_px4_mode(base, custom) if vehicle == "PX4" else mode_name(vehicle, custom)
        if not modes or modes[-1][1] != name:
            modes.append((at, name))
    return tuple(modes)


def _armed(beats: NDArray[Any], time: Array) -> tuple[tuple[float, float], ...]:
    """Return (start, end), s, from the first armed heartbeat to the first disarmed one."""
    armed = (beats["base_mode"] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED) > 0
    since = int(armed.argmax()) if armed.any() else armed.size
    states = list(zip(time[since:].tolist(), armed[since:].tolist(), strict=True))
    return armed_intervals(states, (states[0][0], states[-1][0])) if states else ()
