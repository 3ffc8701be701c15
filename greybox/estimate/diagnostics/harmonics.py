"""Whether the harmonics of a sine test are enough for the noise.

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
from greybox.modeling.sine import MOST_HARMONICS

Array = NDArray[np.float64]

# Shift of a parameter, in standard errors, that does not matter: it adds 0.5 % to the root mean square error.
SMALL_SHIFT = 0.1


def harmonic_warnings(nlp: Nlp, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Say so where more harmonics would change the estimate `x` (p,) noticeably."""
    if accuracy.white is None:
        return
    standard_error = np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(nlp.free)], 0.0))
    everything = nlp.all_values(x)
    values = dict(zip(nlp.names, everything.tolist(), strict=True))

    for part in nlp.parts:
        problem = part.problem
        sine = problem.amplitude
        if sine is None or sine.harmonics >= MOST_HARMONICS:
            continue
        more = min(2 * sine.harmonics + 3, MOST_HARMONICS)
        try:
            few, many = (_response(problem, values, harmonics) for harmonics in (sine.harmonics, more))
        except ValueError:  # no periodic motion is found with as many: nothing can be said
            continue

        information = part.information(nlp.names, everything, (), None, nlp.scaling.slope(x))
        shift = np.abs(_shift(information, few, many, accuracy.white))
        shift /= np.where(standard_error > 0, standard_error, np.inf)
        largest = int(np.argmax(np.nan_to_num(shift)))
        if shift[largest] > SMALL_SHIFT:
            change = 100 * float(np.abs(many / few - 1).max())
            count = counted(sine.harmonics, "harmonic is", "harmonics are")
            yield (
                f"{count} too few for {problem.name!r}: with {more} the response changes by up to {change:.2g} % and "
                f"{nlp.free[largest]} by {shift[largest]:.2g} standard errors; use "
                f"Sine({sine.signal!r}, ..., harmonics={more})."
            )


def _response(problem: Problem, values: dict[str, float], harmonics: int) -> NDArray[np.complex128]:
    data = problem.response
    return harmonic_response(
        problem.model,
        dict(problem.local_values(values)),
        data.omega,
        amplitude=replace(problem.amplitude, harmonics=harmonics),
        input=data.input,
        output=data.output,
        at=problem.at,
        delay=problem.delay,
    ).response


def _shift(
    information: Information, few: NDArray[np.complex128], many: NDArray[np.complex128], inverse: Array
) -> Array:
    """Return the Newton step (p,) of the unknowns to first order in the change of the response."""
    problem = information.part.problem
    criterion = problem.criterion
    assert isinstance(criterion, Criterion)
    residuals = criterion.jacobian(few, (many - few)[:, None], problem.response)[:, 0]
    scale, _ = information.spread(1.0)
    gradient = information.jacobian[:, : len(inverse)].T @ residuals
    return -inverse @ (information.part.weight * scale * gradient)
