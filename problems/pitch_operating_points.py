"""Pitch angle in hover and about 5°, one nonlinear model: Tables 3.1 and 4.3, (4.23).

Flown: as in `pitch_hover` and `pitch_5deg`.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, section 4.2. The paper
finds that the parameters of the linear model (4.25) differ between 5° and hover, (4.28) and (4.31),
and asks what they depend on. Here (4.23) is linearized at its trim for each table, so only its own
nonlinearity can make the two responses differ.

This does not explain the difference: fitted to each table alone the costs are 0.5576 and 0.6594, in
total 1.217; with one set of parameters they are 4.713 and 1.372, in total 6.084, five times as
much. The trim changes only the slopes of tan θ and of the drag, while the tables need different a1
and a3 (`pitch_two_points` frees them and costs 1.791).

The slope of the drag C_x is zero in hover. C_x is fixed where its slope at 5° equals the paper's a5
of 0.16 1/s. When free, it goes to its lower bound of 0.001 1/m, at a cost of 6.027: the data at 5°
show no drag.
"""

import math
from typing import Any

import greybox as gb
from greybox.data.files.numbers_in_text import number
from greybox.data.files.text_table import text_table
from greybox.models.tilt import PAPER_G, NonlinearTilt, Tilt
from greybox.problems import pitch_5deg, pitch_hover

ANGLE = math.radians(5)
DRAG = Tilt.a5.start**2 / (
    4 * PAPER_G * math.tan(ANGLE)
)  # 2 C_x |v| = a5 at the speed where C_x v² = g tan θ

minimum = 6.084491  # 982 of 1000 starts
settings: dict[str, Any] = {"starts": 200, "seed": 0}


def data():
    return pitch_hover.data(), pitch_5deg.data()


def tables():
    """Return the two problems whose sum is the joint one."""
    hover, moving = data()
    return tuple(
        gb.Problem(NonlinearTilt(), table, at={"theta": angle}, fixed={"C_x": DRAG})
        for table, angle in ((hover, 0.0), (moving, ANGLE))
    )


def problem():
    hover, moving = tables()
    return (hover + moving).with_(name="pitch, one nonlinear model")


def costs(starts=50):
    """Return for each table the cost of a fit to it alone and its cost in the joint fit."""
    joint = gb.fit(problem(), starts, progress=False).estimate
    return {
        part.name: (gb.fit(part, starts, progress=False).cost, gb.cost(part, joint))
        for part in tables()
    }


def comparison(starts=50):
    """Return the costs as a text table: how well one set of parameters explains both tables."""
    found = costs(starts)
    found["both"] = (
        sum(alone for alone, _ in found.values()),
        sum(joint for _, joint in found.values()),
    )
    cells = [
        [name, number(alone), number(joint), f"{joint / alone:.1f}"]
        for name, (alone, joint) in found.items()
    ]
    return text_table(["table", "cost alone", "cost jointly", "ratio"], cells, left=(0,))
