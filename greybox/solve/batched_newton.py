"""Newton's method from many points at once: every operation is done for all of them by one call.

IPOPT spends most of a small fit on itself: of 130 µs an iteration, the functions take some 15. Here
the functions and the iteration itself (`newton_iteration`) are evaluated for all points together;
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

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from greybox.compiled.alike_terms import FEWEST_COLUMNS
from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.response_programs import CostProgram
from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array, ArrayPair, ArrayTriple, BoolArray, IntArray
from greybox.modeling.one_thread import Stored, one_thread_at_a_time
from greybox.solve.interruption import reason_to_end
from greybox.solve.newton_iteration import (
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
        Whether the projected gradient is below the tolerance.
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
        See `newton_iteration`.
    live : (w,) array of bool
        Whether it has not ended.
    data : (g, w) array
        The data of each search.
    """

    owner: IntArray
    numbers: Array
    live: BoolArray
    data: Array


def _iteration(p: int) -> tuple[Columns, Columns]:
    """Return `advanced` and `bounded` for p variables."""
    # Searches go to the next level at a projected gradient of 1e-2: with 1e-3 they take a twentieth
    # more iterations.
    return (
        Columns(advanced(p, LAST, 1e-2), fewest=FEWEST_COLUMNS),
        Columns(bounded(p, LAST), fewest=FEWEST_COLUMNS),
    )


_iterations = Stored(16)


class BatchedNewton:
    """Minimizes a function of z within bounds, from many points at once."""

    def __init__(
        self,
        function: Callable[..., ArrayTriple],
        lower: Array,
        upper: Array,
        data: Array = NO_DATA,
        roots: ca.Function | None = None,
    ) -> None:
        """Take a function (z, smoothing, data), as `SecondOrder`, and the bounds (p,) of z.

        It also takes the `roots` of z and data, if there are any: its derivatives may contain them.
        """
        self._function, self._data = function, data[:, None]
        self._roots = None if roots is None else Columns(roots)
        self._bounds = lower[:, None], upper[:, None]
        self._p = len(lower)
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
        bounds: ArrayPair | None = None,
    ) -> Ends:
        """Search from the columns of z (p, m); with `from_near` at the last level only.

        A `smoothing` replaces those of the levels. A search ends where its projected gradient is at
        most the `tolerance`, relative to the cost where that is above one. The columns of `given`
        (g, m) are the data of each search, and `bounds`, (p, m) or (p, 1), replace the problem's.
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
            ended = searches.live & (searches.numbers[END] != 0)
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
        numbers, rows, p = searches.numbers, self._rows, self._p
        trial = numbers[rows.trial]
        levels = (numbers[LEVEL] + numbers[SWITCHED]).astype(int)
        smoothings = SMOOTHINGS if smoothing is None else np.full(LAST + 1, smoothing)
        roots = [] if self._roots is None else self._roots(trial, searches.data)
        inputs = trial, smoothings[levels][None], searches.data
        cost, gradient, hessian = self._function(*inputs, *roots)

        advance, within_radius = _iterations.result(p, partial(_iteration, p))
        barrier = BARRIERS[searches.owner % len(BARRIERS), levels][None]
        alike = np.full((1, len(levels)), tolerance)
        numbers, hessian_of_free = advance(numbers, barrier, alike, cost[None], gradient, hessian)
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
    live, width = searches.live, len(searches.live)
    narrower = 4 if width >= FEWEST_COLUMNS else 2
    if count > width // narrower:
        return searches
    return _Searches(
        searches.owner[live], searches.numbers[:, live], searches.live[live], searches.data[:, live]
    )
