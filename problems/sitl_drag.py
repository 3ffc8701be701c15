"""Drag of a simulated quadcopter, from angle and velocity in time: (4.23) and (4.24).

Flown: as `sitl_pitch`, in hover and about a pitch of 5°, where the vehicle accelerates to 2.5 m/s
and stops at the end. The tilt angle is measured; the velocity is the forward velocity of the
vehicle's state estimator. Both are at 12.5 Hz.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, section 4.2, which
takes a5 from the measured velocity. The simulator's linear drag is 4 f / m = 0.26 1/s in hover, and
it also has quadratic drag; these are settings, not estimates.
"""

from pathlib import Path
from typing import Any

import greybox as gb
from greybox.models.drag import Drag

minimum = -14516.2355  # every one of 100 starts; a negative log-likelihood
settings: dict[str, Any] = {"starts": 100, "seed": 0}

DATA = Path(__file__).parent / "data"
HOVER, MOVING = "sitl_drag_hover", "sitl_drag_5deg"


def data():
    """Return the records in hover and about 5°."""
    return tuple(gb.read(DATA / f"{name}.csv")[name] for name in (HOVER, MOVING))


def problem(records=None, **fixed):
    """Return both drags on both flights, or on other records; ``a5=0.0`` omits one.

    The thrust is not exactly aligned with the vehicle, and there is wind: both act as a bias of the
    angle, one for each flight.
    """
    stated = gb.several(
        Drag(), records or data(), criterion=gb.OutputError(biases=("theta",)), fixed=fixed
    )
    return stated.with_(name="drag, simulated flights")
