"""Logs made for the tests: DataFlash as bytes and as text, MAVLink telemetry.

Written by the formats' definitions.
"""

import io
import struct
import zlib
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
from pymavlink.DFReader import FORMAT_TO_STRUCT
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scipy.io import savemat
from scipy.signal import cont2discrete

FMT_FORMAT = ("BBnNZ", "Type,Length,Name,Format,Columns")
UNITS = {
    "s": "s",
    "d": "deg",
    "k": "deg/s",
    "h": "degheading",
    "n": "m/s",
    "o": "m/s/s",
    "#": "instance",
    "-": "",
}
MULTIPLIERS = {"-": 0.0, "?": 1.0, "0": 1.0, "B": 1e-2, "F": 1e-6}


class Log:
    """A DataFlash log in the making: the same messages as bytes (.BIN) and as lines (.log)."""

    def __init__(self, units=True):
        self.parts, self.lines, self.kinds = [], [], {}
        self.fmt("FMT", *FMT_FORMAT, kind=0x80)
        if units:
            self._tables()

    def fmt(self, name, letters, columns, units="", multipliers="", kind=None, length=None):
        """Describe a message."""
        kind = kind if kind is not None else 200 - len(self.kinds)
        body = "<" + "".join(FORMAT_TO_STRUCT[letter][0] for letter in letters)
        length = struct.calcsize(body) + 3 if length is None else length
        self.kinds[name] = (kind, letters, body)
        self.add("FMT", kind, length, name, letters, columns)
        if units:
            self.add("FMTU", 0, kind, units, multipliers or "-" * len(units))
        return self

    def _tables(self):
        self.fmt("UNIT", "QbZ", "TimeUS,Id,Label")
        self.fmt("MULT", "Qbd", "TimeUS,Id,Mult")
        self.fmt("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
        for letter, label in UNITS.items():
            self.add("UNIT", 0, ord(letter), label)
        for letter, multiplier in MULTIPLIERS.items():
            self.add("MULT", 0, ord(letter), multiplier)

    def add(self, name, *values):
        """Log a message; values of the letters c, C, e, E, L are in their unit, not hundredths."""
        kind, letters, body = self.kinds[name]
        raw, said = [], []
        for letter, value in zip(letters, values, strict=True):
            multiplier = FORMAT_TO_STRUCT[letter][1]
            raw.append(
                value.encode()
                if isinstance(value, str)
                else value
                if not multiplier
                else round(value / multiplier)
            )
            said.append(f"{value:.7f}" if multiplier else str(value))
        self.parts.append(struct.pack("<BBB", 0xA3, 0x95, kind) + struct.pack(body, *raw))
        self.lines.append(", ".join((name, *said)))
        return self

    @property
    def binary(self):
        return b"".join(self.parts)

    @property
    def text(self):
        return "\n".join(self.lines) + "\n"


def flight(seconds=4.0, rate=100.0, start=10.0, lanes=2, seed=0):
    """A hover as ArduPilot would log it.

    Attitude, rates, two IMUs, parameters, texts, modes, arming.
    """
    rng = np.random.default_rng(seed)
    log = Log()
    log.fmt("PARM", "QNff", "TimeUS,Name,Value,Default", "s---", "F---")
    log.fmt("MSG", "QZ", "TimeUS,Message", "s-", "F-")
    log.fmt("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---")
    log.fmt("EV", "QB", "TimeUS,Id", "s-", "F-")
    log.fmt(
        "ATT",
        "QccccCCCCB",
        "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF",
        "sddddhhdh-",
        "FBBBBBBBB-",
    )
    log.fmt("RATE", "Qffffff", "TimeUS,PDes,P,POut,RDes,R,ROut", "skk-kk-", "F00-00-")
    log.fmt("IMU", "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ", "s#kkk", "F-000")
    first = round(start * 1e6)
    log.add("MSG", first, "ArduCopter V4.6.0-dev (fbb78585)")
    for name, value, default in (
        ("INS_GYRO_FILTER", 20.0, 20.0),
        ("ATC_RAT_PIT_P", 0.135, 0.1),
        ("ATC_RAT_PIT_P", 0.14, 0.1),
    ):
        log.add("PARM", first, name, value, default)
    log.add("MODE", first, 5, 5, 1).add("EV", first + 1000, 10)
    for i in range(round(seconds * rate)):
        at = first + 2000 + round(i * 1e6 / rate)
        angle, yaw, control = np.sin(0.05 * i), (0.1 * i) % 360, rng.normal()
        log.add("RATE", at, 0.0, angle * 3, control, 0.0, 0.1, 0.0)
        log.add("ATT", at + 100, 0.0, 0.5, angle, 0.9 * angle, yaw, yaw, 0.01, 0.02, 3)
        if i % 4 == 0:
            for lane in range(lanes):
                log.add("IMU", at + 200, lane, 0.1 + lane, rng.normal(), -0.2)
    log.add("MODE", first + round(seconds * 1e6), 25, 25, 1).add(
        "EV", first + round(seconds * 1e6), 11
    )
    return log


def tlog(packets, first=False):
    """Return a telemetry log of (µs since 1970, system, component, message), in MAVLink 2 or in its
    first version."""
    out, sequence = io.BytesIO(), 0
    for stamp, system, component, message in packets:
        link = mavlink.MAVLink(io.BytesIO(), srcSystem=system, srcComponent=component)
        link.seq = sequence = (sequence + 1) % 256
        out.write(int(stamp).to_bytes(8, "big") + bytes(message.pack(link, force_mavlink1=first)))
    return out.getvalue()


def radio(seconds=4.0, boot=1_700_000_000_000_000):
    """A telemetry log: autopilot (1, 1), its camera (1, 100), ground station (255, 190)."""
    packets = []

    def send(t, system, component, message, latency=0.02):
        packets.append((boot + (t + latency) * 1e6, system, component, message))

    send(1.0, 1, 1, mavlink.MAVLink_statustext_message(6, b"ArduCopter V4.5.7 (2a3dc4b7)"))
    for index, (name, value) in enumerate((("ATC_RAT_PIT_P", 0.135), ("INS_GYRO_FILTER", 20.0))):
        send(1.1, 1, 1, mavlink.MAVLink_param_value_message(name.encode(), value, 9, 2, index))
    for i in range(round(seconds)):
        armed, mode = (128 if i > 0 else 0), (5 if i < 2 else 25)
        send(1 + i, 1, 1, mavlink.MAVLink_heartbeat_message(2, 3, 81 | armed, mode, 4, 3))
        send(1 + i, 255, 190, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    for i in range(round(seconds * 50)):
        t = 1.0 + i / 50
        angle = float(np.float32(0.1 * np.sin(0.2 * i)))
        jitter = 0.02 + 0.015 * (i % 3)
        send(
            t,
            1,
            1,
            mavlink.MAVLink_attitude_message(round(t * 1000), 0.01, angle, 1.5, 0.0, 0.25, 0.0),
            jitter,
        )
        if i % 5 == 0:
            send(t, 1, 1, mavlink.MAVLink_vfr_hud_message(1.0, 1.5, 90, 30, 12.0, 0.5))
            send(
                t,
                1,
                1,
                mavlink.MAVLink_servo_output_raw_message(
                    round(t * 1e6), 0, *range(1100, 1900, 100)
                ),
            )
            send(
                t,
                1,
                100,
                mavlink.MAVLink_attitude_message(
                    round(t * 1000) - 500, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                ),
            )
    return sorted(packets, key=lambda packet: packet[0])


def table(rows=400, separator=",", comma=False):
    """A CSV table with units in its header."""
    lines = [separator.join(("time [s]", "pitch [deg]", "u ()", "note"))]
    for i in range(rows):
        cells = [
            f"{0.01 * i:.3f}",
            f"{np.sin(0.1 * i):.6f}",
            f"{np.cos(0.3 * i):.5f}" if i % 50 else "",
            "ok",
        ]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return ("# made for a test\n" + "\n".join(lines) + "\n").encode()


def hdf5(**options):
    """An HDF5 file with a record at the root and one in a group."""
    buffer, t = io.BytesIO(), 0.01 * np.arange(500)
    packed = {"compression": "gzip", "chunks": (100,)} if options.pop("packed", False) else {}
    with h5py.File(buffer, "w", **options) as file:
        for group in (file, file.create_group("flight/ATT")):
            group.create_dataset("time", data=t, **packed)
            group.create_dataset("Pitch", data=np.sin(t), **packed).attrs["unit"] = "deg"
            group.create_dataset("P", data=np.cos(t).astype("f4"), **packed).attrs["unit"] = "deg/s"
        file.attrs["vehicle"] = "S500"
    return buffer.getvalue()


def matlab(**options):
    """A MATLAB file with vectors in the workspace and a struct."""
    buffer, t = io.BytesIO(), 0.01 * np.arange(500)
    attitude = {
        "time": t,
        "Pitch": np.sin(t),
        "Yaw": np.cos(t).astype("f4"),
        "note": "made",
        "inner": {"t": t, "q": t**2},
    }
    savemat(
        buffer,
        {"t": t, "u": np.cos(t), "xy": np.stack([t, t], axis=1), "att": attitude, "cell": [1, "a"]},
        **options,
    )
    return buffer.getvalue()


def _empty_ulog():
    """A PX4 log to write to, and the function that puts a message into it."""
    out = io.BytesIO()

    def put(kind, body):
        out.write(struct.pack("<HB", len(body), ord(kind)) + body)

    out.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000))
    put("B", bytes(40))
    return out, put


