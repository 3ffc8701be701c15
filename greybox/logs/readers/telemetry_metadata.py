"""Metadata of a telemetry log: firmware, parameters, texts, modes."""

import struct
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavutil import interpret_px4_mode

from greybox.files.arrays import Array, Fields, Labels, NamedArrays, by_name
from greybox.logs.readers.ardupilot_metadata import mode_name, vehicle_in
from greybox.logs.readers.telemetry_packets import Kind

HULLS = {  # MAV_TYPE of a vehicle with ArduPilot, and its firmware
    **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), "ArduCopter"),
    **dict.fromkeys((1, 16, 19, 20, 21, 22, 23, 24, 25, 28), "ArduPlane"),
    **dict.fromkeys((10, 11), "ArduRover"),
    12: "ArduSub",
    7: "Blimp",
}
# MAV_PARAM_TYPE of the integers that PX4 sends byte by byte in the place of the float
INTEGERS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}


class Heartbeats(NamedTuple):
    """The heartbeats of the first autopilot: its sender, fields and times, s.

    The sender is 256 · system + component, or -1 without a heartbeat.
    """

    sender: int
    fields: NamedArrays
    time: Array

    @property
    def autopilot(self) -> int:
        """MAV_AUTOPILOT of the sender; that of no autopilot without a heartbeat."""
        return int(self.fields["autopilot"][0]) if len(self.time) else mavlink.MAV_AUTOPILOT_INVALID


def metadata(kinds: Mapping[str, Kind], times: NamedArrays) -> Fields:
    """Return the metadata that were sent; `times` are those of each kind, (n,), s."""
    beats = heartbeats(kinds, times)
    texts = ()
    if "STATUSTEXT" in kinds:
        written = kinds["STATUSTEXT"].texts["text"]
        texts = tuple(zip(times["STATUSTEXT"].tolist(), written, strict=True))
    firmware = _firmware(beats, [text for _, text in texts])
    about = {
        **firmware,
        "parameters": _parameters(kinds.get("PARAM_VALUE"), beats),
        "texts": texts,
        "modes": _modes(beats, firmware.get("vehicle", "")),
    }
    return {key: value for key, value in about.items() if value}


def heartbeats(kinds: Mapping[str, Kind], times: NamedArrays) -> Heartbeats:
    """Return the heartbeats of the first autopilot in the log; their times are zero by default."""
    nobody = Heartbeats(-1, {}, np.empty(0))
    if "HEARTBEAT" not in kinds:
        return nobody
    senders = np.asarray(kinds["HEARTBEAT"].senders)
    fields = kinds["HEARTBEAT"].columns
    # Ground stations, cameras and gimbals send heartbeats, too.
    flying = (fields["autopilot"] != mavlink.MAV_AUTOPILOT_INVALID) & (
        fields["type"] != mavlink.MAV_TYPE_GCS
    )
    if not flying.any():
        return nobody
    sender = int(senders[flying.argmax()])
    # Modes of another vehicle on the same link are not those of this one.
    rows = flying & (senders == sender)
    time = times.get("HEARTBEAT", np.zeros(rows.size))

    return Heartbeats(sender, {name: x[rows] for name, x in fields.items()}, time[rows])


def _firmware(beats: Heartbeats, texts: Labels) -> dict[str, str]:
    for text in texts:
        if vehicle := vehicle_in(text):
            return {"vehicle": vehicle, "firmware": text}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return {"vehicle": "PX4"}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return {"vehicle": HULLS.get(int(beats.fields["type"][0]), "ArduPilot")}

    return {}


def _parameters(sent: Kind | None, beats: Heartbeats) -> dict[str, float]:
    """Return the last value of every parameter."""
    if sent is None:
        return {}
    values = sent.columns["param_value"].tolist()
    # PX4 sends the bytes of an integer, ArduPilot its value.
    if beats.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        codes = [INTEGERS.get(int(kind), "f") for kind in sent.columns["param_type"]]
        values = [
            float(struct.unpack_from(f"<{code}", struct.pack("<f", value))[0])
            for code, value in zip(codes, values, strict=True)
        ]

    return by_name(sent.texts["param_id"], values)


def _modes(beats: Heartbeats, vehicle: str) -> tuple[tuple[float, str], ...]:
    """Return (time, name) at every change."""
    modes: list[tuple[float, str]] = []
    if not beats.time.size:
        return ()
    states = (beats.fields[name].astype(int).tolist() for name in ("base_mode", "custom_mode"))
    for time, base, custom in zip(beats.time.tolist(), *states, strict=True):
        name = interpret_px4_mode(base, custom) if vehicle == "PX4" else mode_name(vehicle, custom)
        # Every heartbeat has the mode, and only changes matter.
        if not modes or modes[-1][1] != name:
            modes.append((time, name))
    return tuple(modes)
