"""Whether the end of a run is a minimum, judged by numbers alone.

What a solver calls its end says little. IPOPT's "Search_Direction_Becomes_Too_Small" may be the
exact minimum of a light mode, whose gradient is rounded to more than any tolerance, and its limit
of iterations may be reached there. So every solver's end is judged by what a quadratic model of the
cost promises from it.
"""

import math

import numpy as np

from greybox.data.files.arrays import Array, all_finite
from greybox.engine.solve.constraints import Limits
from greybox.engine.solve.quadratic_program import solve_small_qp

ROUNDING = 1e-9  # relative change of the cost that counts as rounding


def rounding_of(cost: float) -> float:
    """Return the change of a cost that may be rounding alone."""
    return ROUNDING * max(1.0, abs(cost))


def is_above(cost: float, begun: float) -> bool:
    """Return whether a cost is not finite, or above that at a start by more than rounding."""
    return math.isfinite(begun) and not cost <= begun + rounding_of(begun)


def is_minimum(
    limits: Limits, z: Array, cost: float, gradient: Array, hessian: Array, tolerance: float
) -> bool:
    """Return whether a point z (p,) is a minimum within all limits, as far as rounding shows.

    The quadratic model promises no decrease that could be seen (Newton's decrement, which does not
    depend on scales): for every variable at most the `tolerance`, with which IPOPT's barrier holds
    variables off their bounds, or one that is rounding beside the cost.
    """
    if not (math.isfinite(cost) and all_finite(gradient, hessian)):
        return False
    # IPOPT widens bounds and constraints by 1e-8.
    if limits.violation(z, rounding=1e-7) > 0:
        return False
    promised = promised_decrease(limits, z, gradient, hessian)
    return promised <= max(len(z) * tolerance, ROUNDING * abs(cost))


def promised_decrease(limits: Limits, z: Array, gradient: Array, hessian: Array) -> float:
    """Return the largest decrease that a quadratic model promises from z (p,) within all limits.

    Negative curvature counts as positive, and steps are no longer than a start box.
    """
    values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
    curved = (vectors * np.abs(values)) @ vectors.T
    normals, least = limits.linearized(z)
    box = np.vstack([np.eye(len(z)), -np.eye(len(z))])
    normals, least = np.vstack([normals, box]), np.append(least, np.full(2 * len(z), -1.0))
    step = solve_small_qp(curved, gradient, normals, least)
    return float(-gradient @ step - 0.5 * step @ curved @ step)
