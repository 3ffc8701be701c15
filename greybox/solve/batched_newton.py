"""Newton's method from many points at once: every operation is done for all of them by one call.

IPOPT spends most of a small fit on itself: of 130 µs an iteration some 15 are the functions. Here the functions are
evaluated for all points together, and what is left for each point is a small eigenvalue problem. Each point is a search
of its own, with a trust region of its own; none depends on the others.

A search passes through levels. At first a logarithmic barrier keeps it away from its bounds, at which it would end in
corners of wide boxes, and kinks of the cost at zero residuals are rounded off; both are reduced from level to level. At
the last one there is no barrier and the smoothing is that of every solver here. The steps minimize the quadratic model
within the trust region, with the eigenvalues of the Hessian made positive (Moré and Sorensen, SIAM J. Sci. Stat.
Comput. 4, 1983), over the variables that are not held at a bound by the gradient (Bertsekas, SIAM J. Control Optim. 20,
1982).
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.alike_terms import SecondOrder
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.vectorized import Columns
from greybox.solve.interruption import reason_to_end

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Factors of the barrier, and smoothings of a cost with kinks, one after the other. The first smoothing rounds off what
# is smaller than the measured response. Without a barrier 81 % instead of all of the searches for the yaw axis of the
# paper reach its minimum, and 15 instead of 60 % of those for two resonances with a delay. But a strong barrier misses
# minima at a bound: of the searches for the pitch axis at 5° with its drag free, which is zero at the minimum, 0.5 %
# find it with a first factor of 1, and 96 % with 0.01 (IPOPT 22 %). So every second search has a weak barrier.
BARRIERS = np.array([[1.0, 1e-2, 1e-4, 0.0], [1e-2, 1e-3, 1e-4, 0.0]])
SMOOTHINGS = np.array([1.0, 1e-2, 1e-4, SMOOTHING])
LOOSE = 1e-3  # projected gradient at which the next level is taken

# Of the distance of its bounds, how near to one a search begins; and of the distance to a bound, how much of it a step
# takes while there is a barrier. Those of IPOPT.
INSIDE = 1e-2
TO_BOUND = 0.99

LAST = BARRIERS.shape[1] - 1

RADIUS = 1.0  # of the first trust region: that of the box of the starts in the solver's variables
LARGEST_RADIUS = 10.0
LEAST_RADIUS = 1e-15  # beyond, rounding has the last word
FLATTEST = 1e-12  # of the largest eigenvalue: curvatures below are rounding errors

SUFFICIENT = 1e-4  # of the decrease that the gradient promises (Armijo)
# A batch is narrowed to a quarter or less, so that few layouts of registers serve.
NARROWER = 4

ROUNDING = 1e-12  # of the cost: smaller promised decreases cannot be seen in it
GOOD, POOR = 0.5, 0.1  # ratios of the real to the modeled decrease at which the radius changes
WIDER = 3.0  # times the step after a good one
SHORTEST, LONGEST = 0.1, 0.5  # times the step after a failed one, between which interpolation decides
SECULAR_STEPS = 8  # of Newton's method for the multiplier of the radius; three or four reach a twentieth of it
CLOSE_TO_RADIUS = 1.05
TINY = float(np.finfo(float).tiny)
# Points from which it pays to try elimination, which takes a thirtieth of the time of eigenvalues, before these: of
# the steps on the fits of the paper three in five need no more.
MANY_STEPS = 128


@dataclass(frozen=True, eq=False)
class Ends:
    """Where searches from m points ended.

    Attributes
    ----------
    z : (p, m) array
    at_minimum : (m,) array of bool
        Where the projected gradient is as small as was asked for.
    iterations : (m,) array of int
    """

    z: Array
    at_minimum: Flags
    iterations: NDArray[np.int_]


@dataclass(eq=False)
class _Points:
    """The searches that are under way, a column for each, and some that fill up to a width."""

    owner: NDArray[np.int_]  # of the column; -1 where it only fills up
    z: Array
    path: NDArray[np.int_]  # row of the barriers
    level: NDArray[np.int_]
    radius: Array
    cost: Array
    gradient: Array
    hessian: Array  # (p, p, m)
    slope: Array  # the largest component of the projected gradient
    live: Flags
    given: Array  # (g, m), what the function takes besides, of each search

    def taken(self, columns: NDArray[np.int_]) -> "_Points":
        return _Points(
            self.owner[columns],
            self.z[:, columns],
            self.path[columns],
            self.level[columns],
            self.radius[columns],
            self.cost[columns],
            self.gradient[:, columns],
            self.hessian[:, :, columns],
            self.slope[columns],
            self.live[columns],
            self.given[:, columns],
        )


class BatchedNewton:
    """Minimizes a function of z within bounds, from many points at once."""

    def __init__(
        self,
        program: ca.Function,
        lower: Array,
        upper: Array,
        roots: ca.Function | None = None,
        *,
        as_c: bool = False,
    ) -> None:
        """Take the program and the bounds (p,) of z.

        It is an SX function (z, smoothing, ...) -> cost, ..., which takes besides: the `roots` of z, if there are any,
        which its derivatives may hold; then, if searches differ in it, what is given. With `as_c` it is compiled.

        Raises
        ------
        RuntimeError
            Where it cannot be compiled, see `greybox.compiled.code_generation.compiled`.
        """
        inputs = [ca.SX.sym("v", program.numel_in(k)) for k in range(program.n_in())]
        self._function = SecondOrder(inputs, program(*inputs)[0], as_c=as_c)
        self._roots = None if roots is None else Columns(roots)
        self._lower, self._upper = lower[:, None], upper[:, None]
        self._is_bounded = np.isfinite(self._lower), np.isfinite(self._upper)

    def minimize(
        self,
        z: Array,
        *,
        max_iterations: int,
        tolerance: float,
        from_near: bool = False,
        given: Array | None = None,
    ) -> Ends:
        """Search from the columns of z (p, m); with `from_near` at the last level only.

        A search ends where its projected gradient is at most the `tolerance`, relative to the cost where that is above
        one. The columns of `given` (g, m) belong to the searches, where the program takes them.
        """
        m = z.shape[1]
        ends = Ends(np.clip(z, self._lower, self._upper), np.zeros(m, bool), np.zeros(m, int))
        if not m:
            return ends
        first = ends.z if from_near else self._inside(ends.z)
        points = self._begun(first, LAST if from_near else 0, np.zeros((0, m)) if given is None else given)
        for _ in range(max_iterations):
            self._end_finished(points, ends, tolerance)
            if reason_to_end() or not points.live.any():
                break
            points = _narrowed(points)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of points that are rejected then
                self._step(points)
            ends.iterations[points.owner[points.live]] += 1
        self._end_finished(points, ends, tolerance)
        left = points.live
        ends.z[:, points.owner[left]] = points.z[:, left]
        return ends

    def _inside(self, z: Array) -> Array:
        """Return points as near to their bounds as a search may begin."""
        width = self._upper - self._lower
        margin = np.where(np.isfinite(width), INSIDE * width, 0.0)
        return np.clip(z, self._lower + margin, self._upper - margin)

    def _evaluated(
        self, z: Array, path: NDArray[np.int_], level: NDArray[np.int_], given: Array
    ) -> tuple[Array, Array, Array]:
        """Return cost (m,), gradient (p, m) and Hessian (p, p, m), those of the barrier included."""
        inputs = [z, SMOOTHINGS[level][None]]
        inputs += [] if self._roots is None else self._roots(z)
        inputs += [given] if len(given) else []
        cost, gradient, hessian = self._function(*inputs)
        p, m = z.shape
        barrier = BARRIERS[path, level]
        if barrier.any():
            diagonal = hessian[:: p + 1]
            below, above = self._is_bounded
            for is_bounded, to_bound, sign in ((below, z - self._lower, 1.0), (above, self._upper - z, -1.0)):
                factor = barrier * is_bounded
                distance = np.where(factor > 0, to_bound, 1.0)
                share = factor / distance
                cost -= (factor * np.log(distance)).sum(axis=0)
                gradient -= sign * share
                diagonal += share / distance
        return cost, gradient, hessian.reshape(p, p, m)

    def _begun(self, z: Array, level: int, given: Array) -> _Points:
        m = z.shape[1]
        columns = np.concatenate([np.arange(m), np.zeros(_width(m) - m, int)])
        paths, levels = columns % len(BARRIERS), np.full(len(columns), level)
        given = given[:, columns]
        cost, gradient, hessian = self._evaluated(z[:, columns], paths, levels, given)
        owner = np.where(np.arange(len(columns)) < m, columns, -1)
        live = (owner >= 0) & _are_finite(cost, gradient, hessian)
        radius = np.full(len(columns), RADIUS)
        z = z[:, columns]
        slope = self._projected_gradient(z, gradient)
        return _Points(owner, z, paths, levels, radius, cost, gradient, hessian, slope, live, given)

    def _projected_gradient(self, z: Array, gradient: Array) -> Array:
        """Return its largest component, (m,)."""
        return np.abs(z - self._clipped(z - gradient)).max(axis=0)

    def _clipped(self, z: Array) -> Array:
        return np.minimum(np.maximum(z, self._lower), self._upper)

    def _end_finished(self, points: _Points, ends: Ends, tolerance: float) -> None:
        """Take the searches out that are at a minimum, or can go no further."""
        small = points.slope <= tolerance * np.maximum(np.abs(points.cost), 1.0)
        found = points.live & small & (points.level == LAST)
        finished = found | (points.live & (points.radius < LEAST_RADIUS))
        if not finished.any():
            return
        ends.z[:, points.owner[finished]] = points.z[:, finished]
        ends.at_minimum[points.owner[found]] = True
        points.live &= ~finished

    def _step(self, points: _Points) -> None:
        """Take one step of every search that is under way, or the next level."""
        next_level = points.live & (points.level < LAST) & (points.slope <= LOOSE)
        share = np.where(points.level < LAST, TO_BOUND, 1.0)
        lowest = points.z - share * (points.z - self._lower)
        highest = points.z + share * (self._upper - points.z)
        moved = np.minimum(np.maximum(points.z + self._newton_step(points), lowest), highest)
        points.level = points.level + next_level
        moved = np.where(next_level | ~points.live, points.z, moved)
        step = moved - points.z
        cost, gradient, hessian = self._evaluated(moved, points.path, points.level, points.given)

        promised = -np.einsum("pm,pm->m", points.gradient, step)
        modeled = promised - 0.5 * np.einsum("pm,pm->m", step, np.einsum("pqm,qm->pm", points.hessian, step))
        finite = _are_finite(cost, gradient, hessian)
        decrease = np.where(finite, points.cost - np.where(finite, cost, 0.0), -np.inf)
        invisible = finite & (np.abs(promised) <= ROUNDING * np.abs(points.cost))
        accepted = invisible | ((promised > 0) & (decrease >= SUFFICIENT * promised))
        taken = points.live & (accepted | next_level)
        # What was taken over to another level is a beginning, not a step.
        tried = points.live & ~next_level
        points.radius[tried] = _next_radius(points, step, promised, modeled, decrease, accepted)[tried]
        points.z = np.where(taken, moved, points.z)
        points.cost = np.where(taken, cost, points.cost)
        points.gradient = np.where(taken, gradient, points.gradient)
        points.hessian = np.where(taken, hessian, points.hessian)
        points.slope = self._projected_gradient(points.z, points.gradient)

    def _newton_step(self, points: _Points) -> Array:
        """Return the step (p, m) within the trust region, of the variables that no bound holds."""
        outward = (points.z <= self._lower) & (points.gradient > 0)
        outward |= (points.z >= self._upper) & (points.gradient < 0)
        free = ~outward & points.live
        gradient = np.where(free, points.gradient, 0.0)
        hessian = np.where(free[:, None] & free, points.hessian, 0.0)
        if points.live.size < MANY_STEPS:
            return np.where(free, _bounded_step(points.radius, gradient, hessian), 0.0)
        hessian.reshape(-1, free.shape[1])[:: len(free) + 1] += ~free
        step, pivots = _eliminated(hessian, gradient)
        is_newton = pivots.min(axis=0) > FLATTEST * pivots.max(axis=0)
        is_newton &= (step**2).sum(axis=0) <= (CLOSE_TO_RADIUS * points.radius) ** 2
        [rest] = np.nonzero(points.live & ~is_newton)
        step[:, rest] = _bounded_step(points.radius[rest], gradient[:, rest], hessian[:, :, rest])
        return np.where(free, step, 0.0)


def _eliminated(hessian: Array, gradient: Array) -> tuple[Array, Array]:
    """Return Newton's steps (p, m), and the pivots (p, m): all positive where the Hessian (p, p, m) is definite."""
    left, step = hessian.copy(), -gradient
    p = len(step)
    for k in range(p - 1):
        factor = left[k + 1 :, k] / left[k, k]
        left[k + 1 :, k + 1 :] -= factor[:, None] * left[k, k + 1 :]
        step[k + 1 :] -= factor * step[k]
    pivots = left.reshape(p * p, -1)[:: p + 1]
    for k in range(p - 1, -1, -1):
        step[k] -= (left[k, k + 1 :] * step[k + 1 :]).sum(axis=0)
        step[k] /= pivots[k]
    return step, pivots


