"""Rounded and saturated motor outputs, held against brute force."""

import numpy as np
import pytest

from greybox.data.logs.ardupilot.motors import (
    limits,
    motor_outputs,
    pwm_of_control,
    rounding_error,
    saturation,
)
from greybox.data.record import Record, Recording

QUAD = {f"SERVO{k}_FUNCTION": 32 + k for k in (1, 2, 3, 4)} | {
    "MOT_PWM_MIN": 1000,
    "MOT_PWM_MAX": 2000,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
}


@pytest.mark.parametrize(
    ("amplitude", "spread"),
    [(0.26, 0.0), (0.5, 0.0), (1.0, 0.0), (5.0, 0.0), (0.5, 0.3), (2.0, 0.2)],
)
def test_the_gain_of_a_rounded_sine_scatters_as_stated(amplitude, spread):
    """Over offsets between steps, with and without other motions that carry it across them."""
    rng = np.random.default_rng(0)
    wave = np.sin(2 * np.pi * np.arange(3000) / 3000)
    offsets = (np.arange(200) + 0.5) / 200
    other = spread * rng.normal(size=(200, 3000))
    rounded = np.round(offsets[:, None] + amplitude * wave + other)
    gain = 2 * np.mean((rounded - other) * wave, axis=1) / amplitude
    noise = 0.0 if not spread else np.sqrt(2 / 12 / 3000) * 2 / amplitude / np.sqrt(2)
    assert np.sqrt(np.mean((gain - 1) ** 2)) == pytest.approx(
        float(rounding_error(amplitude, spread)[0]), rel=0.1, abs=noise
    )


def test_a_control_moves_a_motor_by_the_slope_of_its_thrust_curve():
    """Thrust (1 - e) a + e a² of the actuator's a, solved for both sides of the hover."""
    expo, hover, small = 0.65, 0.39, 1e-6
    a = [np.roots([expo, 1 - expo, -(hover + 0.5 * u)]).max() for u in (-small, small)]
    expected = (a[1] - a[0]) / (2 * small) * (0.95 - 0.15) * 1000
    assert pwm_of_control(QUAD) == pytest.approx(expected, rel=1e-4)
    assert np.isnan(pwm_of_control({}))


def test_motors_at_their_limits_are_counted():
    time = np.arange(0, 10, 0.1)
    outputs = np.full((5, 100), 1500.0)
    outputs[1, 10:20] = 1150
    outputs[2, 15:25] = 1949  # cut off, not rounded
    outputs[4] = 1000  # a servo
    signals = {f"C{k + 1}": values for k, values in enumerate(outputs)}
    log = Recording({"RCOU": Record(time, signals)}, metadata={"parameters": QUAD})
    assert limits(QUAD) == (1150, 1950)
    assert saturation(log, [(0, 10)]) == pytest.approx(0.15)
    assert saturation(log, [(5, 10)]) == 0
    assert set(motor_outputs(log, 0, 10)) == {"C1", "C2", "C3", "C4"}
    assert np.isnan(saturation(Recording({}), [(0, 10)]))


def test_motors_are_those_of_ardupilots_list_of_functions():
    """Motors 1 to 8 are 33 to 40, 9 to 12 are 82 to 85; 41 tilts rotors, 86 is a spoiler."""
    functions = (32, 33, 40, 41, 81, 82, 85, 86)
    parameters = {f"SERVO{k}_FUNCTION": function for k, function in enumerate(functions, start=1)}
    outputs = Record([0.0, 1.0], {f"C{k}": [1500.0, 1600.0] for k in range(1, 9)}, name="RCOU")
    motors = motor_outputs(
        Recording({"RCOU": outputs}, metadata={"parameters": parameters}), 0.0, 1.0
    )
    assert [*motors] == ["C2", "C3", "C6", "C7"]


@pytest.mark.parametrize(
    ("stated", "curve", "ends"),
    [
        ({"MOT_PWM_MIN": 1100, "MOT_PWM_MAX": 1940}, (0.65, 0.39, 0.15, 0.95), (1226, 1898)),
        (
            {"MOT_SPIN_MIN": 0.1, "MOT_SPIN_MAX": 0.9, "MOT_THST_EXPO": 0.4},
            (0.4, 0.39, 0.1, 0.9),
            (1100, 1900),
        ),
        (
            {"MOT_PWM_MIN": 0, "MOT_PWM_MAX": 1900},
            (0.65, 0.39, 0.15, 0.95),
            (1150, 1950),
        ),  # 0: those of the radio
        ({"MOT_PWM_MIN": 1900, "MOT_PWM_MAX": 1100}, (0.65, 0.39, 0.15, 0.95), (1150, 1950)),
        ({"MOT_THST_HOVER": 0.2, "MOT_THST_EXPO": 0.0}, (0.0, 0.2, 0.15, 0.95), (1150, 1950)),
    ],
)
def test_the_range_of_a_motor_is_that_of_its_parameters(stated, curve, ends):
    """The slope of thrust (1 - e) a + e a² at the hover by its inverse function, a half of a control's 1 in thrust."""
    expo, hover, spin_min, spin_max = curve
    parameters = QUAD | stated
    assert limits(parameters) == ends
    a = np.linspace(0, 1, 200_001)
    at_hover = np.interp([hover - 1e-4, hover + 1e-4], (1 - expo) * a + expo * a**2, a)
    width = (ends[1] - ends[0]) / (spin_max - spin_min)
    expected = np.diff(at_hover)[0] / 2e-4 * 0.5 * (spin_max - spin_min) * width
    assert pwm_of_control(parameters) == pytest.approx(expected, rel=1e-4)


def test_what_a_log_does_not_say_of_its_motors_is_ardupilots_default():
    stated = {
        "MOT_SPIN_MIN": 0.15,
        "MOT_SPIN_MAX": 0.95,
        "MOT_THST_HOVER": 0.35,
        "MOT_THST_EXPO": 0.5,
    }
    assert pwm_of_control({"MOT_THST_EXPO": 0.5}) == pwm_of_control(stated)
    assert limits({}) == (1150, 1950)


def test_the_share_of_saturation_is_weighted_by_the_samples_of_each_stretch():
    """30 of 100 samples at the upper limit, 40 of 50 at the lower one; a step away there is no limit."""
    time = np.arange(0, 20, 0.1)
    outputs = np.full(200, 1500.0)
    outputs[20:50], outputs[50:60] = 1950, 1948
    outputs[110:150], outputs[150:155] = 1150, 1151
    log = Recording(
        {"RCOU": Record(time, {"C1": outputs, "Cx": outputs})}, metadata={"parameters": QUAD}
    )
    spans = [(0.0, 9.95), (11.0, 15.95), (50.0, 60.0)]
    assert saturation(log, spans[:1]) == pytest.approx(0.3)
    assert saturation(log, spans) == pytest.approx(70 / 150)
    inside = motor_outputs(log, time[28], time[32])
    assert {name: values.tolist() for name, values in inside.items()} == {
        "C1": outputs[28:33].tolist()
    }
    assert motor_outputs(log, 30.0, 40.0) == {}
    assert motor_outputs(Recording(log.records), 0.0, 9.0) == {}  # no servo is known to be a motor
