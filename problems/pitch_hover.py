"""Pitch angle from the pitch control in hover: Table 3.1 and (4.25), estimate (4.28).

Flown: setpoint sines of the pitch angle of a quadcopter in hover.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, section 4.2.

As in the paper, rotor and delay are fixed at (4.22) and the drag a5 at 0.16 1/s. The paper prints
a3 times g. The cost at the minimum is lower than at the published estimate.
"""

from typing import Any

import greybox as gb
from greybox.models.tilt import PAPER_G, Tilt
from greybox.problems._paper import table

published = {
    "source": "(4.28)",
    "values": {"a1": -14.61, "a2": 2.97, "a3": 83.06 / PAPER_G, "a4": 295.5},
    "cost": 0.5866,
}
minimum = 0.559187  # 978 of 1000 starts; boxes a hundred times wider give no lower one
settings: dict[str, Any] = {"starts": 200, "seed": 0}


def data():
    return table("3.1", "pitch_", "theta", "pitch hover")


def problem():
    return gb.Problem(Tilt(), data())
