"""The line search: a step is shortened until the merit does not grow."""

from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.homotopy import Progress
from greybox.solve.gauss_newton.iterate import Iterate, Step
from greybox.solve.gauss_newton.merit import Merit


def line_search(
    parts: AllParts,
    iterate: Iterate,
    step: Step,
    merit: Merit,
    before: float,
    progress: Progress,
) -> tuple[Iterate | None, float]:
    """Return the new iterate and the share of the step that was taken; None and zero where no share will do.

    Where continuity is exact, a trial that fails is tried once more with its gaps closed.
    """
    settings = parts.settings
    enough = before + settings.cost_rounding * max(1.0, abs(before))
    length = 1.0
    while length > settings.shortest_step:
        trial = parts.moved(iterate, step, length)
        if merit(trial) <= enough:
            return trial, length
        if progress.is_exact and settings.second_order_correction:
            trial = parts.close_gaps(trial, step, progress.multipliers, length)
            if merit(trial) <= enough:
                return trial, length
        length *= settings.step_reduction
    return None, 0.0
