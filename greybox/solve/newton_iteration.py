"""One iteration of Newton's method within a trust region, as CasADi functions of the numbers of one search.

Some hundred operations on arrays make an iteration, and for few searches each takes a microsecond,
ten times as long as what it computes. As two functions they are evaluated for all searches by two
calls, see `greybox.compiled.vectorized`.

The numbers of a search of p variables are a column: single ones at the rows that are named here,
then the vectors of `Vectors`.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

COST = 0  # infinite where it or a derivative is not finite
RADIUS, LEVEL = 1, 2
SWITCHED = 3  # whether the trial is the point again, at the next level
IS_NEWTON = 4  # whether the trial is where the model is least; where it is not, `bounded` finds one
END = 5  # 1 at a minimum, -1 where the search can go no further, else 0
ITERATIONS = 6
SINGLE = 7

# Of the distance to a bound, how much of it a step takes while there is a barrier: that of IPOPT.
TO_BOUND = 0.99

LARGEST_RADIUS = 10.0
LEAST_RADIUS = 1e-15  # beyond, rounding has the last word
FLATTEST = 1e-12  # of the largest eigenvalue: curvatures below are rounding errors

SUFFICIENT = 1e-4  # of the decrease that the gradient promises (Armijo)
ROUNDING = 1e-12  # of the cost: smaller promised decreases cannot be seen in it
GOOD, POOR = 0.5, 0.1  # ratios of the real to the modeled decrease at which the radius changes
WIDER = 3.0  # times the step after a good one
SHORTEST, LONGEST = (
    0.1,
    0.5,
)  # times the step after a failed one, between which interpolation decides
SECULAR_STEPS = (
    8  # of Newton's method for the multiplier of the radius; three or four reach a twentieth of it
)
CLOSE_TO_RADIUS = 1.05
TINY, LARGEST = float(np.finfo(float).tiny), float(np.finfo(float).max)


@dataclass(frozen=True)
class Vectors:
    """The rows of the point z, the trial that is evaluated next, gradient and Hessian (p * p,) at z, and the bounds."""

    p: int

    @property
    def z(self) -> slice:
        """(p,)."""
        return slice(SINGLE, SINGLE + self.p)

    @property
    def trial(self) -> slice:
        """(p,)."""
        return slice(SINGLE + self.p, SINGLE + 2 * self.p)

    @property
    def gradient(self) -> slice:
        """(p,)."""
        return slice(SINGLE + 2 * self.p, SINGLE + 3 * self.p)

    @property
    def hessian(self) -> slice:
        """(p * p,)."""
        return slice(SINGLE + 3 * self.p, self.size - 2 * self.p)

    @property
    def lower(self) -> slice:
        """(p,)."""
        return slice(self.size - 2 * self.p, self.size - self.p)

    @property
    def upper(self) -> slice:
        """(p,)."""
        return slice(self.size - self.p, self.size)

    @property
    def size(self) -> int:
        """How many numbers a search has."""
        return SINGLE + 5 * self.p + self.p**2


def advanced(p: int, last: int, loose: float) -> ca.Function:
    """Return (numbers, barrier, tolerance, cost, gradient, Hessian) -> the numbers after the trial was judged.

    The cost and its derivatives are those of the trial, without the barrier. Below the `last` level
    a slope of at most `loose` takes the next one. With them comes the Hessian (p * p,) for the
    variables that no bound holds, that of the others being the identity: `bounded` takes its
    eigenvalues.
    """
    rows, numbers = Vectors(p), ca.SX.sym("numbers", Vectors(p).size)
    inputs = [numbers, *(ca.SX.sym("v", size) for size in (1, 1, 1, p, p * p))]
    _, barrier, tolerance, found, slopes, curvatures = inputs
    lower, upper = numbers[rows.lower], numbers[rows.upper]
    z, trial, gradient = (numbers[at] for at in (rows.z, rows.trial, rows.gradient))
    hessian, new_hessian = ca.reshape(numbers[rows.hessian], p, p), ca.reshape(curvatures, p, p)
    old, radius, switched = numbers[COST], numbers[RADIUS], numbers[SWITCHED]
    level = numbers[LEVEL] + switched

    new, new_gradient = found, slopes
    for to_bound, is_bounded, sign in (
        (trial - lower, lower > -LARGEST, 1.0),
        (upper - trial, upper < LARGEST, -1.0),
    ):
        factor = barrier * is_bounded
        distance = ca.fmin(
            ca.fmax(to_bound, TINY), LARGEST
        )  # of no matter where there is no barrier
        share = factor / distance
        new -= ca.sum1(factor * ca.log(distance))
        new_gradient -= sign * share
        new_hessian += ca.diag(share / distance)

    step = trial - z
    promised = -ca.dot(gradient, step)
    modeled = promised - 0.5 * ca.dot(step, hessian @ step)
    # A sum is finite if all of it is, but for an overflow, which a step does not survive either.
    finite = ca.fabs(new + ca.sum1(new_gradient) + ca.sum1(ca.vec(new_hessian))) <= LARGEST
    new = _chosen(finite, new, ca.inf)
    decrease = old - new
    invisible = ca.logic_and(finite, ca.fabs(promised) <= ROUNDING * ca.fabs(old))
    falls = ca.logic_and(promised > 0, decrease >= SUFFICIENT * promised)
    accepted = ca.logic_or(invisible, falls)
    # What was taken over to another level is a beginning, not a step.
    radius = _chosen(
        switched,
        radius,
        _next_radius(radius, ca.norm_2(step), promised, modeled, decrease, accepted),
    )
    taken = ca.logic_or(accepted, switched)
    z, cost, gradient = (
        _chosen(taken, *pair) for pair in ((trial, z), (new, old), (new_gradient, gradient))
    )
    upper_triangle = ca.Sparsity.upper(p)
    hessian = ca.triu2symm(
        _chosen(taken, ca.project(new_hessian, upper_triangle), ca.project(hessian, upper_triangle))
    )

    slope = ca.mmax(ca.fabs(z - ca.fmin(ca.fmax(z - gradient, lower), upper)))
    is_minimum = ca.logic_and(level >= last, slope <= tolerance * ca.fmax(ca.fabs(cost), 1.0))
    end = _chosen(is_minimum, 1.0, -(radius < LEAST_RADIUS))
    switched = ca.logic_and(level < last, slope <= loose)
    free = _free(z, gradient, lower, upper)
    hessian_of_free = hessian * (free @ free.T) + ca.diag(1 - free)
    newton, pivots = _eliminated(hessian_of_free, free * gradient)
    is_newton = ca.logic_and(
        ca.mmin(pivots) > FLATTEST * ca.mmax(pivots), _is_within(newton, radius)
    )
    moved = _moved(z, newton, free, level < last, lower, upper)
    trial = _chosen(ca.logic_and(is_newton, ca.logic_not(switched)), moved, z)
    single = [
        cost,
        radius,
        level,
        switched,
        ca.logic_or(is_newton, switched),
        end,
        numbers[ITERATIONS] + 1,
    ]
    after = ca.vertcat(*single, z, trial, gradient, ca.vec(hessian), lower, upper)
    return ca.Function("advanced", inputs, [after, ca.densify(ca.vec(hessian_of_free))])


def bounded(p: int, last: int) -> ca.Function:
    """Return (numbers, eigenvalues, eigenvectors (p * p,)) -> the trial (p,) that is least within the radius.

    The eigenvalues are made positive.
    """
    rows, numbers = Vectors(p), ca.SX.sym("numbers", Vectors(p).size)
    curvature, directions = ca.SX.sym("curvature", p), ca.SX.sym("directions", p * p)
    lower, upper = numbers[rows.lower], numbers[rows.upper]
    z, gradient, radius = numbers[rows.z], numbers[rows.gradient], numbers[RADIUS]
    free, each = _free(z, gradient, lower, upper), ca.reshape(directions, p, p).T
    positive = ca.fabs(curvature)
    positive = ca.fmax(positive, FLATTEST * ca.fmax(ca.mmax(positive), TINY))
    along = _within(radius, each.T @ (free * gradient), positive)
    trial = _moved(z, each @ along, free, numbers[LEVEL] < last, lower, upper)
    return ca.Function("bounded", [numbers, curvature, directions], [trial])


def _chosen(condition: Any, one: Any, other: Any) -> Any:
    """Return one of two; the other may be no number."""
    return ca.if_else(condition, one, other)


def _is_within(step: ca.SX, radius: ca.SX) -> ca.SX:
    return ca.sumsqr(step) <= (CLOSE_TO_RADIUS * radius) ** 2


def _free(z: ca.SX, gradient: ca.SX, lower: ca.SX, upper: ca.SX) -> ca.SX:
    """Return 1 for the variables that no bound holds, 0 for the others."""
    below, above = ca.logic_and(z <= lower, gradient > 0), ca.logic_and(z >= upper, gradient < 0)
    return ca.logic_not(ca.logic_or(below, above))


def _moved(
    z: ca.SX, step: ca.SX, free: ca.SX, has_barrier: ca.SX, lower: ca.SX, upper: ca.SX
) -> ca.SX:
    """Return where a step of the free variables leads within the bounds."""
    share = _chosen(has_barrier, TO_BOUND, 1.0)
    lowest, highest = z - share * (z - lower), z + share * (upper - z)
    return ca.fmin(ca.fmax(z + free * step, lowest), highest)


def _eliminated(hessian: ca.SX, gradient: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return Newton's step (p,), and the pivots (p,): all positive where the Hessian is definite."""
    left, step, p = ca.SX(hessian), -gradient, gradient.numel()
    for k in range(p - 1):
        factor = left[k, k + 1 :].T / left[k, k]
        left[k + 1 :, k + 1 :] -= ca.triu(factor @ left[k, k + 1 :])
        step[k + 1 :] -= factor * step[k]
    pivots = ca.diag(left)
    for k in range(p - 1, -1, -1):
        step[k] = (
            (step[k] - left[k, k + 1 :] @ step[k + 1 :]) / pivots[k]
            if k < p - 1
            else step[k] / pivots[k]
        )
    return step, pivots


