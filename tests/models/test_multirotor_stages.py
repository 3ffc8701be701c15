"""Flights of a multirotor in the logs of three firmwares."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.data.record import Recording
from greybox.models.multirotor import Multirotor, regular_frame
from greybox.models.multirotor_stages import airborne, flight_records

TIME = np.arange(0, 30, 0.002)
COMMAND = np.where((TIME > 4) & (TIME < 22), 0.6, 0.05) + 0.02 * np.sin(
    np.outer([1, 2, 3, 4], TIME)
)
RATES = 0.5 * np.sin(np.outer([1, 2, 3], TIME))
FORCE = np.array([0 * TIME, 0 * TIME + 0.5, 9.8 + np.sin(TIME)])


def crazyflie():
    signals = {f"motor.m{k + 1}": 65535 * row for k, row in enumerate(COMMAND)}
    signals |= {f"gyro.{k}": np.degrees(row) for k, row in zip("xyz", RATES, strict=True)}
    signals |= {f"acc.{k}": row / gb.g for k, row in zip("xyz", FORCE, strict=True)}
    units = {k: "deg/s" if "gyro" in k else "9.80665 m/s²" for k in signals if "motor" not in k}
    return Recording({"fixedFrequency": gb.Record(TIME, signals, units=units)}, "card")


def ardupilot():
    out = {f"C{k + 1}": 1000 + 1000 * row for k, row in enumerate(COMMAND)}
    turned = np.array([[1], [-1], [-1]])  # forward, right, down
    imu = dict(zip(("GyrX", "GyrY", "GyrZ"), turned * RATES, strict=True))
    imu |= dict(zip(("AccX", "AccY", "AccZ"), turned * FORCE, strict=True))
    units = {k: "rad/s" if "Gyr" in k else "m/s/s" for k in imu}
    return Recording(
        {"RCOU": gb.Record(TIME, out), "IMU": gb.Record(TIME, imu, units=units)}, "flight.BIN"
    )


def px4():
    turned = np.array([[1], [-1], [-1]])
    motors = {f"control[{k}]": row for k, row in enumerate(COMMAND)}
    rates = {f"xyz[{k}]": row for k, row in enumerate(turned * RATES)}
    force = {f"accelerometer_m_s2[{k}]": row for k, row in enumerate(turned * FORCE)}
    return Recording(
        {
            "actuator_motors": gb.Record(TIME, motors),
            "vehicle_angular_velocity": gb.Record(TIME, rates, units=dict.fromkeys(rates, "rad/s")),
            "sensor_combined": gb.Record(TIME, force, units=dict.fromkeys(force, "m/s^2")),
        },
        "flight.ulg",
    )


@pytest.mark.parametrize("log", [crazyflie, ardupilot, px4])
def test_every_firmware_gives_the_same_flight(log):
    (flight,) = flight_records(regular_frame(4), log())
    assert flight.time[0] == pytest.approx(5.0, abs=0.02)
    assert flight.time[-1] == pytest.approx(21.0, abs=0.02)
    for names, truth in (
        (("u_1", "u_2", "u_3", "u_4"), COMMAND),
        (("p", "q", "r"), RATES),
        (("a_x", "a_y", "a_z"), FORCE),
    ):
        for name, row in zip(names, truth, strict=True):
            assert_allclose(flight[name], np.interp(flight.time, TIME, row), atol=2e-3)


def test_falls_belong_to_a_flight_and_a_hop_is_none():
    time = np.arange(0, 40, 0.01)
    on = ((time > 2) & (time < 3.5)) | ((time > 10) & (time < 20)) | ((time > 21) & (time < 30))
    record = gb.Record(time, {"u_1": 0.5 * on, "u_2": 0.5 * on})
    assert_allclose(airborne(record, ["u_1", "u_2"]), [(11, 29)], atol=0.02)


@pytest.mark.parametrize(
    ("log", "sentence"),
    [
        (Recording({"ATT": gb.Record(TIME, {"Pitch": TIME})}, "a.BIN"), "no commands of 4 motors"),
        (
            Recording({"fixedFrequency": crazyflie()["fixedFrequency"].between(23, 30)}, "card"),
            "no flight of 3 s",
        ),
    ],
)
def test_refuses(log, sentence):
    with pytest.raises(ValueError, match=sentence):
        Multirotor().stages([log])