def ulog(seconds=2.0, rate=100):
    """A PX4 log: attitude with an array, two accelerometers, the vehicle's status, parameters, a
    text."""
    out, put = _empty_ulog()

    def key(kind, name, value):
        put(kind, struct.pack("B", len(name)) + name + value)

    put("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;uint8_t[4] _padding0;")
    put("F", b"sensor_accel:uint64_t timestamp;float x;bool sound;")
    put("F", b"vehicle_status:uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;")
    key("I", b"char[3] sys_name", b"PX4")
    key("I", b"char[8] ver_sw", b"29f5e2a1")
    key("I", b"uint32_t ver_sw_release", struct.pack("<I", 0x010E03FF))
    key("I", b"char[10] ver_hw", b"PX4_FMU_V5")
    key("P", b"float MC_PITCH_P", struct.pack("<f", 6.5))
    key("P", b"int32_t CBRK_IO", struct.pack("<i", 4))
    topics = (
        (b"vehicle_attitude", 0),
        (b"sensor_accel", 0),
        (b"sensor_accel", 1),
        (b"vehicle_status", 0),
    )
    for number, (name, instance) in enumerate(topics):
        put("A", struct.pack("<BH", instance, number) + name)
    for i in range(round(seconds * rate)):
        at = 2_000_000 + round(i * 1e6 / rate)
        put("D", struct.pack("<HQ4f", 0, at, 1.0, 0.0, np.sin(0.1 * i), 0.0))
        for lane in (0, 1):
            put("D", struct.pack("<HQf?", 1 + lane, at, 9.81 + lane, True))
        if i % 50 == 0:
            put("D", struct.pack("<HQBB", 3, at, 2 if 50 <= i < 150 else 1, 2 if i < 100 else 15))
        if i == 10:
            put("L", struct.pack("<BQ", ord("6"), at) + b"[commander] Takeoff detected")
            key("P", b"float MC_PITCH_P", struct.pack("<f", 7.0))
    return out.getvalue()


