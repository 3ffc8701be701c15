"""One iteration of Newton's method within a trust region, as two CasADi functions.

An iteration takes some hundred array operations. For a few searches each operation takes a
microsecond, ten times as long as its arithmetic. As two CasADi functions they are evaluated for all
searches by two calls, see `greybox.engine.compiled.vectorized`.

The state of a search of p variables is a column of numbers: first the scalars at the rows named
here, then the vectors of `Vectors`.
"""

from itertools import pairwise, starmap
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.engine.solve.barrier_levels import LAST

COST = 0  # infinite where the cost or a derivative is not finite

RADIUS = 1

LEVEL = 2

SWITCHED = 3  # whether the trial is the same point at the next level

IS_NEWTON = 4  # whether the trial minimizes the model; otherwise `bounded` finds one

END = 5  # 1 at a minimum, -1 where the search can make no progress, else 0

ITERATIONS = 6

# Curvatures below this share of the largest one are rounding errors.
FLATTEST = 1e-12

# Share of the tolerance, as a change of the cost relative to itself, that rounding hides: with the
# usual tolerance 1e-14.
INVISIBLE = 1e-6

# A step may be this much longer than the radius: the multiplier need not be exact.
CLOSE_TO_RADIUS = 1.05

TINY = float(np.finfo(float).tiny)

LARGEST = float(np.finfo(float).max)


class Vectors(NamedTuple):
    """The rows of the vectors of a search, after its scalars; `size` is the number of all rows.

    The `trial` is evaluated next; `gradient` (p,) and `hessian` (p * p,) are those at `z`.
    """

    z: slice
    trial: slice
    gradient: slice
    hessian: slice
    lower: slice
    upper: slice
    size: int


def layout(p: int) -> Vectors:
    """Return the rows of a search of p variables."""
    ends = np.cumsum([ITERATIONS + 1, p, p, p, p * p, p, p]).tolist()
    return Vectors(*starmap(slice, pairwise(ends)), size=ends[-1])


def advanced(p: int, loose: float) -> ca.Function:  # noqa: PLR0915  (one iteration, in its order)
    """Return the function that judges a trial, and finds the next one by Newton's step.

    Its arguments are (numbers, barrier, tolerance, cost, gradient, Hessian), its result the next
    numbers.

    The cost and its derivatives are those of the trial, without the barrier. Below the last level
    a projected gradient of at most `loose` switches to the next level. The second output is the
    Hessian (p * p,) of the variables that no bound holds, with the identity for the others:
    `bounded` takes its eigenvalues.
    """
    rows = layout(p)
    numbers = ca.SX.sym("numbers", rows.size)
    inputs = [numbers, *(ca.SX.sym("v", size) for size in (1, 1, 1, p, p * p))]
    _, barrier, tolerance, trial_cost, slopes, curvatures = inputs
    lower, upper = numbers[rows.lower], numbers[rows.upper]
    z, trial, gradient = numbers[rows.z], numbers[rows.trial], numbers[rows.gradient]
    hessian = ca.reshape(numbers[rows.hessian], p, p)
    new_hessian = ca.reshape(curvatures, p, p)
    old, radius, switched = numbers[COST], numbers[RADIUS], numbers[SWITCHED]
    level = numbers[LEVEL] + switched

    # The barrier of both bounds.
    new, new_gradient = trial_cost, slopes
    for to_bound, is_bounded, sign in (
        (trial - lower, lower > -LARGEST, 1.0),
        (upper - trial, upper < LARGEST, -1.0),
    ):
        factor = barrier * is_bounded
        # Without a bound the distance does not count, but must be finite.
        distance = ca.fmin(ca.fmax(to_bound, TINY), LARGEST)
        share = factor / distance
        new -= ca.sum1(factor * ca.log(distance))
        new_gradient -= sign * share
        new_hessian += ca.diag(share / distance)

    # Whether the trial is accepted: a decrease of at least a share of what the gradient promises
    # (Armijo), or a change too small to be seen in the cost.
    step = trial - z
    promised = -ca.dot(gradient, step)
    modeled = promised - 0.5 * ca.dot(step, hessian @ step)
    # A sum is finite if all of its terms are, except for an overflow, which is refused as well.
    finite = ca.fabs(new + ca.sum1(new_gradient) + ca.sum1(ca.vec(new_hessian))) <= LARGEST
    new = ca.if_else(finite, new, ca.inf)
    decrease = old - new
    invisible = ca.logic_and(finite, ca.fabs(promised) <= 1e-12 * ca.fabs(old))
    falls = ca.logic_and(promised > 0, decrease >= 1e-4 * promised)
    accepted = ca.logic_or(invisible, falls)
    next_radius = _next_radius(radius, ca.norm_2(step), promised, modeled, decrease, accepted)
    # The first evaluation at another level is not a step.
    radius = ca.if_else(switched, radius, next_radius)
    accepted = ca.logic_or(accepted, switched)
    z = ca.if_else(accepted, trial, z)
    cost = ca.if_else(accepted, new, old)
    gradient = ca.if_else(accepted, new_gradient, gradient)
    triangle = ca.Sparsity.upper(p)
    hessian = ca.if_else(accepted, ca.project(new_hessian, triangle), ca.project(hessian, triangle))
    hessian = ca.triu2symm(hessian)

    # Newton's step of the variables that no bound holds.
    free = _free(z, gradient, lower, upper)
    hessian_of_free = hessian * (free @ free.T) + ca.diag(1 - free)
    # The pivots are all positive for a definite Hessian.
    pivots, factor, order = ca.ldl(hessian_of_free, False)
    newton = -ca.ldl_solve(free * gradient, pivots, factor, order)  # zero where it is not free
    is_definite = ca.mmin(pivots) > FLATTEST * ca.mmax(pivots)

    # Whether the search ends, or goes to the next level.
    slope = ca.mmax(ca.fabs(z - ca.fmin(ca.fmax(z - gradient, lower), upper)))
    is_flat = slope <= tolerance * ca.fmax(ca.fabs(cost), 1.0)
    is_rounding = ca.logic_and(is_definite, _is_rounding(gradient, newton, cost, tolerance))
    is_minimum = ca.logic_and(level >= LAST, ca.logic_or(is_flat, is_rounding))
    # A radius below 1e-15 cannot change the cost by more than rounding.
    end = ca.if_else(is_minimum, 1.0, -(radius < 1e-15))
    switched = ca.logic_and(level < LAST, slope <= loose)

    # The next trial, if that step stays within the radius.
    within_radius = ca.sumsqr(newton) <= (CLOSE_TO_RADIUS * radius) ** 2
    is_newton = ca.logic_and(is_definite, within_radius)
    moved = _moved(z, newton, free, level < LAST, lower, upper)
    trial = ca.if_else(ca.logic_and(is_newton, ca.logic_not(switched)), moved, z)
    scalars = [
        cost,
        radius,
        level,
        switched,
        ca.logic_or(is_newton, switched),
        end,
        numbers[ITERATIONS] + 1,
    ]
    result = ca.vertcat(*scalars, z, trial, gradient, ca.vec(hessian), lower, upper)
    return ca.Function("advanced", inputs, [result, ca.densify(ca.vec(hessian_of_free))])


