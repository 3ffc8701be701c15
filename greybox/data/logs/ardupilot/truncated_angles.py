"""Angles that ArduPilot logs as whole hundredths of a degree, cut off toward zero.

An angle that crosses zero is half a step too small in magnitude on both sides: the error is a
square wave in phase with the angle. Relative to a sine of amplitude A, its fundamental is 2 step /
(π A). At an amplitude of 0.47°, the gain is 1.4 % low and disagrees with the measured rate. The
mean loss is half a step, which is added.

Source: AP_AHRS.cpp of ArduPilot (update_cd_values: a float is assigned to a whole number of
centidegrees) and the format letter c of https://ardupilot.org/copter/docs/logmessages.html.
"""

import numpy as np

from greybox.data.files.arrays import Array

STEP = 0.01  # deg
MESSAGES = ("ATT", "AHR2", "EKF1", "NKF1", "XKF1")
# Yaw runs from 0 to 360: its half step is an offset only.
FIELDS = ("Roll", "Pitch", "DesRoll", "DesPitch")


def is_truncated(signal: str, values: Array) -> bool:
    """Return whether a signal, deg, was truncated, which later firmware no longer does."""
    message, _, field = signal.rpartition(".")
    if message.partition("[")[0] not in MESSAGES or field not in FIELDS:
        return False
    steps = values[np.isfinite(values)] / STEP
    # In single precision, 180° has an error of a hundred-thousandth of a degree, 1e-3 steps.
    return bool(steps.any() and np.abs(steps - np.round(steps)).max() < 2e-3)


def untruncated(signal: str, values: Array) -> Array:
    """Return truncated angles of a log, deg, with half a step added; other values unchanged.

    Zero stays zero: angles on both sides are truncated to it.
    """
    return (
        values + np.sign(np.round(values / STEP)) * STEP / 2
        if is_truncated(signal, values)
        else values
    )
