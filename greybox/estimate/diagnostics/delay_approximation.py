"""Whether the Padé approximation of a delay is accurate enough over the fitted band."""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.estimate.fitted_part import FittedResponse
from greybox.files.arrays import Values
from greybox.formulation.problem import Problem
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


def coarse_pade(responses: Sequence[FittedResponse]) -> Iterator[str]:
    """Warn of a phase error beyond one degree, the effect of noise of 1.7 % in each component."""
    for part in responses:
        if part.pade_error is not None and part.pade_error > 1.0:
            yield (
                f"the phase error of {part.delay} reaches {part.pade_error:.2g}° in the band of "
                f"{part.name!r}: use a higher order or delay='exact'."
            )