def px4_flight():
    """A PX4 log of five pitch sines in closed loop.

    The plant 60 / ((0.05 s + 1) s (s + 2)), exact for a held torque.

    The controller is u = 0.3 (r - θ) - 0.06 q with noise of angle and rate, 125 Hz.
    """
    rate, omega = 125, (2.0, 3.5, 6.0, 10.0, 17.0)
    plant = np.array([[0.0, 1.0, 0.0], [0.0, -2.0, 60.0], [0.0, 0.0, -20.0]])
    a, b, *_ = cont2discrete(
        (plant, np.array([[0.0], [0.0], [20.0]]), np.eye(3), np.zeros((3, 1))), 1 / rate
    )
    setpoint = []
    for w in omega:
        t = np.arange(round(max(7 * 2 * np.pi / w, 10) * rate)) / rate
        setpoint += [*np.zeros(2 * rate), *(0.05 * np.sin(w * t))]
    setpoint += [0.0] * rate
    random = np.random.default_rng(0)
    noise = np.array([5e-3, 0.02]) * random.standard_normal((len(setpoint), 2))

    out, put = _empty_ulog()
    topics = {
        "vehicle_attitude": "float[4] q",
        "vehicle_attitude_setpoint": "float[4] q_d",
        "vehicle_angular_velocity": "float[3] xyz",
        "vehicle_torque_setpoint": "float[3] xyz",
    }
    for name, fields in topics.items():
        put("F", f"{name}:uint64_t timestamp;{fields};".encode())
    put("I", b"\x10char[3] sys_namePX4")
    for number, name in enumerate(topics):
        put("A", struct.pack("<BH", 0, number) + name.encode())
    x = np.zeros(3)
    for k, (r, (angle, gyro)) in enumerate(zip(setpoint, noise, strict=True)):
        at = 2_000_000 + k * 1_000_000 // rate
        torque = 0.3 * (r - x[0] - angle) - 0.06 * (x[1] + gyro)
        tilted = [(np.cos(one / 2), 0.0, np.sin(one / 2), 0.0) for one in (x[0] + angle, r)]
        put("D", struct.pack("<HQ4f", 0, at, *tilted[0]))
        put("D", struct.pack("<HQ4f", 1, at, *tilted[1]))
        put("D", struct.pack("<HQ3f", 2, at, 0.0, x[1] + gyro, 0.0))
        put("D", struct.pack("<HQ3f", 3, at, 0.0, torque, 0.0))
        x = a @ x + b[:, 0] * torque
    return out.getvalue()


