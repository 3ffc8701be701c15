"""Whether the integration is accurate enough for the noise."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.compiled.transcription.method import Transcription
from greybox.modeling.step_size import MOST_SUBSTEPS
from greybox.solve.discretization_error import DiscretizationError, discretization_error


def discretization_warnings(
    nlp: CompiledProblem,
    trajectories: Sequence[Trajectory],
    error: DiscretizationError | None = None,
) -> Iterator[str]:
    """Warn where twice the number of steps would move the estimate noticeably."""
    count = max(part.substeps for part in nlp.parts)
    if not count:
        return
    error = error or discretization_error(nlp, trajectories)
    if not error.matters:
        return
    name = nlp.free[int(np.argmax(np.abs(error.shift)))]
    size = "without limit, since the model diverges"
    if math.isfinite(error.largest):
        size = f"by {error.largest:.2g} standard errors"
    yield (
        f"the integration is too coarse: twice the steps per sample ({2 * count} instead of {count}) would change "
        f"{name} or its standard error {size}; {_cure(nlp.method, count, error.growth)}."
    )


def _cure(method: Transcription, count: int, growth: int) -> str:
    """Name a finer method; many more explicit steps come last, since they are slow."""
    finer = method.finer(growth * count)
    scheme = type(method.scheme).__name__
    if scheme == "Rosenbrock":
        return f"use {finer}, or RungeKutta() in its place if the model is not stiff"
    if scheme == "RungeKutta" and count >= MOST_SUBSTEPS:
        return (
            "if the model is stiff, with time constants far below a sample, use "
            f"method={type(method).__name__}(integrator=Rosenbrock()), otherwise {finer}"
        )
    if scheme == "RungeKutta":
        return f"use {finer}, or Rosenbrock() in its place if the model is stiff"
    return f"use {finer}"
