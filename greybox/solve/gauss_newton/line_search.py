"""The line search: a step is shortened until the merit function does not grow."""

from greybox.solve.gauss_newton.all_parts import COST_ROUNDING, AllParts
from greybox.solve.gauss_newton.iterate import Iterate, Step
from greybox.solve.gauss_newton.merit import Merit

REDUCTION = 0.4  # of the step from one trial to the next
SHORTEST_STEP = 1e-3  # share of a step below which the search gives up


def line_search(
    parts: AllParts, iterate: Iterate, step: Step, merit: Merit, start: float
) -> tuple[Iterate | None, float]:
    """Return the new iterate and the share of the step that was taken; None and 0 if no share will do.

    `start` is the merit of the iterate. Where continuity is exact, a trial that fails is tried once
    more with its gaps closed.
    """
    limit = start + COST_ROUNDING * max(1.0, abs(start))
    length = 1.0
    while length > SHORTEST_STEP:
        trial = parts.moved(iterate, step, length)
        if merit(trial) <= limit:
            return trial, length

        if step.multipliers and parts.settings.second_order_correction:
            trial = parts.close_gaps(trial, step, length)
            if merit(trial) <= limit:
                return trial, length
        length *= REDUCTION
    return None, 0.0
