"""Whether the integration is accurate enough for the noise."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
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

    # The parameter that moves most, in standard errors: one name is enough to act.
    name = nlp.free[int(np.argmax(np.abs(error.shift)))]
    size = "without limit, since the model diverges"
    if math.isfinite(error.largest):
        size = f"by {error.largest:.2g} standard errors"

    yield (
        f"the integration is too coarse: twice the steps per sample ({2 * count} instead of "
        f"{count}) would change {name} or its standard error {size}; "
        f"use {nlp.method.finer(error.growth * count)}{nlp.method.cure_if_stiff}."
    )
