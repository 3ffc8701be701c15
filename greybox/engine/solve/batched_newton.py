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
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.response_programs import CostProgram
from greybox.engine.compiled.vectorized import FEWEST_IN_A_FEW_CALLS, Columns
from greybox.engine.solve.barrier_levels import BARRIERS, LAST, SMOOTHINGS
from greybox.engine.solve.interruption import reason_to_end
from greybox.engine.solve.newton_iteration import (
    COST,
    END,
    IS_NEWTON,
    ITERATIONS,
    LEVEL,
    RADIUS,
    SWITCHED,
    advanced,
    bounded,
    layout,
)
from greybox.modeling.one_thread import Stored, one_thread_at_a_time

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
