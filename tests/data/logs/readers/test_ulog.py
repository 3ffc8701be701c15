import importlib.util

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_logs import ulog

from greybox.data.logs.readers import read
from greybox.data.logs.readers.ulog import modes_of, with_angles
from greybox.data.record import Record

installed = pytest.mark.skipif(
    importlib.util.find_spec("pyulog") is None, reason="the extra px4 is not installed"
)


@pytest.fixture
def saved(tmp_path):
    def write_and_read(data, **options):
        path = tmp_path / "log.ulg"
        path.write_bytes(data)
        return read(path, **options)

    return write_and_read


@installed
def test_topics_are_records(saved):
    recording = saved(ulog())
    assert set(recording) == {
        "vehicle_attitude",
        "sensor_accel[0]",
        "sensor_accel[1]",
        "vehicle_status",
    }
    attitude = recording["vehicle_attitude"]
    np.testing.assert_allclose(attitude.time, 2 + np.arange(200) / 100)
    np.testing.assert_array_equal(attitude["q[2]"], np.sin(0.1 * np.arange(200)).astype("f4"))
    # The quaternion (1, 0, sin, 0), normalized, is a pitch of twice the arc tangent of its ratio.
    q = attitude["q[2]"][:10]
    np.testing.assert_allclose(np.sin(attitude["pitch"][:10]), np.clip(2 * q, -1, 1), atol=1e-6)
    assert attitude.units["pitch"] == "rad"
    np.testing.assert_allclose(recording["sensor_accel[1]"]["x"], 10.81)
    assert recording.findings == ()


@installed
def test_metadata(saved):
    recording = saved(ulog(), messages=("vehicle_attitude", "vehicle_gps_position"))
    assert list(recording) == ["vehicle_attitude"]
    assert recording.findings == ("there is no topic vehicle_gps_position.",)
    about = recording.metadata
    assert (about["vehicle"], about["firmware"]) == ("PX4", "v1.14.3 (29f5e2a1)")
    assert about["parameters"] == {"MC_PITCH_P": 7, "CBRK_IO": 4}
    ((_, *change),) = about["parameter_changes"]
    assert change == ["MC_PITCH_P", 6.5, 7.0]
    assert about["texts"] == ((2.1, "[commander] Takeoff detected"),)
    assert about["modes"] == ((2, "POSCTL"), (3, "STAB"))


@installed
def test_a_truncated_log_is_read_up_to_its_end(saved):
    assert len(saved(ulog()[:-5000])["vehicle_attitude"]) > 100


def test_without_pyulog_the_cure_is_named(saved, monkeypatch):
    monkeypatch.setattr("greybox.data.logs.readers.ulog.find_spec", lambda name: None)
    with pytest.raises(
        ValueError, match=r"log\.ulg is a PX4 log, which needs pyulog: install it with pip install"
    ):
        saved(ulog())


def test_the_angles_of_a_quaternion_are_those_of_scipys_rotation():
    rotation = Rotation.random(20, random_state=0)
    x, y, z, w = rotation.as_quat().T
    quaternion = {f"q[{k}]": values for k, values in enumerate((w, x, y, z))}
    made = with_angles("vehicle_attitude", Record(np.arange(20.0), quaternion, hold={"q[0]": 0.0}))
    yaw, pitch, roll = rotation.as_euler("ZYX").T
    for name, angle in (("roll", roll), ("pitch", pitch), ("yaw", yaw)):
        np.testing.assert_allclose(made[name], angle, atol=1e-9)
        assert made.units[name] == "rad"
        assert made.hold[name] == 0.0
    known = Record(np.arange(20.0), quaternion | {"roll": np.ones(20)})
    assert np.all(with_angles("vehicle_attitude", known)["roll"] == 1)


def test_modes_are_those_of_px4s_status():
    """NAVIGATION_STATE_* of vehicle_status.msg."""
    names = "MANUAL ALTCTL POSCTL AUTO_MISSION AUTO_LOITER AUTO_RTL . . . . ACRO . DESCEND TERMINATION OFFBOARD STAB . "
    names += "AUTO_TAKEOFF AUTO_LAND AUTO_FOLLOW_TARGET AUTO_PRECLAND ORBIT AUTO_VTOL_TAKEOFF ."
    expected = [f"mode {k}" if name == "." else name for k, name in enumerate(names.split())]
    status = Record(np.arange(48) / 2, {"nav_state": np.repeat(np.arange(24.0), 2)})
    assert modes_of(status) == {"modes": tuple(zip(np.arange(24.0), expected, strict=True))}


@pytest.mark.parametrize(
    ("topic", "field", "unit"),
    [
        ("vehicle_angular_velocity", "xyz[2]", "rad/s"),
        ("vehicle_angular_velocity", "xyz_derivative[2]", ""),
        ("vehicle_rates_setpoint", "yaw", "rad/s"),
        ("vehicle_rates_setpoint", "yaw_body", ""),
        ("vehicle_attitude", "pitchspeed", "rad/s"),
        ("vehicle_attitude", "pitch", ""),
        ("sensor_accel", "x", ""),
    ],
)
def test_rates_have_their_unit(topic, field, unit):
    assert with_angles(topic, Record([0.0, 1.0], {field: [1.0, 2.0]})).units.get(field, "") == unit