def crazyflie(version=2, rows=300):
    """A card log of a Crazyflie: two events in turn, and a CRC-32, as its firmware writes them."""
    events = {
        65535: ("fixedFrequency", "fI", ("gyro.x", "motor.m1")),
        3: ("estTDOA", "Bf", ("idA", "distanceDiff")),
    }
    out = io.BytesIO()
    out.write(struct.pack("<BHH", 0xBC, version, len(events)))
    for number, (name, letters, variables) in events.items():
        out.write(struct.pack("<H", number) + name.encode() + b"\0")
        out.write(struct.pack("<H", len(variables)))
        for variable, letter in zip(variables, letters, strict=True):
            out.write(f"{variable}({letter})".encode() + b"\0")
    stamp, tick = {1: ("I", 1e3), 2: ("Q", 1e6)}[version]
    for k in range(rows):
        at = round((5 + k / 100) * tick)
        out.write(struct.pack(f"<H{stamp}fI", 65535, at, np.sin(0.1 * k), 100 * k))
        if k % 3 == 0:
            out.write(struct.pack(f"<H{stamp}Bf", 3, at, k % 256, 0.5 * k))
    return out.getvalue() + struct.pack("<I", zlib.crc32(out.getvalue()))


def samples():
    """Return sound files of every format, by suffix."""
    cut = Path(__file__).parents[1] / "data" / "sitl_sweep_cut.BIN"
    log, packets = flight(seconds=2.0), radio()
    return {
        ".bin": [
            log.binary,
            cut.read_bytes(),
            flight(seconds=0.2).binary,
        ],
        ".log": [log.text.encode()],
        ".tlog": [tlog(packets), tlog(packets, first=True)],
        ".csv": [table(), table(separator=";", comma=True)],
        ".h5": [hdf5(), hdf5(libver="latest"), hdf5(packed=True), hdf5(userblock_size=512)],
        ".mat": [matlab(), matlab(do_compression=True), matlab(oned_as="column")],
        ".cf": [crazyflie(), crazyflie(version=1)],
        **({".ulg": [ulog()]} if find_spec("pyulog") else {}),
    }
