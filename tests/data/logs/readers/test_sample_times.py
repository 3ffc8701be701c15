"""Messages of sensors are at the times of their samples, those of controllers at their own."""

import numpy as np
import pytest
from synthetic_logs import Log

import greybox as gb
from greybox.data.logs.readers.messages import Messages
from greybox.data.logs.readers.sample_times import at_sample_times

COUNT = 500
SAMPLED = 1.0 + np.arange(COUNT) / 400
LOGGED = SAMPLED + 0.0004 + np.random.default_rng(0).uniform(0, 0.0002, COUNT)


def times(name, sampled, **columns):
    group = Messages(
        name, np.arange(COUNT), LOGGED, {"timestamp_sample": np.round(1e6 * sampled), **columns}
    )
    return at_sample_times([group])[0].time


def test_a_sensor_has_the_times_of_its_samples():
    np.testing.assert_allclose(
        times("vehicle_angular_velocity", SAMPLED, **{"xyz[0]": LOGGED}), SAMPLED, atol=1e-6
    )
    np.testing.assert_allclose(times("sensor_gyro", SAMPLED, x=LOGGED), SAMPLED, atol=1e-6)


def test_an_output_of_a_controller_keeps_its_own_times():
    assert np.all(times("vehicle_torque_setpoint", SAMPLED, **{"xyz[0]": LOGGED}) == LOGGED)
    assert np.all(times("actuator_motors", SAMPLED, **{"control[0]": LOGGED}) == LOGGED)


@pytest.mark.parametrize(
    "sampled", [0 * SAMPLED, SAMPLED + 100, np.floor(SAMPLED * 100) / 100], ids=str
)
def test_stamps_that_are_unset_of_another_clock_or_repeated_are_not_used(sampled):
    assert np.all(times("sensor_gyro", sampled, x=LOGGED) == LOGGED)


def test_the_raw_gyros_of_ardupilot_have_the_times_of_their_samples(tmp_path):
    log = Log()
    log.fmt("GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ", "s#skkk", "F-F000")
    stamps = np.round(1e6 * np.c_[LOGGED, SAMPLED]).astype(int).tolist()
    for k, (logged, sampled) in enumerate(stamps):
        for sensor in (0, 1):
            log.add("GYR", logged + sensor, sensor, sampled, float(k), 0.0, 0.0)
    path = tmp_path / "raw.BIN"
    path.write_bytes(log.binary)
    gyro = gb.read(path)["GYR[1]"]
    np.testing.assert_allclose(gyro.time, SAMPLED, atol=1e-6)
    assert gyro["GyrX"].tolist() == list(range(COUNT))
