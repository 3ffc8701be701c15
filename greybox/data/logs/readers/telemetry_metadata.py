"""Metadata of a telemetry log: firmware, parameters, texts, modes."""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavutil import interpret_px4_mode

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.files.named_values import Values, non_empty
from greybox.data.logs.readers.ardupilot_metadata import mode_name, vehicle_in
from greybox.data.logs.readers.telemetry_packets import Kind

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
    """The heartbeats of the first autopilot: its sender, fields, and which of all they are.

    The sender is 256 · system + component, or -1 without a heartbeat; `autopilot` is its
    MAV_AUTOPILOT, or that of no autopilot.
    """

    sender: int
    autopilot: int
    fields: Mapping[str, Array]
    rows: BoolArray


def metadata(
    kinds: Mapping[str, Kind], times: Mapping[str, Array], beats: Heartbeats
) -> dict[str, Any]:
    """Return the metadata that were sent; `times` are those of each kind, (n,), s."""
    texts = ()
    if "STATUSTEXT" in kinds:
        written = kinds["STATUSTEXT"].texts["text"]
        texts = tuple(zip(times["STATUSTEXT"].tolist(), written, strict=True))
    firmware = _firmware(beats, [text for _, text in texts])
    return non_empty(
        {
            **firmware,
            "parameters": _parameters(kinds.get("PARAM_VALUE"), beats),
            "texts": texts,
            "modes": _modes(beats, times, firmware.get("vehicle", "")),
        }
    )


def heartbeats(kinds: Mapping[str, Kind]) -> Heartbeats:
    """Return the heartbeats of the first autopilot in the log."""
    nobody = Heartbeats(-1, mavlink.MAV_AUTOPILOT_INVALID, {}, np.zeros(0, dtype=bool))
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
    first = flying.argmax()
    sender = int(senders[first])
    # Modes of another vehicle on the same link are not those of this one.
    rows = flying & (senders == sender)

    autopilot = int(fields["autopilot"][first])
    return Heartbeats(sender, autopilot, {name: x[rows] for name, x in fields.items()}, rows)


def _firmware(beats: Heartbeats, texts: Sequence[str]) -> Mapping[str, str]:
    for text in texts:
        if vehicle := vehicle_in(text):
            return {"vehicle": vehicle, "firmware": text}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return {"vehicle": "PX4"}
    if beats.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return {"vehicle": HULLS.get(int(beats.fields["type"][0]), "ArduPilot")}

    return {}


def _parameters(sent: Kind | None, beats: Heartbeats) -> Values:
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

    return dict(zip(sent.texts["param_id"], values, strict=True))


def _modes(
    beats: Heartbeats, times: Mapping[str, Array], vehicle: str
) -> tuple[tuple[float, str], ...]:
    """Return (time, name) at every change."""
    modes: list[tuple[float, str]] = []
    if not beats.rows.any():
        return ()
    moments = times["HEARTBEAT"][beats.rows].tolist()
    states = (beats.fields[name].astype(int).tolist() for name in ("base_mode", "custom_mode"))
    for time, base, custom in zip(moments, *states, strict=True):
        name = interpret_px4_mode(base, custom) if vehicle == "PX4" else mode_name(vehicle, custom)
        # Every heartbeat has the mode, and only changes matter.
        if not modes or modes[-1][1] != name:
            modes.append((time, name))
    return tuple(modes)
