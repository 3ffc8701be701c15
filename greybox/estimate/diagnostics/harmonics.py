"""Whether the harmonics of a sine test are enough for the noise, and whether the sine has one motion.

Too few harmonics shift the response of a nonlinear model, and the parameters with it, without a
trace in the residuals. The shift follows to first order from the change of the response at the
estimate, in units of the standard errors; what is far below them does not matter.

Several motions under one sine have several responses, of which a fit evaluates one. They are sought
at the estimate, at the frequencies at which the response differs most from the linear one.
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

# Shift of a parameter, in standard errors, that does not matter: it adds 0.5 % to the root mean
# square error.
SMALL_SHIFT = 0.1
ROUNDING = 1e-7  # change of the response, relative, that no measurement shows


SEARCHED = 4  # frequencies at which other motions are sought: a search takes as long as a hundred evaluations


@dataclass(frozen=True, eq=False)
class TooFew:
    """What more harmonics change: the shift of a parameter, in standard errors, and the `response` (n,), in %."""

    problem: Problem
    more: int
    change: float
    parameter: str
    shift: float


def harmonic_warnings(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Say so where more harmonics would change the estimate `x` (p,) noticeably, or a sine has several motions."""
    for found in too_few_harmonics(nlp, x, accuracy):
        sine = found.problem.amplitude
        assert sine.harmonics is not None
        count = counted(sine.harmonics, "harmonic is", "harmonics are")
        yield (
            f"{count} too few for {found.problem.name!r}: with {found.more} the response changes by up to "
            f"{found.change:.2g} % and {found.parameter} by {found.shift:.2g} standard errors; use "
            f"Sine({sine.signal!r}, ..., harmonics={found.more})."
        )

    values = dict(zip(nlp.names, nlp.all_values(x).tolist(), strict=True))
    for part in nlp.parts:
        if part.problem.amplitude is not None:
            yield from _several_motions(part.problem, values)


def too_few_harmonics(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[TooFew]:
    """Find the parts in which more harmonics would change the estimate `x` (p,) noticeably."""
    if accuracy.white is None:
        return
    standard_error = np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(nlp.free)], 0.0))
    everything = nlp.all_values(x)
    values = dict(zip(nlp.names, everything.tolist(), strict=True))

    for part in nlp.parts:
        problem = part.problem
        sine = problem.amplitude
        if sine is None or sine.harmonics is None or sine.harmonics >= MOST_HARMONICS:
            continue
        more = min(2 * sine.harmonics + 3, MOST_HARMONICS)
        few, many = (_response(problem, values, harmonics) for harmonics in (sine.harmonics, more))
        change = float(np.abs(many / few - 1).max())
        if (
            not np.isfinite(change) or change < ROUNDING
        ):  # with NaN, no motion is found: nothing can be said
            continue

        information = part.information(nlp.names, everything, (), None, nlp.scaling.slope(x))
        shift = np.abs(_shift(information, few, many, accuracy.white))
        shift /= np.where(standard_error > 0, standard_error, np.inf)
        largest = int(np.argmax(np.nan_to_num(shift)))
        if shift[largest] > SMALL_SHIFT:
            yield TooFew(problem, more, 100 * change, nlp.free[largest], float(shift[largest]))


def _several_motions(problem: Problem, values: dict[str, float]) -> Iterator[str]:
    omega = problem.response.omega
    local = dict(problem.local_values(values))
    few = _response(problem, values, problem.amplitude.harmonics)
    try:
        linear = frequency_response(
            problem.model, local, omega, **_signals(problem), delay=problem.delay
        ).response
    except ValueError:
        linear = np.zeros(omega.size)
    with np.errstate(all="ignore"):
        nonlinear = np.nan_to_num(np.abs(few - linear) / np.abs(few), nan=np.inf)
    searched = np.sort(np.argsort(-nonlinear, kind="stable")[:SEARCHED])
    searched = searched[nonlinear[searched] > ENOUGH]
    if not searched.size:
        return
    sine = problem.amplitude.between(omega, omega[searched])
    _, messages = periodic_motions(
        problem.model, local, omega[searched], sine, **_signals(problem), delay=problem.delay
    )
    yield from messages[:1]


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
    information: Information,
    few: ComplexArray,
    many: ComplexArray,
    inverse: Array,
) -> Array:
    """Return the Newton step (p,) of the unknowns to first order in the change of the response."""
    problem = information.part.problem
    criterion = problem.criterion
    assert isinstance(criterion, Criterion)
    residuals = criterion.jacobian(few, (many - few)[:, None], problem.response)[:, 0]
    scale, _ = information.spread(1.0)
    gradient = information.jacobian[:, : len(inverse)].T @ residuals
    return -inverse @ (information.part.weight * scale * gradient)
