"""Every structure of the paper on every table that suits it, by criterion and delay.

``greybox batch paper --out DIR`` fits them all from 200 starts, by three criteria, with the exact
and a Padé delay, and ``python -m greybox.problems._paper_study DIR`` also prints the estimates
beside those of the paper. Structures of a rate, (2.5) to (2.12) and (4.34), are fitted to the
response of the angle times s. Rotor and delay are fixed at (4.22), except for the rotor's own table
and for (2.13), which has no delay.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, Tables 3.1, 4.2 and
4.3.
"""

import sys
from dataclasses import replace

import greybox as gb
from greybox.data.files.numbers_in_text import number
from greybox.data.files.text_table import text_table
from greybox.models.coupled import CoupledVelocityTransfer, DampedCoupledVelocityTransfer
from greybox.models.rate import BasicAngle, BasicRate, DampedRate, YawRateLag, YawRateLead
from greybox.models.tilt import Tilt
from greybox.models.yaw import YawRate
from greybox.problems import (
    pitch_5deg,
    pitch_hover,
    pitch_hover_ls,
    roll_hover,
    roll_hover_ls,
    rotors,
    yaw_hover,
    yaw_hover_ls,
)
from greybox.problems._paper import table
from greybox.workflows.study.study import shown

CRITERIA = {
    "relative-error": gb.RelativeError(),
    "squared": gb.SquaredRelativeError(),
    "magnitude-phase": gb.MagnitudePhase(),
}
DELAYS = ("exact", "pade:2")
STARTS = 200

ROTOR = {"T_rotor": 0.048, "T_delay": 0.0042}  # (4.22)

ANGLES = {"(2.6)": BasicAngle, "(4.25)": Tilt}
RATES = {
    "(2.5)": BasicRate,
    "(2.7)": DampedRate,
    "(2.9)": CoupledVelocityTransfer,
    "(2.12)": DampedCoupledVelocityTransfer,
}
YAW_RATES = {"(2.8)": YawRateLag, "(2.10)": YawRateLead, "(4.34)": YawRate}

# The published estimates, by structure and table.
PUBLISHED = {
    "roll (2.13)": roll_hover_ls.published,
    "pitch (2.13)": pitch_hover_ls.published,
    "yaw (2.13)": yaw_hover_ls.published,
    "rotors (4.21)": rotors.published,
    "roll (4.25)": roll_hover.published,
    "pitch (4.25)": pitch_hover.published,
    "pitch 5 deg (4.25)": pitch_5deg.published,
    "yaw (4.34)": yaw_hover.published,
}


def problems():
    """Return every structure with every table of its kind, by table and equation."""
    tilts = {
        "roll": table("3.1", "roll_", "phi", "roll hover"),
        "pitch": table("3.1", "pitch_", "theta", "pitch hover"),
        "pitch 5 deg": table("4.3", "pitch_", "theta", "pitch 5 deg"),
    }
    ratio = pitch_hover_ls.problem()
    stated = {
        "rotors (4.21)": rotors.problem(),
        "roll (2.13)": roll_hover_ls.problem(),
        "pitch (2.13)": ratio,
        "pitch 5 deg (2.13)": ratio.with_(data=tilts["pitch 5 deg"]),
        "yaw (2.13)": yaw_hover_ls.problem(),
    }
    for name, data in tilts.items():
        for equation, model in ANGLES.items():
            stated[f"{name} {equation}"] = problem(model(), replace(data, output=model.output))
        for equation, model in RATES.items():
            stated[f"{name} {equation}"] = problem(model(), rate(data, model.output))
    yaw = table("3.1", "yaw_", "psi", "yaw hover")
    for equation, model in YAW_RATES.items():
        stated[f"yaw {equation}"] = problem(model(), rate(yaw, model.output))
    return stated


def problem(model, data):
    """Return one structure on one table, with the values of the rotor where it has them."""
    rotor = {name: value for name, value in ROTOR.items() if name in model.parameters}
    return gb.Problem(model, data, fixed=rotor)


def rate(angle, name):
    """Return the response of the rate, from that of the angle."""
    return replace(angle, response=1j * angle.omega * angle.response, output=name)


def members(starts=STARTS):
    """Return all fits of the study."""
    return [
        gb.study.Member(
            stated.with_(criterion=criterion, delay=delay),
            starts,
            seed=0,
            name=f"{name}, {label}, {delay}",
        )
        for name, stated in problems().items()
        for label, criterion in CRITERIA.items()
        for delay in DELAYS
    ]


def beside_the_paper(study):
    """Return a table: what is published, and the estimates by every criterion, with exact delays.

    The cost is the sum of relative errors (4.26), the criterion of chapter 4. Chapter 3 solves the
    linear least squares (3.17) instead.
    """
    rows = []
    for name, published in PUBLISHED.items():
        answers = [study[f"{name}, {label}, exact"].answer for label in CRITERIA]
        place = f"{name}, {published['source']}"
        for parameter, value in published["values"].items():
            errors = [answer["standard_error"].get(parameter) for answer in answers]
            cells = [
                shown(answer["estimate"][parameter], error)
                for answer, error in zip(answers, errors, strict=True)
            ]
            rows.append([place, parameter, number(value, 4), *cells])
            place = ""
        costs = [number(answer["costs"]["relative-error"], 4) for answer in answers]
        rows.append(["", "cost (4.26)", number(published["cost"], 4), *costs])
    return text_table(["structure, source", "", "paper", *CRITERIA], rows, left=(0, 1))


if __name__ == "__main__":
    sys.stdout.write(f"{beside_the_paper(gb.batch(members(), sys.argv[1]))}\n")