def _bounded_step(radius: Array, gradient: Array, hessian: Array) -> Array:
    """Return the steps (p, m) within the radius (m,), with the eigenvalues of the Hessian (p, p, m) made positive."""
    curvature, directions = np.linalg.eigh(hessian.transpose(2, 0, 1))
    curvature = np.abs(curvature)
    largest = np.maximum(curvature.max(axis=1, initial=TINY), TINY)
    along = np.einsum("mpq,pm->mq", directions, gradient)
    along = _within(radius, along, np.maximum(curvature, FLATTEST * largest[:, None]))
    return np.einsum("mpq,mq->pm", directions, along)


def _within(radius: Array, gradient: Array, curvature: Array) -> Array:
    """Return the steps (m, p) along eigenvectors that minimize the model no farther than the radius (m,)."""
    multiplier = np.zeros((len(radius), 1))
    for _ in range(SECULAR_STEPS):
        step = -gradient / (curvature + multiplier)
        length = np.sqrt((step**2).sum(axis=1))
        beyond = length > CLOSE_TO_RADIUS * radius
        if not beyond.any():
            break
        slope = (step**2 / (curvature + multiplier)).sum(axis=1)[beyond] / length[beyond]
        multiplier[beyond, 0] += (length[beyond] / radius[beyond] - 1) * length[beyond] / slope
    return -gradient / (curvature + multiplier)


