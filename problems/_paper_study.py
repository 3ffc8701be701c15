"""Every structure of the paper on every table that suits it, by criterion, delay and seed.

``greybox batch paper --out DIR`` fits them all, by three criteria, with the exact and a Padé delay,
from two seeds, and `greybox compare DIR` shows them side by side. Structures of a rate, (2.5) to
(2.12) and (4.34), are fitted to the response of the angle times s. Rotor and delay are fixed at
(4.22), but for the rotor's own table.

Source: Frequency Domain Identification of the Quadcopter Attitude Dynamics, Tables 3.1, 4.2 and
4.3.
"""

from dataclasses import replace

import greybox as gb
from greybox.models.coupled import CoupledVelocityTransfer, DampedCoupledVelocityTransfer
from greybox.models.rate import BasicAngle, BasicRate, DampedRate, YawRateLag, YawRateLead
from greybox.models.tilt import Tilt
from greybox.models.yaw import YawRate
from greybox.problems import rotors
from greybox.problems._paper import table

CRITERIA = {
    "relative-error": gb.RelativeError(),
    "squared": gb.SquaredRelativeError(),
    "magnitude-phase": gb.MagnitudePhase(),
}
DELAYS = ("exact", "pade:2")
SEEDS = (0, 1)
STARTS = 20

ROTOR = {"T_rotor": 0.048, "T_delay": 0.0042}  # (4.22)

ANGLES = {"(2.6)": BasicAngle, "(4.25)": Tilt}
RATES = {
    "(2.5)": BasicRate,
    "(2.7)": DampedRate,
    "(2.9)": CoupledVelocityTransfer,
    "(2.12)": DampedCoupledVelocityTransfer,
}
YAW_RATES = {"(2.8)": YawRateLag, "(2.10)": YawRateLead, "(4.34)": YawRate}


def problems():
    """Return every structure with every table of its kind, by table and equation."""
    tilts = {
        "roll": table("3.1", "roll_", "phi", "roll hover"),
        "pitch": table("3.1", "pitch_", "theta", "pitch hover"),
        "pitch 5 deg": table("4.3", "pitch_", "theta", "pitch 5 deg"),
    }
    found = {"rotors (4.21)": rotors.problem()}
    for name, data in tilts.items():
        for equation, model in ANGLES.items():
            found[f"{name} {equation}"] = problem(model(), replace(data, output=model.output))
        for equation, model in RATES.items():
            found[f"{name} {equation}"] = problem(model(), rate(data, model.output))
    yaw = table("3.1", "yaw_", "psi", "yaw hover")
    for equation, model in YAW_RATES.items():
        found[f"yaw {equation}"] = problem(model(), rate(yaw, model.output))
    return found


def problem(model, data):
    """Return one structure on one table, with the values of the rotor where it has them."""
    known = {name: value for name, value in ROTOR.items() if name in model.parameters}
    return gb.Problem(model, data, fixed=known)


def rate(angle, name):
    """Return the response of the rate, from that of the angle."""
    return replace(angle, response=1j * angle.omega * angle.response, output=name)


def members():
    """Return all fits of the study."""
    return [
        gb.study.Member(
            stated.with_(criterion=criterion, delay=delay),
            STARTS,
            seed,
            name=f"{name}, {label}, {delay}, seed {seed}",
        )
        for name, stated in problems().items()
        for label, criterion in CRITERIA.items()
        for delay in DELAYS
        for seed in SEEDS
    ]
