"""Thrust of a real quadcopter: its rotor lag, and its dependence on command and battery voltage.

Flown: a Crazyflie 2.1 of 35 g on a figure of eight and on a star at up to 1.8 m/s, by its own
controller, as the battery falls from 3.6 to 3.3 V. The command is the mean of the four motors,
between 0 and 1; the specific force is that of the onboard accelerometer. Both are at 100 Hz.

Source: NanoBench, Ullah and Baca 2026, https://github.com/syediu/nanobench-iros2026, BSD 3-Clause,
license in `data/nanobench_LICENSE.txt`. `held_out()` is a third flight, a trefoil knot.
"""

from pathlib import Path
from typing import Any

import greybox as gb
from greybox.models.specific_force import RotorThrust

minimum = -2800.8646  # 73 of 100 starts; a negative log-likelihood
settings: dict[str, Any] = {"starts": 100, "seed": 0}

DATA = Path(__file__).parent / "data"


def flight(name):
    """Return a shipped flight: "figure8", "star" or "trefoil"."""
    return gb.read(DATA / f"nanobench_{name}.csv")[f"nanobench_{name}"]


def data():
    """Return the two flights that are fitted."""
    return flight("figure8"), flight("star")


def held_out():
    """Return the flight that is not fitted."""
    return flight("trefoil")


def problem(records=None):
    """Return the thrust on both flights, or on other records."""
    return gb.several(RotorThrust(), records or data()).with_(name="thrust of a Crazyflie")
