"""Are the harmonics of a sine test enough for the noise? What more of them would do to the estimate.

Too few harmonics shift the response of a nonlinear model, and the parameters with it, without a trace in the residuals.
The shift follows to first order from the change of the response at the estimate, in units of the standard errors; what
is far below them does not matter.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.part import Information
from greybox.data.text_table import counted
from greybox.estimate.covariance import Accuracy
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.problem import Problem
from greybox.modeling.harmonic_balance import harmonic_response

Array = NDArray[np.float64]
SMALL = 0.1  # of a standard error: a shift that does not matter
MOST = 50  # harmonics of a sine


def harmonic_warnings(nlp: Nlp, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Say so where more harmonics would change the estimate `x` (p,) noticeably."""
    if accuracy.white is None or all(part.problem.amplitude is None for part in nlp.response_parts):
        return
    error = np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(nlp.free)], 0.0))
    values = dict(zip(nlp.names, nlp.all_values(x).tolist(), strict=True))
    everything = nlp.all_values(x)
    for part in nlp.response_parts:
        problem, sine = part.problem, part.problem.amplitude
        if sine is None or sine.harmonics >= MOST:
            continue
        more = min(2 * sine.harmonics + 3, MOST)
        try:
            few, many = (_response(problem, values, harmonics) for harmonics in (sine.harmonics, more))
        except ValueError:  # no periodic motion is found with as many: nothing can be said
            continue
        told = part.information(nlp.names, everything, (), None, nlp.scaling.slope(x))
        shift = np.abs(_shift(told, few, many, accuracy.white)) / np.where(error > 0, error, np.inf)
        largest = int(np.argmax(np.nan_to_num(shift)))
        if shift[largest] > SMALL:
            moved = 100 * float(np.abs(many / few - 1).max())
            count = counted(sine.harmonics, "harmonic is", "harmonics are")
            yield (
                f"{count} too few for {problem.name!r}: with {more} the response changes by up to {moved:.2g} % and "
                f"{nlp.free[largest]} by {shift[largest]:.2g} standard errors; use "
                f"Sine({sine.signal!r}, ..., harmonics={more})."
            )


def _response(part: Problem, values: dict[str, float], harmonics: int) -> NDArray[np.complex128]:
    data = part.response
    return harmonic_response(
        part.model,
        dict(part.local_values(values)),
        data.omega,
        amplitude=replace(part.amplitude, harmonics=harmonics),
        input=data.input,
        output=data.output,
        at=part.at,
        delay=part.delay,
    ).response


def _shift(told: Information, few: NDArray[np.complex128], many: NDArray[np.complex128], inverse: Array) -> Array:
    """Return the Newton step (p,) of the unknowns to first order in the change of the response."""
    criterion = told.part.problem.criterion
    assert isinstance(criterion, Criterion)
    residuals = criterion.jacobian(few, (many - few)[:, None], told.part.problem.response)[:, 0]
    scale, _ = told.spread(1.0)
    return -inverse @ (told.part.weight * scale * told.jacobian[:, : len(inverse)].T @ residuals)
