import struct
import tracemalloc

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from synthetic_logs import radio, tlog

from greybox.data.logs.readers import read

BOOT = 1_700_000_000_000_000  # µs since 1970


@pytest.fixture
def saved(tmp_path):
    def write_and_read(data, **options):
        path = tmp_path / "flight.tlog"
        path.write_bytes(data)
        return read(path, **options)

    return write_and_read


@pytest.mark.parametrize("first", [False, True])
def test_every_number_is_as_pymavlink_reads_it(saved, tmp_path, monkeypatch, first):
    monkeypatch.setenv(
        "MAVLINK20", "1"
    )  # which pymavlink sets for all that follows once it has met a packet of it
    mavutil.set_dialect("ardupilotmega")
    recording = saved(tlog(radio(), first=first))
    link = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"))
    messages = {}
    while (message := link.recv_match()) is not None:
        sender = f"{message.get_srcSystem()}:{message.get_srcComponent()}"
        messages.setdefault((message.get_type(), sender), []).append(message)
    link.close()
    for name in (
        "ATTITUDE[1:1]",
        "ATTITUDE[1:100]",
        "VFR_HUD",
        "SERVO_OUTPUT_RAW[0]",
        "HEARTBEAT[255:190]",
    ):
        kind, _, sender = name.partition("[")
        theirs = messages[kind, sender[:-1] if ":" in sender else "1:1"]
        theirs.sort(key=lambda m: getattr(m, "time_boot_ms", 0))
        assert len(recording[name]) == len(theirs)
        for field, values in recording[name].signals.items():
            np.testing.assert_array_equal(values, [getattr(m, field) for m in theirs])
            assert recording[name].units[field].replace("µs", "us") == theirs[
                0
            ].fieldunits_by_name.get(field, "")


def test_the_senders_time_is_free_of_jitter_and_of_disorder(saved):
    attitude = saved(tlog(radio()))["ATTITUDE[1:1]"]
    np.testing.assert_allclose(attitude.time, 1 + np.arange(200) / 50, atol=1e-9)
    np.testing.assert_allclose(attitude["pitch"], 0.1 * np.sin(0.2 * np.arange(200)), atol=1e-7)


def test_all_senders_are_on_the_vehicles_clock(saved):
    recording = saved(tlog(radio()))
    assert recording["ATTITUDE[1:100]"].time[0] == pytest.approx(1, abs=0.05)
    assert recording["VFR_HUD"].time[0] == pytest.approx(1, abs=0.05)
    assert recording.findings == (
        "these carry no time stamp and are given their time of reception: HEARTBEAT, VFR_HUD.",
    )


def test_metadata(saved):
    about = saved(tlog(radio()), messages=("ATTITUDE",)).metadata
    assert about["vehicle"] == "ArduCopter"
    assert about["firmware"] == "ArduCopter V4.5.7 (2a3dc4b7)"
    assert about["parameters"] == {"ATC_RAT_PIT_P": pytest.approx(0.135), "INS_GYRO_FILTER": 20}
    assert [name for _, name in about["modes"]] == ["LOITER", "SYSTEMID"]


def test_only_what_is_asked_for_is_read(saved):
    recording = saved(tlog(radio()), messages=("ATTITUDE", "GPS_RAW_INT"))
    assert list(recording) == ["ATTITUDE[1:1]", "ATTITUDE[1:100]"]
    assert "no message GPS_RAW_INT; the log has ATTITUDE, HEARTBEAT" in recording.findings[0]


def test_a_restart_keeps_the_true_pause(saved):
    packets = [
        (
            BOOT + (start + i / 50) * 1e6,
            1,
            1,
            mavlink.MAVLink_attitude_message(1000 + 20 * i, 0, 0, 0, 0, 0, 0),
        )
        for start in (0, 60)
        for i in range(500)
    ]
    recording = saved(tlog(packets))
    time = recording["ATTITUDE"].time
    assert time.size == 1000
    assert time[500] - time[0] == pytest.approx(60)
    assert any("sender 1:1 restarted at 60.0 s" in finding for finding in recording.findings)


