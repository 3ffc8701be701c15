"""Motor outputs: how finely a control reaches the motors, and when they are at their limits.

A motor's PWM is a whole number of µs (DShot values are computed from it). A control of less than a
step reaches the motors only if other motions carry it across the steps: the gain may then lie
anywhere between zero and twice its value, and the rounding adds harmonics.

The rounded sine of amplitude A around an offset b, in steps of Δ, has the fundamental A (1 + ε)
with

    ε = Σ_m (-1)^m 2Δ / (π m A) J_1(2π m A/Δ) cos(2π m b/Δ),

and other motions of standard deviation σ shrink the terms by exp(-2 (π m σ/Δ)²) (Widrow and Kollár,
Quantization Noise, 2008, chapters 3 and 9). The offset is the trim of the motor, which is not known
to a fraction of a step.

Sources: AP_MotorsMulticopter.cpp and AP_MotorsMatrix.cpp of ArduPilot; MOT_PWM_MIN, MOT_PWM_MAX,
MOT_SPIN_MIN, MOT_SPIN_MAX, MOT_THST_EXPO, MOT_THST_HOVER and SERVOn_FUNCTION at
https://ardupilot.org/copter/docs/parameters.html.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import Array, Interval
from greybox.data.files.named_values import Values
from greybox.data.record import Recording

MOTORS = frozenset((*range(33, 41), *range(82, 86)))  # SERVOn_FUNCTION of motors 1 to 8 and 9 to 12
DEFAULTS = {
    "MOT_SPIN_MIN": 0.15,
    "MOT_SPIN_MAX": 0.95,
    "MOT_THST_HOVER": 0.35,
}
PWM = (1000.0, 2000.0)  # µs, used where MOT_PWM_MIN and MOT_PWM_MAX were not logged
TERMS = np.arange(1, 21)  # of the sum; the next are below 1/20^1.5 of the first


def pwm_of_control(parameters: Values) -> float:
    """Return how far a control of 1 moves a motor in hover, µs; NaN for other vehicles."""
    if "MOT_THST_EXPO" not in parameters:
        return math.nan
    values = {**DEFAULTS, **parameters}
    expo = values["MOT_THST_EXPO"]
    # thrust = (1 - expo) a + expo a², with the actuator's a from 0 to 1: the derivative of this
    # curve at the thrust of hover, without solving for a.
    slope = math.sqrt((1 - expo) ** 2 + 4 * expo * values["MOT_THST_HOVER"])
    least, greatest = _range(parameters)
    # A control of 1 changes the thrust of a motor by half: AP_MotorsMatrix::normalise_rpy_factors.
    return 0.5 * (greatest - least) / slope


def rounding_error(amplitude: ArrayLike, spread: ArrayLike) -> Array:
    """Return the relative standard error of the gain of a rounded sine, (n,), for any offset.

    Parameters
    ----------
    amplitude, spread : (n,) arrays, steps
        Amplitude of the sine, and standard deviation of all other motions.
    """
    from scipy.special import j1  # noqa: PLC0415  (scipy takes longer to import than this package)

    a, sigma = (np.array(values, dtype=float, ndmin=1)[..., None] for values in (amplitude, spread))
    # The terms are 0/0 at zero amplitude, and their limit is finite.
    a = np.maximum(a, 1e-9)
    terms = (
        2
        / (math.pi * TERMS * a)
        * j1(math.tau * TERMS * a)
        * np.exp(-2 * (math.pi * TERMS * sigma) ** 2)
    )
    # The mean of cos² over the offset.
    return np.sqrt(np.sum(terms**2, axis=-1) / 2)


def motor_outputs(recording: Recording, start: float, end: float) -> Mapping[str, Array]:
    """Return the PWM of the motors from `start` to `end`, µs, by name; none without a log."""
    if "RCOU" not in recording:
        return {}
    record = recording["RCOU"]
    during = record.during(start, end)
    motors = [
        name
        for name in record.signals
        if name[:1] == "C" and recording.parameters.get(f"SERVO{name[1:]}_FUNCTION") in MOTORS
    ]
    return {name: record[name][during] for name in motors if during.any()}


def limits(parameters: Values) -> Interval:
    """Return the least and the greatest PWM of a flying motor, µs."""
    least, greatest = _range(parameters)
    return round(least), round(greatest)


def saturation(recording: Recording, spans: Sequence[Interval]) -> float:
    """Return the share of time during which a motor is at its limit; NaN without logged outputs."""
    low, high = limits(recording.parameters)
    at_limit = []
    for start, end in spans:
        outputs = motor_outputs(recording, start, end)
        if outputs:
            values = np.array(list(outputs.values()))
            # Outputs are truncated to whole numbers: the greatest may be a step less.
            at_limit.append(np.any((values <= low) | (values >= high - 1), axis=0))
    return float(np.mean(np.concatenate(at_limit))) if at_limit else math.nan


def _range(parameters: Values) -> Interval:
    low, high = (parameters.get(name, 0) for name in ("MOT_PWM_MIN", "MOT_PWM_MAX"))
    low, high = (low, high) if 0 < low < high else PWM
    values = {**DEFAULTS, **parameters}
    least, greatest = (values[name] for name in ("MOT_SPIN_MIN", "MOT_SPIN_MAX"))
    return low + least * (high - low), low + greatest * (high - low)
