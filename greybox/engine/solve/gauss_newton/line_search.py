"""The line search: a step is shortened until the merit function does not grow.

As long as gaps are a penalty, the merit is the sum of weighted squares, with the residual
covariance held. Where continuity is exact, it is the cost and an l1 penalty of the gaps (Nocedal
and Wright, Numerical Optimization, 2nd ed., section 18.3).
"""

import math
from collections.abc import Callable, Sequence

from greybox.data.files.arrays import Array
from greybox.engine.solve.gauss_newton.all_parts import AllParts, with_rounding
from greybox.engine.solve.gauss_newton.iterate import Iterate, Progress, Step
from greybox.engine.solve.gauss_newton.stability import are_stable

Merit = Callable[[Iterate], float]


def merit_function(parts: AllParts, residual_weights: Sequence[Array], progress: Progress) -> Merit:
    """Return the merit function, infinite where a part diverges or a predictor is unstable."""

    def merit(iterate: Iterate) -> float:
        if not iterate.finite:
            return math.inf
        violation = progress.constraint_penalty * parts.limits.violation(iterate.z)
        if not progress.is_exact:
            variances = progress.continuity_variance
            return parts.squared_cost(iterate, residual_weights, variances) + violation
        # An infinite merit shortens the steps that would make a predictor unstable.
        if not are_stable(parts, iterate, simulated=True):
            return math.inf
        return parts.cost(iterate) + parts.gap_cost(iterate, progress.multipliers) + violation

    return merit


REDUCTION = 0.4  # of the step from one trial to the next
SHORTEST_STEP = 1e-3  # share of a step below which the search gives up


def line_search(
    parts: AllParts, iterate: Iterate, step: Step, merit: Merit, start: float
) -> tuple[Iterate | None, float]:
    """Return the next iterate and the share of the step that was taken; None and 0 without one.

    `start` is the merit of the iterate. Where continuity is exact, a trial that fails is tried once
    more with its gaps closed.
    """
    limit = with_rounding(start)
    length = 1.0
    while length > SHORTEST_STEP:
        trial = parts.moved(iterate, step, length)
        if merit(trial) <= limit:
            return trial, length

        # Curvature opens gaps, which the merit counts although the outputs are better (Maratos
        # effect). Tanks, stiff and guarded tanks lose 4 runs without this, the tanh chain is solved
        # without it.
        if step.multipliers:
            trial = parts.close_gaps(trial, step, length)
            if merit(trial) <= limit:
                return trial, length
        length *= REDUCTION
    return None, 0.0
