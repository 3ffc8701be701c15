"""Drag of a real quadcopter, from its accelerometer and its velocity: (4.23) and (4.24).

Flown: as `nanobench_thrust`, at up to 1.8 m/s. The velocity is that of a motion capture system,
in body axes; the specific force across the rotor axis is that of the onboard accelerometer.

Source: NanoBench, Ullah and Baca 2026, https://github.com/syediu/nanobench-iros2026, BSD 3-Clause,
license in `data/nanobench_LICENSE.txt`. The equations are those that `sitl_drag` cites.
"""

from typing import Any

import greybox as gb
from greybox.models.specific_force import BodyDrag
from greybox.problems import nanobench_thrust

minimum = -14936.3910  # every one of 100 starts; a negative log-likelihood
settings: dict[str, Any] = {"starts": 100, "seed": 0}


def data():
    """Return the two flights that are fitted."""
    return nanobench_thrust.data()


def problem(records=None, **fixed):
    """Return both drags on both flights, or on other records; ``C_x=0.0`` omits one.

    The accelerometer has an offset along each axis, which differs between flights.
    """
    criterion = gb.OutputError(biases=("a_x", "a_y"))
    stated = gb.several(BodyDrag(), records or data(), criterion=criterion, fixed=fixed)
    return stated.with_(name="drag of a Crazyflie")
