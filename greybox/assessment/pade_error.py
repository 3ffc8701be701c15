"""How far a Padé approximation of a delay is from the delay."""

import numpy as np

from greybox.data.files.named_values import Values
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.pade_delay import delay_order


def pade_error(part: Problem, values: Values) -> float | None:
    """Return the largest phase error of a Padé delay in the fitted band, degrees; else None."""
    if delay_order(part.delay) is None:
        return None
    data = part.response
    # Measured frequencies may be far apart, and a resonance between them turns the phase.
    omega = np.union1d(np.geomspace(data.omega.min(), data.omega.max(), 200), data.omega)
    signals = {"input": data.input, "output": data.output, "at": part.at}
    exact = frequency_response(part.model, values, omega, **signals)
    approximate = frequency_response(part.model, values, omega, **signals, delay=part.delay)
    return float(np.degrees(np.abs(np.angle(approximate.response * exact.response.conj()))).max())
