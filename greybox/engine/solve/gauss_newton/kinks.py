"""Minima at kinks of the cost, where no side has a gradient of zero.

A guard, a dead zone or an end stop changes the derivatives at once. Steps that cross it are refused
from either side, whatever their damping, although the run has arrived. At a minimum zero is in the
generalized gradient: it is a convex combination of the gradients beside the point. Bundle methods
build it up from two at a time, the combination so far and the gradient where the last step failed.
Sources: Clarke (1983), Optimization and Nonsmooth Analysis; Kiwiel (1985), Methods of Descent for
Nondifferentiable Optimization, chapter 2.
"""

from collections.abc import Sequence
from functools import partial
from operator import attrgetter
from typing import Any

from greybox.engine.solve.gauss_newton.all_parts import AllParts
from greybox.engine.solve.gauss_newton.iterate import CONVERGED, EXACT, STALLED, Iterate
from greybox.engine.solve.gauss_newton.normal_equations import gauss_newton_step

AT_KINK = "converged at a kink"

# Shares of a step at which the other sides are looked for: a step over one kink may end on the
# near side of the next.
LENGTHS = (0.1, 0.01, 0.001) * 2

# Shares of the linearization beside the iterate. Slopes may differ by decades between two sides.
SHARES = (0, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98)

# Predicted decrease of the cost that is left at a minimum: half the square of a tenth of a standard
# error.
NEGLIGIBLE = 5e-3


def status_at_kink(parts: AllParts, iterate: Iterate, *, states_only: bool) -> str:
    """Return the status of a run where no step decreases the cost.

    It has converged if some combination of the linearizations beside it promises next to nothing.
    """
    step_by = partial(gauss_newton_step, parts, iterate, progress=EXACT, states_only=states_only)
    weights = parts.residual_weights(iterate)
    first = mean = parts.linearize(iterate, weights)
    step = step_by(mean)
    for length in LENGTHS:
        beside = parts.moved(iterate, step, length)
        if step.decrease > NEGLIGIBLE and beside.finite:
            other = parts.linearize(beside, weights)
            mixtures = [_mixed(mean, other, share) for share in SHARES]
            step = min(map(step_by, mixtures), key=attrgetter("decrease"))
            mean = step.linearizations
    if not step.decrease <= NEGLIGIBLE:
        return STALLED
    return CONVERGED if mean is first else AT_KINK


def _mixed(first: Sequence[Any], second: Sequence[Any], share: float) -> list[Any]:
    """Return linearizations of which the second ones have this share."""
    return [
        tuple.__new__(type(a), [(1 - share) * u + share * v for u, v in zip(a, b, strict=True)])
        for a, b in zip(first, second, strict=True)
    ]
