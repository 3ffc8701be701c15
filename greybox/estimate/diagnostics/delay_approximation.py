"""Whether the Padé approximation of a delay is close enough over the fitted band."""

from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.formulation.problem import Problem
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.pade_delay import delay_order

# Degrees of phase over the fitted band: as much as noise of 1.7 % in each component makes.
PHASE_LIMIT = 1.0

# Frequencies between the lowest and the highest of the data, at which the error is looked for
# besides these.
GRID = 200


def pade_error(part: Problem, values: dict[str, float]) -> float | None:
    """Return the largest phase error (degrees) of a Padé delay over the fitted band; None with exact delay."""
    if delay_order(part.delay) is None:
        return None
    data = part.response
    omega = np.union1d(np.geomspace(data.omega.min(), data.omega.max(), GRID), data.omega)
    signals = {"input": data.input, "output": data.output, "at": part.at}
    exact = frequency_response(part.model, values, omega, **signals)
    approximate = frequency_response(part.model, values, omega, **signals, delay=part.delay)
    return float(np.degrees(np.abs(np.angle(approximate.response * exact.response.conj()))).max())


def coarse_pade(nlp: CompiledProblem, errors: Sequence[float | None]) -> Iterator[str]:
    """Name the parts whose approximation is off by more than `PHASE_LIMIT`."""
    for part, error in zip(nlp.problem.parts, errors, strict=True):
        if error is not None and error > PHASE_LIMIT:
            yield (
                f"the phase of {part.delay} is off by up to {error:.2g}° over the band of {part.name!r}: "
                "use a higher order or delay='exact'."
            )
