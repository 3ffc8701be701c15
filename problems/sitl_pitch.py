"""Pitch of a simulated quadcopter, from log to fit: (3.15)-(3.16), then (2.6) with damping.

Flown: the ArduPilot Copter firmware (4.6-dev) in its own simulator, recorded by its own logger;
setpoint sines of 3° from 20.11 to 1.00 rad/s in hover, each announced by a SINE message. The log in
`data/` is reduced to every seventh message of ATT, RATE and SINE, and to half of the last test.

Source: the simulator's physics, which are known: K = 91.0 1/s², a = 0.681 1/s, T_rotor = 0.050 s,
T_delay = 0.0008 s. This delay is that of the samples of the control: half of the 2.5 ms for which
the firmware holds each, less half a step of the simulator. The values shown as published are
therefore the truth, not an estimate, to their last digit: the simulator takes steps of 1/1200 s
(SIM_RATE_HZ), and a lag of 0.050 s is one of 0.0496 s if they are explicit Euler steps, as three
whole flights together suggest, 0.0496 ± 0.0002 s.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import greybox as gb
from greybox.models.rate import DampedAngle

published = {
    "source": "the simulator",
    "values": {"K_phi": 91.0, "a": 0.681, "T_rotor": 0.050, "T_delay": 0.0008},
    "cost": 0.1973,
}
minimum = 0.188011  # every one of 100 starts
settings: dict[str, Any] = {"starts": 100, "seed": 0}

LOG = Path(__file__).parent / "data" / "sitl_pitch.BIN"


def measured():
    """Return the finite-frequency estimate with its findings on each test."""
    log = gb.read(LOG)
    record = gb.prepare(log, {"u": "RATE.POut", "theta": "ATT.Pitch"})
    return gb.spectral.finite_frequency(record, gb.logs.find_segments(log, "SINE"))


def data():
    # Without the hold, this simulator would have a delay below zero.
    return replace(measured().response, about={})


def problem():
    # The criterion of the paper, which takes the errors of all sines as equal.
    return gb.Problem(DampedAngle(), data(), gb.RelativeError(), name="pitch, simulated flight")
