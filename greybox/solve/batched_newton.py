"""Newton's method from many points at once: every operation is done for all of them by one call.

IPOPT spends most of a small fit on itself: of 130 µs an iteration, the functions take some 15. Here
the functions and the iteration itself are evaluated for all points together;
only some of the points need a small eigenvalue problem. Each point is a search of its own, with its
own trust region; none depends on the others.

A search passes through levels. First a logarithmic barrier keeps it away from its bounds, where it
would end in corners of wide boxes, and kinks of the cost at zero residuals are rounded off. Both
are reduced from level to level; at the last level there is no barrier, and the smoothing is that of
every solver here. The steps minimize the quadratic model within the trust region, with the
eigenvalues of the Hessian made positive (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983),
over the variables that are not held at a bound by the gradient (Bertsekas, SIAM J. Control Optim.
20, 1982).

One iteration of Newton's method within a trust region, as two CasADi functions.

An iteration takes some hundred array operations. For a few searches each operation takes a
microsecond, ten times as long as its arithmetic. As two CasADi functions they are evaluated for all
searches by two calls, see `greybox.compiled.vectorized`.

The numbers of a search of p variables are a column: first the scalars at the rows named here, then
the vectors of `Vectors`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, starmap
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.response_programs import CostProgram
from greybox.compiled.vectorized import FEWEST_IN_A_FEW_CALLS, Columns
from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.modeling.one_thread import Stored, one_thread_at_a_time
from greybox.solve.interruption import reason_to_end

# Factors of the barrier, and smoothings of a cost with kinks, one level after the other. The first
# smoothing rounds off what is smaller than the measured response. Without a barrier 81 % instead of
# all of the searches for the yaw axis of the paper reach its minimum, and 15 instead of 60 % of
# those for two resonances with a delay. But a strong barrier misses minima at a bound: of the
# searches for the pitch axis at 5° with its drag free, which is zero at the minimum, 0.5 % find it
# with a first factor of 1, and 96 % with 0.01 (IPOPT 22 %). So every second search has a weak
# barrier.
BARRIERS = np.array([[1.0, 1e-2, 1e-4, 0.0], [1e-2, 1e-3, 1e-4, 0.0]])
SMOOTHINGS = np.array([1.0, 1e-2, 1e-4, SMOOTHING])
LAST = BARRIERS.shape[1] - 1
NO_DATA = np.zeros(0)


class Ends(NamedTuple):
    """Where searches from m points ended.

    Attributes
    ----------
    z : (p, m) array
    at_minimum : (m,) array of bool
        Whether the projected gradient is below the tolerance, or rounding hides what it promises.
    iterations : (m,) array of int
    cost : (m,) array
        The function, with the barrier if the last level was not reached.
    """

    z: Array
    at_minimum: BoolArray
    iterations: IntArray
    cost: Array


ALL = slice(None)


def continued(ends: Ends, later: Ends, which: IntArray | slice = ALL) -> Ends:
    """Return the ends of m searches, with later ends of all or of those at the places `which`."""
    later.iterations[:] += ends.iterations[which]
    for values, replaced in zip(ends, later, strict=True):
        values[..., which] = replaced
    return ends


@dataclass(eq=False)
class _Searches:
    """The searches in progress, and some that have ended, a column for each.

    Attributes
    ----------
    owner : (w,) array
        The search of each column.
    numbers : (size, w) array
        The scalars at the rows of `Rows`, then the vectors of `Vectors`.
    live : (w,) array of bool
        Whether it has not ended.
    data : (g, w) array
        The data of each search.
    """

    owner: IntArray
    numbers: Array
    live: BoolArray
    data: Array


def _iteration(p: int) -> tuple[Columns, ...]:
    """Return `advanced` and `bounded` for p variables."""
    # Searches go to the next level at a projected gradient of 1e-2: with 1e-3 they take a twentieth
    # more iterations.
    functions = advanced(p, 1e-2), bounded(p)
    return tuple(Columns(function, fewest=FEWEST_IN_A_FEW_CALLS) for function in functions)


_iterations = Stored(16)


class BatchedNewton:
    """Minimizes a function of z within bounds, from many points at once."""

    def __init__(
        self,
        function: Callable[..., Sequence[Array]],
        lower: Array,
        upper: Array,
        data: Array = NO_DATA,
        roots: ca.Function | None = None,
        barriers: Array = BARRIERS,
    ) -> None:
        """Take a function (z, smoothing, data), as `second_order`, and the bounds (p,) of z.

        It also takes the `roots` of z and data, if there are any: its derivatives may contain them.
        The rows of `barriers` are those of one search after the other.
        """
        self._barriers = barriers
        self._function = function
        self._data = data[:, None]
        self._roots = None if roots is None else Columns(roots)
        self._bounds = lower[:, None], upper[:, None]
        self._rows = layout(len(lower))

    @classmethod
    @one_thread_at_a_time
    def of(cls, problem: CompiledProblem, program: CostProgram) -> "BatchedNewton":
        """Return the search for the minima of a program of the problem."""
        return cls(program.second_order, *problem.bounds, problem.data, program.roots)

    def minimize(
        self,
        z: Array,
        *,
        max_iterations: int,
        tolerance: float,
        from_near: bool = False,
        smoothing: float | None = None,
        given: Array | None = None,
        bounds: tuple[Array, Array] | None = None,
        last: int = LAST,
    ) -> Ends:
        """Search from the columns of z (p, m); with `from_near` at the last level only.

        A `smoothing` replaces those of the levels. A search ends where its projected gradient is at
        most the `tolerance`, relative to the cost where that is above one, where Newton's step
        promises a decrease that rounding hides, or when it has passed the `last` level. The columns
        of `given` (g, m) are the data of each search, and `bounds`, (p, m) or (p, 1), replace the
        problem's.
        """
        m = z.shape[1]
        data = np.repeat(self._data, m, axis=1) if given is None else given
        low, high = bounds or self._bounds
        ends = Ends(np.clip(z, low, high), np.zeros(m, bool), np.zeros(m, int), np.zeros(m))
        if not m:
            return ends

        # A search begins at least a hundredth of the interval inside its bounds, as in IPOPT.
        margin = np.where(np.isfinite(high - low) & (not from_near), 1e-2 * (high - low), 0.0)
        z = np.clip(z, low + margin, high - margin)
        rows = self._rows
        numbers = np.zeros((rows.size, m))
        numbers[rows.z] = numbers[rows.trial] = z
        numbers[rows.lower], numbers[rows.upper] = low, high
        # The first evaluation is that of a search which has just switched to the level. The radius
        # is the size of the start box in the solver's variables.
        numbers[LEVEL] = LAST - 1 if from_near else -1
        numbers[SWITCHED] = numbers[RADIUS] = 1
        numbers[ITERATIONS] = -1
        searches = _Searches(np.arange(m), numbers, np.ones(m, bool), data)
        self._advance(searches, tolerance, smoothing)
        for _ in range(max_iterations):
            _, _, level, switched, _, end, *_ = searches.numbers
            ended = searches.live & ((end != 0) | (level + switched > last))
            # For few searches `any` takes ten times as long.
            if np.count_nonzero(ended):
                self._end(searches, ended, ends)
            live = np.count_nonzero(searches.live)
            if reason_to_end() or not live:
                break
            searches = _narrowed(searches, live)
            self._advance(searches, tolerance, smoothing)
        self._end(searches, searches.live, ends)
        return ends

    def _end(self, searches: _Searches, which: BoolArray, ends: Ends) -> None:
        """Move searches to the ends."""
        owner, numbers = searches.owner[which], searches.numbers[:, which]
        ends.z[:, owner] = numbers[self._rows.z]
        ends.at_minimum[owner] = numbers[END] > 0
        ends.iterations[owner] = numbers[ITERATIONS]
        ends.cost[owner] = numbers[COST]
        searches.live &= ~which

    def _advance(self, searches: _Searches, tolerance: float, smoothing: float | None) -> None:
        """Evaluate the trial of every search, accept it or not, and find the next trial."""
        numbers, rows = searches.numbers, self._rows
        trial = numbers[rows.trial]
        p = len(trial)
        levels = (numbers[LEVEL] + numbers[SWITCHED]).astype(int)
        smoothings = SMOOTHINGS if smoothing is None else np.full(LAST + 1, smoothing)
        roots = [] if self._roots is None else self._roots(trial, searches.data)
        inputs = trial, smoothings[levels][None], searches.data
        cost, gradient, hessian = self._function(*inputs, *roots)

        advance, within_radius = _iterations.result(p, partial(_iteration, p))
        barrier = self._barriers[searches.owner % len(self._barriers), levels][None]
        alike = np.full((1, len(levels)), tolerance)
        numbers, hessian_of_free = advance(
            numbers, barrier, alike, np.atleast_2d(cost), gradient, hessian
        )
        searches.numbers = numbers
        searches.live &= np.isfinite(numbers[COST])

        # Where there is no Newton step, or it is too long, eigenvalues give the step within the
        # radius.
        outside = searches.live & (numbers[IS_NEWTON] == 0)
        if np.count_nonzero(outside):
            eigenvalues, eigenvectors = np.ones((p, len(levels))), np.zeros((p**2, len(levels)))
            pairs = np.linalg.eigh(hessian_of_free.T[outside].reshape(-1, p, p))
            eigenvalues[:, outside] = pairs[0].T
            eigenvectors[:, outside] = pairs[1].reshape(-1, p**2).T
            # For all searches, since another number of them would need another layout.
            [trials] = within_radius(numbers, eigenvalues, eigenvectors)
            numbers[rows.trial] = np.where(outside, trials, numbers[rows.trial])


def _narrowed(searches: _Searches, count: np.intp) -> _Searches:
    """Return the `count` searches that have not ended, alone if the others are many.

    Three of four, so that few layouts of registers are built; half where none are built.
    """
    live = searches.live
    width = len(searches.live)
    narrower = 4 if width >= FEWEST_IN_A_FEW_CALLS else 2
    if count > width // narrower:
        return searches
    return _Searches(
        searches.owner[live], searches.numbers[:, live], searches.live[live], searches.data[:, live]
    )


COST = 0  # infinite where the cost or a derivative is not finite
RADIUS, LEVEL = 1, 2
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
TINY, LARGEST = float(np.finfo(float).tiny), float(np.finfo(float).max)


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
    z, trial, gradient = (numbers[at] for at in (rows.z, rows.trial, rows.gradient))
    hessian, new_hessian = ca.reshape(numbers[rows.hessian], p, p), ca.reshape(curvatures, p, p)
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
    """Return whether rounding hides the decrease that Newton's step (p,) promises.

    At a light mode with small errors, the gradient is rounded to more than any tolerance.
    """
    promise = -0.5 * ca.dot(gradient, newton)
    return promise <= INVISIBLE * tolerance * ca.fabs(cost)


def _free(z: ca.SX, gradient: ca.SX, lower: ca.SX, upper: ca.SX) -> ca.SX:
    """Return 1 for the variables that no bound holds, 0 for the others."""
    below, above = ca.logic_and(z <= lower, gradient > 0), ca.logic_and(z >= upper, gradient < 0)
    return ca.logic_not(ca.logic_or(below, above))


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
