"""The best minimum, polished by undamped steps beyond the tolerance of a run."""

import math
from dataclasses import replace

from greybox.solve.gauss_newton.all_parts import COST_ROUNDING, AllParts
from greybox.solve.gauss_newton.homotopy import EXACT, Progress
from greybox.solve.gauss_newton.iterate import Iterate, Step
from greybox.solve.gauss_newton.iteration import descend
from greybox.solve.gauss_newton.normal_equations import gauss_newton_step
from greybox.solve.gauss_newton.stability import are_stable

# Steps that polish a minimum, at most: those of a model that hardly explains the data shrink by a
# third only.
MOST_STEPS = 50

# Decrease and half squared length of an undamped step above which damped steps come first: it is
# in a narrow curved valley.
LONG_STEP = 1e-7


def polished(parts: AllParts, start: Iterate) -> Iterate:
    """Return where undamped steps lead, as long as they grow shorter.

    Their length in standard errors judges them: the cost no longer shows them.
    """
    end, remaining = _undamped(parts, start)
    if remaining > LONG_STEP:
        progress = replace(EXACT, undamped_decrease=LONG_STEP)
        damped = descend(parts, end, progress, MOST_STEPS, restarts=False)
        end, _ = _undamped(parts, damped.iterate)
    return end


def exact_step(parts: AllParts, iterate: Iterate, progress: Progress) -> Step:
    """Return the step where continuity is exact."""
    weights = parts.residual_weights(iterate)
    return gauss_newton_step(parts, iterate, parts.linearize(iterate, weights), progress)


def _undamped(parts: AllParts, iterate: Iterate) -> tuple[Iterate, float]:
    """Return the end of undamped steps, and the decrease and half squared length of the next one."""
    progress = EXACT
    cost = parts.cost(iterate)
    highest = cost + COST_ROUNDING * max(1.0, abs(cost))
    end, shortest = iterate, math.inf
    for _ in range(MOST_STEPS):
        step = exact_step(parts, iterate, progress)
        progress = progress.with_penalties(step)
        remaining = abs(step.decrease) + step.distance
        if not remaining < shortest:
            break
        end, shortest = iterate, remaining
        if remaining < 1e-18:  # changes none of the first nine digits of a parameter
            break

        iterate = parts.made_continuous(parts.moved(iterate, step, 1.0), step)
        if not iterate.finite or parts.cost(iterate) > highest:
            break
        if not parts.is_continuous(iterate) or not are_stable(parts, iterate):
            break
    return end, shortest
