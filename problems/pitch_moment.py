"""Pitch angle in hover and about 5°, more terms of the moment: Tables 3.1 and 4.3, (4.23).

Flown: as in `pitch_hover` and `pitch_5deg`.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, section 4.2 and its
conclusion, "further research is required to find limits and dependencies of the system parameters".

The question: (4.23) with one set of parameters costs 6.08 on both tables
(`pitch_operating_points`), two separate fits cost 1.22. `selection` looks for the smallest
structure that explains both, among six odd terms of the moment. Three are supported, the moment by
|v| v, by |v| θ and by |v| τ: together they cost 1.325. A fourth, damping by |v| q, would come to
1.217, which is all that separate parameters can do; its p-value of 0.035 is above the limit of
0.017 for one of three that are tried.

The tables leave this open: |θ| θ may stand in the place of |v| v or of |v| θ, and |θ| q in that of
|v| q, at the same cost. About one operating point away from hover each term only changes the four
coefficients of (4.25), and the trim ties v to θ. `flights` says which other angle would distinguish
them.

C_x is fixed where its slope at 5° equals the paper's a5 of 0.16 1/s, as in
`pitch_operating_points`.
"""

import math
from typing import Any

import greybox as gb
from greybox.data.files.text_table import text_table
from greybox.models.moment import MOMENT_TERMS, TiltMomentAt
from greybox.problems import pitch_5deg, pitch_hover
from greybox.problems.pitch_operating_points import ANGLE, DRAG

TERMS = ("b_vv", "b_vtheta", "b_vtau")
RIVALS = (("b_thetatheta", "b_vtheta", "b_vtau"), ("b_vv", "b_thetatheta", "b_vtau"))
ANGLES = (2.5, 7.5, 10.0, 15.0)  # degrees

minimum = 1.324703
settings: dict[str, Any] = {"starts": 200, "seed": 0}


def data():
    return pitch_hover.data(), pitch_5deg.data()


def problem(terms=TERMS, more=()):
    """Return the joint problem with these terms; `more` are further (angle in rad, response)."""
    hover, moving = data()
    first, second, *others = (
        gb.Problem(TiltMomentAt(angle, DRAG), table, free=terms)
        for angle, table in ((0.0, hover), (ANGLE, moving), *more)
    )
    return sum(others, first + second).with_(name="pitch, more terms of the moment")


def separate():
    """Return the problem with separate parameters for each table: the least cost of any terms."""
    hover, moving = data()
    own = {name: f"{name}_5deg" for name in ("a1", "a2", "a3", "a4")}
    return gb.Problem(TiltMomentAt(0.0, DRAG), hover) + gb.Problem(
        TiltMomentAt(ANGLE, DRAG), moving, rename=own
    )


def selection(starts=4):
    """Return the terms that the two tables support."""
    return gb.stepwise(problem(()), MOMENT_TERMS, starts=starts)


def flights(angles=ANGLES, starts=None):
    """Return the angles about which the same sines would separate the chosen terms from rivals.

    A noise-free response of the chosen structure is added to the tables, and each rival fitted to
    all three: by how many variances of the errors its sum of squares is the larger, which is the
    expected difference of AIC. From 10 upward the rival has no support (Burnham and Anderson
    (2002), section 2.6).
    """
    by = {"criterion": gb.SquaredRelativeError()}
    chosen = gb.fit(problem().with_(**by), starts, progress=False)
    variance = chosen.cost / (
        2 * sum(len(part.data) for part in chosen.responses) - len(chosen.free)
    )
    omega = pitch_5deg.data().omega
    rows = []
    for terms in RIVALS:
        more = []
        for angle in angles:
            made = gb.frequency_response(
                TiltMomentAt(math.radians(angle), DRAG), chosen.estimate, omega
            )
            stated = problem(terms, more=[(math.radians(angle), made)]).with_(**by)
            rival = gb.fit(stated, starts, progress=False)
            more.append(f"{(rival.cost - chosen.cost) / variance:.0f}")
        rows.append([", ".join(terms), *more])
    return text_table(["rival", *(f"{angle:g}°" for angle in angles)], rows, left=(0,))
