"""Whether the integration is accurate enough for the noise.

Whether the Padé approximation of a delay is accurate enough over the fitted band.
"""

import math
from collections.abc import Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import Accuracy
from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.result import Fit
from greybox.files.arrays import Values
from greybox.files.text_table import Sentences
from greybox.formulation.problem import Problem
from greybox.modeling.linear_response import frequency_response
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import dynamics
from greybox.solve.discretization_error import DiscretizationError, discretization_error
from greybox.statistics.metrics import rms


def discretization_warnings(
    accuracy: Accuracy,
    error: DiscretizationError | None = None,
) -> Sentences:
    """Warn where twice the number of steps would move the estimate noticeably."""
    nlp = accuracy.nlp
    count = nlp.substeps
    if not count:
        return

    error = error or discretization_error(nlp, accuracy.trajectories)
    if not error.matters:
        return

    # The parameter that moves most, in standard errors: one name is enough to act.
    name = nlp.free[np.argmax(np.abs(error.shift))]
    size = "without limit, since the model diverges"
    if math.isfinite(error.largest):
        size = f"by {error.largest:.2g} standard errors"

    yield (
        f"the integration is too coarse: twice the steps per sample ({2 * count} instead of "
        f"{count}) would change {name} or its standard error {size}; "
        f"use {nlp.method.finer(error.growth * count)}{nlp.method.other_cure}."
    )


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


def coarse_pade(responses: Sequence[FittedResponse]) -> Sentences:
    """Warn of a phase error beyond one degree, the effect of noise of 1.7 % in each component."""
    for part in responses:
        if part.pade_error is not None and part.pade_error > 1.0:
            yield (
                f"the phase error of {part.delay} reaches {part.pade_error:.2g}° in the band of "
                f"{part.name!r}: use a higher order or delay='exact'."
            )


def delays_within_a_sample(nlp: CompiledProblem, answer: Fit) -> Sentences:
    """Name held responses of outputs that a delayed input reaches at once.

    Along this path, all delays between two samples lead to the same samples: the model has the
    delay in the middle, which is off by up to half a sample.
    """
    for k, (problem, part) in enumerate(zip(nlp.problem.parts, answer.parts, strict=True)):
        if not isinstance(part, FittedResponse):
            continue
        hold = problem.sampled_hold
        if not hold or not dynamics(problem.model).delayed:
            continue
        # Far above the sampling rate, this path is left, and a hundredth of any other one at most.
        path = answer.response([1e3 / hold], k).response
        shift = path * part.data.omega * hold / 2
        if np.linalg.norm(shift / part.response) > max(rms(part.relative_residuals), 0.01):
            yield (
                f"the delayed input of {part.name!r} reaches its output at once. Along this "
                "path, all delays between two samples lead to the same samples: the delay is known "
                "only to half a sample, and other parameters may be biased, which the standard "
                "errors do not show. Fit the record itself."
            )
