"""The merit function: what a step must not increase.

As long as gaps are a penalty it is the sum of weighted squares, with the residual covariance held.
Where continuity is exact it is the cost and an l1 penalty of the gaps (Nocedal and Wright,
Numerical Optimization, 2nd ed., section 18.3).
"""

import math
from collections.abc import Callable, Sequence

from greybox.files.arrays import Array
from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.homotopy import Progress
from greybox.solve.gauss_newton.iterate import Iterate
from greybox.solve.gauss_newton.stability import are_stable

Merit = Callable[[Iterate], float]


def merit_function(parts: AllParts, residual_weights: Sequence[Array], progress: Progress) -> Merit:
    """Return the merit of an iterate, infinite where it diverges or a simulated predictor is unstable."""

    def exact(iterate: Iterate) -> float:
        if not iterate.finite or not are_stable(parts, iterate, simulated=True):
            return math.inf
        violation = progress.constraint_penalty * parts.limits.violation(iterate.z)
        return parts.cost(iterate) + parts.gap_cost(iterate, progress.multipliers) + violation

    def penalized(iterate: Iterate) -> float:
        if not iterate.finite:
            return math.inf
        violation = progress.constraint_penalty * parts.limits.violation(iterate.z)
        squares = parts.squared_cost(iterate, residual_weights)
        return squares + parts.squared_gap_cost(iterate, progress.continuity_variance) + violation

    return exact if progress.is_exact else penalized