def _within(radius: ca.SX, gradient: ca.SX, curvature: ca.SX) -> ca.SX:
    """Return the step (p,) along eigenvectors that minimizes the model no farther than the radius."""
    multiplier = ca.SX(0)
    for _ in range(SECULAR_STEPS):
        step = gradient / (curvature + multiplier)
        length = ca.norm_2(step)
        slope = ca.sum1(step**2 / (curvature + multiplier)) / length
        more = (length / radius - 1) * length / slope
        multiplier += _chosen(length > CLOSE_TO_RADIUS * radius, more, 0.0)
    return -gradient / (curvature + multiplier)


def _next_radius(
    radius: ca.SX, length: ca.SX, promised: ca.SX, modeled: ca.SX, decrease: ca.SX, accepted: ca.SX
) -> ca.SX:
    """Return the radius of the next trust region."""
    # Of the parabola through both costs with the slope at the first, the minimum.
    fall = ca.fmax(promised - decrease, TINY)
    shorter = ca.fmin(ca.fmax(0.5 * promised / fall, SHORTEST), LONGEST) * length
    ratio = _chosen(modeled > 0, decrease / modeled, 0.0)
    wider = ca.fmin(ca.fmax(WIDER * length, radius), LARGEST_RADIUS)
    longest = _chosen(ratio > GOOD, wider, _chosen(ratio < POOR, LONGEST * length, radius))
    return _chosen(accepted, longest, shorter)