def test_damaged_packets_cost_only_themselves(saved):
    data = tlog(radio())
    whole, rng = saved(data), np.random.default_rng(0)
    broken = bytearray(data)
    for at in rng.integers(500, len(data), 5):
        broken[at] ^= 0xFF
    recording = saved(bytes(broken))
    lost = sum(map(len, whole.values())) - sum(map(len, recording.values()))
    assert 0 < lost <= 8
    assert any("are damaged and were skipped" in finding for finding in recording.findings)
    rows = np.searchsorted(whole["ATTITUDE"].time, recording["ATTITUDE"].time - 1e-6)
    np.testing.assert_array_equal(recording["ATTITUDE"]["pitch"], whole["ATTITUDE"]["pitch"][rows])


def test_arrays_become_signals_and_instances_records(saved):
    voltages = [4100 + i for i in range(10)]
    packets = [
        (
            BOOT + i * 100_000,
            1,
            1,
            mavlink.MAVLink_battery_status_message(lane, 0, 1, 2500, voltages, 1200, 50, 5, 90),
        )
        for i in range(20)
        for lane in (0, 1)
    ]
    battery = saved(tlog(packets))["BATTERY_STATUS[1]"]
    assert len(battery) == 20
    assert battery["voltages[3]"][0] == 4103
    assert battery.units["voltages[3]"] == "mV"


@pytest.mark.parametrize(
    ("kind", "code", "number"),
    [
        (1, "B", 200),
        (2, "b", -3),
        (3, "H", 40_000),
        (4, "h", -300),
        (5, "I", 3_000_000_000),
        (6, "i", 4),
    ],
)
def test_px4_sends_the_bytes_of_integer_parameters(saved, kind, code, number):
    value = struct.unpack("<f", struct.pack(f"<{code}", number).ljust(4, b"\0"))[0]
    packets = [
        (BOOT, 1, 1, mavlink.MAVLink_heartbeat_message(2, 12, 81 | 128, 3 << 16, 4, 3)),
        (BOOT + 1000, 1, 1, mavlink.MAVLink_param_value_message(b"CBRK_IO", value, kind, 2, 0)),
        (BOOT + 2000, 1, 1, mavlink.MAVLink_param_value_message(b"MC_PITCH_P", 6.5, 9, 2, 1)),
        (BOOT + 3000, 1, 1, mavlink.MAVLink_heartbeat_message(2, 12, 81 | 128, 3 << 16, 4, 3)),
    ]
    about = saved(tlog(packets)).metadata
    assert about["vehicle"] == "PX4"
    assert about["parameters"] == {"CBRK_IO": number, "MC_PITCH_P": 6.5}
    assert about["modes"] == ((0, "POSCTL"),)


def test_a_file_without_packets_is_refused(saved):
    with pytest.raises(ValueError, match="holds no MAVLink packet that can be read"):
        saved(BOOT.to_bytes(8, "big") + b"\xfd" * 300)


