"""Families of structures that describe a kind of vehicle, by the name of the output.

Nothing is fixed: neither lags nor delays, nor the sign and the size of a gain.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from greybox.data.frequency_response import FrequencyResponse
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.model import Model, require_known
from greybox.modeling.model_reference import included_model

TILT = {
    "rate:LaggedAngle": "one integrator with lag and delay",
    "rate:BasicAngle": "two integrators with rotor lag and delay, (2.6)",
    "rate:DampedAngle": "rate damping, one more pole",
    "tilt:Tilt": "velocity feedback, (2.12) with rotor lag and delay",
}
TILT_RATE = {
    "rate:LaggedRate": "lag and delay",
    "rate:BasicRate": "integrator with rotor lag and delay, (2.5)",
    "rate:DampedRotation": "rate damping, one more pole",
    "tilt:TiltRate": "velocity feedback, (2.12) with rotor lag and delay",
}
YAW = {
    "rate:LaggedAngle": "one integrator with lag and delay",
    "yaw:YawAngle": "one additional state, (4.37)",
}
YAW_RATE = {
    "rate:YawRateLag": "lag and delay, (2.8)",
    "rate:YawRateLead": "lead and rotor lag, (2.10)",
    "yaw:YawRate": "one additional state, (4.34)",
}
ROLL_RATE = {
    "fixed_wing:RollMode": "roll mode",
    "fixed_wing:RollWithDutchRoll": "roll mode and dutch roll",
}
ROLL = {
    "fixed_wing:RollModeAngle": "roll mode, integrated",
    "fixed_wing:RollAngleWithDutchRoll": "roll mode and dutch roll, integrated",
}
PITCH_RATE = {
    "fixed_wing:ShortPeriod": "short period",
    "fixed_wing:ShortPeriodWithPhugoid": "short period and phugoid",
}
PITCH = {
    "fixed_wing:Phugoid": "phugoid",
    "fixed_wing:ShortPeriodAngle": "short period, integrated",
    "fixed_wing:PitchWithPhugoid": "short period and phugoid",
}

FAMILIES: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "multirotor": {
        "phi": TILT,
        "theta": TILT,
        "p": TILT_RATE,
        "q": TILT_RATE,
        "psi": YAW,
        "r": YAW_RATE,
    },
    "fixed-wing": {
        "p": ROLL_RATE,
        "phi": ROLL,
        "q": PITCH_RATE,
        "theta": PITCH,
        "alpha": {"fixed_wing:ShortPeriodAlpha": "short period"},
        "r": {"fixed_wing:DutchRoll": "dutch roll"},
    },
}


@dataclass(frozen=True)
class Structure:
    """A model to fit, its name on the command line, its description, and parameters to free."""

    model: Model
    name: str
    about: str = ""
    free: Sequence[str] = ()


def family(vehicle: str, output: str) -> list[Structure]:
    """Return the structures of a kind of vehicle for an output, the simplest first.

    Raises
    ------
    ValueError
        For an unknown vehicle, or an output for which it has no structures.
    """
    require_known([vehicle], FAMILIES, "family of structures", "greybox")
    outputs = FAMILIES[vehicle]
    if output not in outputs:
        raise ValueError(
            f"vehicle={vehicle!r} has no structures for the output {output!r}: name it as one of "
            f"{', '.join(outputs)}, such as output={next(iter(outputs))}=SIGNAL, or leave out the "
            "vehicle."
        )
    structures = []
    for name, about in outputs[output].items():
        file, _, kind = name.partition(":")
        included: Any = included_model(f"greybox.models.{file}", kind)
        model = included()
        held = [parameter for parameter, p in model.parameters.items() if p.fixed]
        structures.append(Structure(model, name, about, held))
    return structures


def gains(model: Model, response: FrequencyResponse) -> dict[str, dict[str, tuple[float, float]]]:
    """Return bounds and boxes of starts, of either sign, for parameters that scale the response.

    Their size is that with which the declared values come closest to the measured magnitude.
    """
    declared = {name: p.start for name, p in model.parameters.items()}
    at_declared = frequency_response(model, declared, response.omega).response
    bounds, starts = {}, {}
    for name, parameter in model.parameters.items():
        # A gain is a parameter in which the response is linear, whatever its name.
        twice = {**declared, name: 2 * parameter.start}
        doubled = frequency_response(model, twice, response.omega).response
        if not parameter.start or not np.allclose(doubled, 2 * at_declared, rtol=1e-9):
            continue
        ratio = float(np.median(np.abs(response.response) / np.abs(at_declared)))
        size = abs(parameter.start) * ratio
        # The declared values may be far off in shape: three decades, of which starts use a small
        # part.
        bounds[name] = (-1000 * size, 1000 * size)
        starts[name] = (-3 * size, 3 * size)
    return {"bounds": bounds, "starts": starts}
