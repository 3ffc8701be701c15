"""Whether the harmonics of a sine test are enough for the noise, and whether the sine has one motion.

Too few harmonics shift the response of a nonlinear model, and the parameters with it, without a
trace in the residuals. The shift of the parameters follows to first order from the change of the
response at the estimate; a shift far below the standard errors does not matter.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Information
from greybox.estimate.covariance import Accuracy
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.formulation.frequency_criteria import Criterion
from greybox.formulation.problem import Problem
from greybox.modeling.harmonic_balance import ENOUGH, directly_found
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.periodic_motions import periodic_motions
from greybox.modeling.sine import MOST_HARMONICS


@dataclass(frozen=True, eq=False)
class TooFew:
    """What more harmonics change: the response, at most, in %, and a parameter, in standard errors."""

    problem: Problem
    harmonics: int
    change: float
    parameter: str
    shift: float


def harmonic_warnings(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Warn if more harmonics would change the estimate `x` (p,) noticeably, or if a sine has several motions."""
    for few in too_few_harmonics(nlp, x, accuracy):
        sine = few.problem.amplitude
        assert sine.harmonics is not None
        yield (
            f"{counted(sine.harmonics, 'harmonic is', 'harmonics are')} too few for {few.problem.name!r}: with "
            f"{few.harmonics} the response changes by up to {few.change:.2g} % and {few.parameter} by {few.shift:.2g} "
            f"standard errors; use Sine({sine.signal!r}, ..., harmonics={few.harmonics})."
        )

    values = dict(zip(nlp.names, nlp.all_values(x).tolist(), strict=True))
    for part in nlp.parts:
        if part.problem.amplitude is not None:
            yield from _several_motions(part.problem, values)


def too_few_harmonics(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[TooFew]:
    """Yield the parts in which more harmonics would change the estimate `x` (p,) noticeably."""
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
            parameter = nlp.free[largest]
            yield TooFew(part.problem, harmonics, 100 * change, parameter, float(shift[largest]))


def _several_motions(problem: Problem, values: dict[str, float]) -> Iterator[str]:
    """Look for several motions at the four frequencies at which the response differs most from the linear one."""
    omega = problem.response.omega
    local = dict(problem.local_values(values))
    options = {**_signals(problem), "delay": problem.delay}
    nonlinear = _response(problem, values, problem.amplitude.harmonics)
    try:
        linear = frequency_response(problem.model, local, omega, **options).response
    except ValueError:
        linear = np.zeros(omega.size)
    with np.errstate(all="ignore"):
        difference = np.nan_to_num(np.abs(nonlinear - linear) / np.abs(nonlinear), nan=np.inf)

    # A search takes as long as a hundred evaluations.
    places = np.sort(np.argsort(-difference, kind="stable")[:4])
    places = places[difference[places] > ENOUGH]
    if places.size:
        sine = problem.amplitude.between(omega, omega[places])
        yield from periodic_motions(problem.model, local, omega[places], sine, **options)[1][:1]


def _signals(problem: Problem) -> dict[str, Any]:
    data = problem.response
    return {"input": data.input, "output": data.output, "at": problem.at}


def _response(problem: Problem, values: dict[str, float], harmonics: int | None) -> ComplexArray:
    response, _ = directly_found(
        problem.model,
        dict(problem.local_values(values)),
        problem.response.omega,
        replace(problem.amplitude, harmonics=harmonics),
        **_signals(problem),
        pade=delay_order(problem.delay),
    )
    return response


def _shift(
    information: Information, few: ComplexArray, many: ComplexArray, inverse: Array
) -> Array:
    """Return the Newton step (p,) of the parameters, to first order in the change of the response."""
    problem = information.part.problem
    criterion = problem.criterion
    assert isinstance(criterion, Criterion)
    residuals = criterion.jacobian(few, (many - few)[:, None], problem.response)[:, 0]
    scale, _ = information.spread(1.0)
    gradient = information.jacobian[:, : len(inverse)].T @ residuals
    return -inverse @ (information.part.weight * scale * gradient)
