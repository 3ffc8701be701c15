"""Rounded and saturated motor outputs, held against brute force."""

import numpy as np
import pytest

from greybox.data.record import Record, Recording
from greybox.logs.ardupilot.motors import limits, motor_outputs, pwm_of_control, rounding_error, saturation

QUAD = {f"SERVO{k}_FUNCTION": 32 + k for k in (1, 2, 3, 4)} | {
    "MOT_PWM_MIN": 1000,
    "MOT_PWM_MAX": 2000,
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
}


@pytest.mark.parametrize(
    ("amplitude", "spread"), [(0.26, 0.0), (0.5, 0.0), (1.0, 0.0), (5.0, 0.0), (0.5, 0.3), (2.0, 0.2)]
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
    assert set(motor_outputs(log, 0, 10).signals) == {"C1", "C2", "C3", "C4"}
    assert np.isnan(saturation(Recording({}), [(0, 10)]))


def test_motors_are_those_of_ardupilots_list_of_functions():
    """Motors 1 to 8 are 33 to 40, 9 to 12 are 82 to 85; 41 tilts rotors, 86 is a spoiler."""
    functions = (32, 33, 40, 41, 81, 82, 85, 86)
    parameters = {f"SERVO{k}_FUNCTION": function for k, function in enumerate(functions, start=1)}
    outputs = Record([0.0, 1.0], {f"C{k}": [1500.0, 1600.0] for k in range(1, 9)}, name="RCOU")
    motors = motor_outputs(Recording({"RCOU": outputs}, metadata={"parameters": parameters}), 0.0, 1.0)
    assert [*motors.signals] == ["C2", "C3", "C6", "C7"]
