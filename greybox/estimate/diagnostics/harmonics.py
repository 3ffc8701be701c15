"""Whether the harmonics of a sine test are enough for the noise.

Too few harmonics shift the response of a nonlinear model, and the parameters with it, without a
trace in the residuals. The shift of the parameters follows to first order from the change of the
response at the estimate; a shift far below the standard errors does not matter.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Information
from greybox.estimate.covariance import Accuracy
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.problem import Problem
from greybox.modeling.harmonic_balance import directly_found
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.sine import MOST_HARMONICS


def harmonic_warnings(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Warn if more harmonics would change the estimate `x` (p,) noticeably."""
    if accuracy.white is None:
        return
    variance = np.diag(accuracy.covariance)[: len(nlp.free)]
    standard_error = np.where(variance > 0, np.sqrt(np.maximum(variance, 0.0)), np.inf)
    all_values = nlp.all_values(x)
    values = dict(zip(nlp.names, all_values.tolist(), strict=True))

    for part in nlp.parts:
        sine = part.problem.amplitude
        if sine is None or sine.harmonics is None or sine.harmonics >= MOST_HARMONICS:
            continue
        harmonics = min(2 * sine.harmonics + 3, MOST_HARMONICS)
        few = _response(part.problem, values, sine.harmonics)
        many = _response(part.problem, values, harmonics)
        change = float(np.abs(many / few - 1).max())
        # NaN: no motion was found. A change of 1e-7 is rounding.
        if not np.isfinite(change) or change < 1e-7:
            continue

        information = part.information(nlp.names, all_values, (), None, nlp.scaling.slope(x))
        shift = np.abs(_shift(information, few, many, accuracy.white)) / standard_error
        largest = int(np.argmax(np.nan_to_num(shift)))
        # A tenth of a standard error adds 0.5 % to the root mean square error.
        if shift[largest] > 0.1:
            count = counted(sine.harmonics, "harmonic is", "harmonics are")
            yield (
                f"{count} too few for {part.problem.name!r}: with {harmonics} the response changes "
                f"by up to {100 * change:.2g} % and {nlp.free[largest]} by {shift[largest]:.2g} "
                f"standard errors; use Sine({sine.signal!r}, ..., harmonics={harmonics})."
            )


def _response(problem: Problem, values: dict[str, float], harmonics: int | None) -> ComplexArray:
    data = problem.response
    response, _ = directly_found(
        problem.model,
        dict(problem.local_values(values)),
        data.omega,
        replace(problem.amplitude, harmonics=harmonics),
        input=data.input,
        output=data.output,
        at=problem.at,
        pade=delay_order(problem.delay),
    )

    return response


def _shift(
    information: Information, few: ComplexArray, many: ComplexArray, inverse: Array
) -> Array:
    """Return the Newton step (p,), to first order in the change of the response."""
    problem = information.part.problem
    criterion = problem.criterion
    assert isinstance(criterion, Criterion)
    residuals = criterion.jacobian(few, (many - few)[:, None], problem.response)[:, 0]
    scale, _ = information.spread(1.0)
    gradient = information.jacobian[:, : len(inverse)].T @ residuals
    return -inverse @ (information.part.weight * scale * gradient)