def bounded(p: int) -> ca.Function:
    """Return the function that minimizes the quadratic model within the radius.

    Its arguments are (numbers, eigenvalues, eigenvectors (p * p,)), its result is the trial (p,).
    The eigenvalues are made positive.
    """
    rows = layout(p)
    numbers = ca.SX.sym("numbers", rows.size)
    curvature, directions = ca.SX.sym("curvature", p), ca.SX.sym("directions", p * p)
    lower, upper = numbers[rows.lower], numbers[rows.upper]
    z, gradient, radius = numbers[rows.z], numbers[rows.gradient], numbers[RADIUS]
    free = _free(z, gradient, lower, upper)
    eigenvectors = ca.reshape(directions, p, p).T
    positive = ca.fabs(curvature)
    positive = ca.fmax(positive, FLATTEST * ca.fmax(ca.mmax(positive), TINY))
    along = _within(radius, eigenvectors.T @ (free * gradient), positive)
    trial = _moved(z, eigenvectors @ along, free, numbers[LEVEL] < LAST, lower, upper)
    return ca.Function("bounded", [numbers, curvature, directions], [trial])


def _is_rounding(gradient: ca.SX, newton: ca.SX, cost: ca.SX, tolerance: ca.SX) -> ca.SX:
    """Return whether the decrease predicted for Newton's step (p,) is below rounding.

    At a lightly damped mode with small errors, rounding makes the gradient exceed any tolerance.
    """
    promise = -0.5 * ca.dot(gradient, newton)
    return promise <= INVISIBLE * tolerance * ca.fabs(cost)


def _free(z: ca.SX, gradient: ca.SX, lower: ca.SX, upper: ca.SX) -> ca.SX:
    """Return 1 for the variables without an active bound, 0 for the others."""
    at_lower = ca.logic_and(z <= lower, gradient > 0)
    at_upper = ca.logic_and(z >= upper, gradient < 0)
    return ca.logic_not(ca.logic_or(at_lower, at_upper))


def _moved(
    z: ca.SX, step: ca.SX, free: ca.SX, has_barrier: ca.SX, lower: ca.SX, upper: ca.SX
) -> ca.SX:
    """Return the point to which a step of the free variables leads, cut at the bounds."""
    # With a barrier a step takes 99 % of the distance to a bound at most, as in IPOPT.
    share = ca.if_else(has_barrier, 0.99, 1.0)
    lowest, highest = z - share * (z - lower), z + share * (upper - z)
    return ca.fmin(ca.fmax(z + free * step, lowest), highest)


def _within(radius: ca.SX, gradient: ca.SX, curvature: ca.SX) -> ca.SX:
    """Return the step (p,) along eigenvectors that minimizes the model within the radius."""
    multiplier = ca.SX(0)
    # Newton's method for the multiplier of the radius: three or four steps reach a twentieth of it.
    for _ in range(8):
        step = gradient / (curvature + multiplier)
        length = ca.norm_2(step)
        slope = ca.sum1(step**2 / (curvature + multiplier)) / length
        correction = (length / radius - 1) * length / slope
        multiplier += ca.if_else(length > CLOSE_TO_RADIUS * radius, correction, 0.0)
    return -gradient / (curvature + multiplier)


def _next_radius(
    radius: ca.SX, length: ca.SX, promised: ca.SX, modeled: ca.SX, decrease: ca.SX, accepted: Any
) -> ca.SX:
    """Return the radius of the next trust region."""
    # After a refused step: the minimum of the parabola through both costs with the slope at the
    # first, between a tenth and half of the step.
    fall = ca.fmax(promised - decrease, TINY)
    shorter = ca.fmin(ca.fmax(0.5 * promised / fall, 0.1), 0.5) * length

    # After an accepted step: by the ratio of the real to the modeled decrease.
    ratio = ca.if_else(modeled > 0, decrease / modeled, 0.0)
    wider = ca.fmin(ca.fmax(3.0 * length, radius), 10.0)
    longest = ca.if_else(ratio > 0.5, wider, ca.if_else(ratio < 0.1, 0.5 * length, radius))
    return ca.if_else(accepted, longest, shorter)