def _next_radius(
    points: _Points, step: Array, promised: Array, modeled: Array, decrease: Array, accepted: Flags
) -> Array:
    """Return the radius (m,) of the next trust region."""
    length = np.sqrt((step**2).sum(axis=0))
    # Of the parabola through both costs with the slope at the first, the minimum.
    fall = np.maximum(promised - decrease, TINY)
    shorter = np.minimum(np.maximum(0.5 * promised / fall, SHORTEST), LONGEST) * length
    is_modeled = modeled > 0
    ratio = np.where(is_modeled, decrease / np.where(is_modeled, modeled, 1.0), 0.0)
    wider = np.minimum(np.maximum(WIDER * length, points.radius), LARGEST_RADIUS)
    longest = np.where(ratio > GOOD, wider, np.where(ratio < POOR, LONGEST * length, points.radius))
    return np.where(accepted, longest, shorter)


def _are_finite(cost: Array, gradient: Array, hessian: Array) -> Flags:
    # A sum is finite if all of it is, but for an overflow, which a step does not survive either.
    return np.isfinite(cost + gradient.sum(axis=0) + hessian.sum(axis=(0, 1)))


def _width(m: int) -> int:
    """Return the number of columns that are evaluated for m points: a power of two, so that few layouts serve."""
    return 1 << max(m - 1, 0).bit_length()


def _narrowed(points: _Points) -> _Points:
    """Return the searches without those that ended, where these are the most."""
    live = np.flatnonzero(points.live)
    width = _width(len(live))
    if NARROWER * width > len(points.live):
        return points
    taken = points.taken(np.concatenate([live, np.full(width - len(live), live[0])]))
    taken.owner[len(live) :] = -1
    taken.live[len(live) :] = False
    return taken
