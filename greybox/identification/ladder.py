"""Ladders: the structures that `identify` fits to a measured response and compares, by the name of the output."""

from collections.abc import Sequence
from typing import NamedTuple


class Step(NamedTuple):
    """One structure: the file and class of an included model, the parameters to free, and what it describes."""

    model: str
    free: tuple[str, ...]
    about: str


# The largest two have the poles and zeros of (2.12) besides the lag of the rotor.
TILT = (
    Step("rate:LaggedAngle", (), "one integrator with lag and delay"),
    Step("rate:BasicAngle", (), "two integrators with rotor lag and delay, (2.6)"),
    Step("rate:DampedAngle", (), "rate damping, one more pole"),
    Step("tilt:Tilt", ("T_rotor", "T_delay"), "velocity feedback with a known drag, (4.25)"),
    Step(
        "tilt:Tilt",
        ("T_rotor", "T_delay", "a5"),
        "velocity feedback, (2.12) with rotor lag and delay",
    ),
)
TILT_RATE = (
    Step("rate:LaggedRate", (), "lag and delay"),
    Step("rate:BasicRate", (), "integrator with rotor lag and delay, (2.5)"),
    Step("rate:DampedRotation", (), "rate damping, one more pole"),
    Step("tilt:TiltRate", ("T_rotor", "T_delay"), "velocity feedback with a known drag, (4.25)"),
    Step(
        "tilt:TiltRate",
        ("T_rotor", "T_delay", "a5"),
        "velocity feedback, (2.12) with rotor lag and delay",
    ),
)
YAW = (
    Step("rate:LaggedAngle", (), "one integrator with lag and delay"),
    Step("yaw:YawAngle", ("T_delay",), "one additional state, (4.37)"),
)
YAW_RATE = (
    Step("rate:YawRateLag", (), "lag and delay, (2.8)"),
    Step("rate:YawRateLead", (), "lead and rotor lag, (2.10)"),
    Step("yaw:YawRate", ("T_delay",), "one additional state, (4.34)"),
)

LADDERS = {
    **dict.fromkeys(("phi", "theta"), TILT),
    **dict.fromkeys(("p", "q"), TILT_RATE),
    "psi": YAW,
    "r": YAW_RATE,
}


def ladder_for(output: str) -> Sequence[Step]:
    """Return the included structures for an output, the simplest first.

    Raises
    ------
    ValueError
        If there are none for this name.
    """
    if output not in LADDERS:
        raise ValueError(
            f"no structures are known for the output {output!r}: name it as one of {', '.join(LADDERS)}, such as "
            f"output={next(iter(LADDERS))}=SIGNAL."
        )
    return LADDERS[output]