def test_memory_is_that_of_what_is_asked_for(tmp_path):
    motors = mavlink.MAVLink_servo_output_raw_message(0, 1, *range(1100, 1900, 100))
    other = mavlink.MAVLink_vfr_hud_message(1.0, 1.5, 90, 30, 12.0, 0.5)
    packets = [tlog([(0, 1, 1, message)])[8:] for message in (motors, other, other, other)]
    path = tmp_path / "long.tlog"
    path.write_bytes(
        b"".join((BOOT + 10_000 * k).to_bytes(8, "big") + packets[k % 4] for k in range(4000))
    )
    read(path, ["HEARTBEAT"])
    tracemalloc.start()
    recording = read(path, ["SERVO_OUTPUT_RAW"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    record = recording["SERVO_OUTPUT_RAW[1]"]
    assert len(record) == 1000
    assert peak < 3 * record.time.nbytes * (1 + len(record.signals))


def beat(at, system=1, component=1, kind=2, autopilot=3, base=81, mode=5):
    heartbeat = mavlink.MAVLink_heartbeat_message(kind, autopilot, base, mode, 4, 3)
    return BOOT + round(at * 1e6), system, component, heartbeat


def test_the_firmware_of_a_vehicle_is_that_of_its_type_in_mavlink(saved):
    """By the names that pymavlink gives to the numbers."""
    firmware = {
        "ArduCopter": "QUADROTOR COAXIAL HELICOPTER HEXAROTOR OCTOROTOR TRICOPTER DODECAROTOR DECAROTOR",
        "ArduPlane": "FIXED_WING FLAPPING_WING VTOL_DUOROTOR VTOL_QUADROTOR VTOL_TILTROTOR 22 23 24 VTOL_RESERVED5 "
        "PARAFOIL",  # the numbers have had several names
        "ArduRover": "GROUND_ROVER SURFACE_BOAT",
        "ArduSub": "SUBMARINE",
        "Blimp": "AIRSHIP",
        "ArduPilot": "GENERIC GIMBAL ROCKET BATTERY CAMERA KITE",
    }
    for vehicle, names in firmware.items():
        for name in names.split():
            kind = int(name) if name.isdigit() else getattr(mavlink, f"MAV_TYPE_{name}")
            assert saved(tlog([beat(0.0, kind=kind)])).metadata["vehicle"] == vehicle, name


def test_the_vehicle_is_the_first_sender_that_is_an_autopilot(saved):
    """A ground station, a gimbal without one and a second vehicle neither name it, nor change its modes."""
    packets = [
        beat(0.0, 255, 190, kind=6, autopilot=8, mode=9),
        beat(0.1, 255, 191, kind=6, autopilot=3, mode=9),
        beat(0.2, 1, 154, kind=26, autopilot=8, mode=9),
        *(beat(1.0 + k, mode=(5, 5, 25, 5)[k], base=81 | 128 * (k in (1, 2))) for k in range(4)),
        beat(1.5, 2, 1, kind=1, mode=10, base=81 | 128),
    ]
    about = saved(tlog(sorted(packets, key=lambda p: p[0]))).metadata
    assert about["vehicle"] == "ArduCopter"
    assert about["modes"] == ((1.0, "LOITER"), (3.0, "SYSTEMID"), (4.0, "LOITER"))


def test_packets_without_a_time_of_their_own_lie_by_their_reception(saved):
    """Zero is the sender's start: it says 7 s when it is received at 3 s of the log; 0 and UTC are no such times."""
    packets = [beat(0.0)]
    for k in range(11):
        t = 3 + 0.1 * k
        packets += [
            (
                BOOT + t * 1e6,
                1,
                1,
                mavlink.MAVLink_attitude_message(7000 + 100 * k, 0.1, 0.2, 0.3, 0, 0, 0),
            ),
            (
                BOOT + (t + 0.05) * 1e6,
                1,
                1,
                mavlink.MAVLink_vfr_hud_message(1.0, 1.5, 90, 30, 12.0, 0.5),
            ),
        ]
    stamps = (0, 10_000_000, BOOT)
    packets += [
        (BOOT + (5 + k) * 1e6, 1, 1, mavlink.MAVLink_raw_imu_message(stamp, *range(9)))
        for k, stamp in enumerate(stamps)
    ]
    recording = saved(tlog(packets))
    assert recording["ATTITUDE"].time == pytest.approx(7 + 0.1 * np.arange(11))
    assert recording["VFR_HUD"].time == pytest.approx(7.05 + 0.1 * np.arange(11))
    assert recording["RAW_IMU"].time == pytest.approx([9.0, 10.0, 11.0])
    assert recording["RAW_IMU"]["zgyro"].tolist() == [5, 5, 5]
    assert recording.findings == (
        "these carry no time stamp and are given their time of reception: HEARTBEAT, VFR_HUD.",
    )
