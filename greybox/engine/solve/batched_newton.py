"""Newton's method from many points at once: every operation is done for all of them by one call.

For a small fit, IPOPT's own overhead is most of its time: of 130 µs an iteration, the cost and its
derivatives take some 15 µs. Here they and the iteration itself are evaluated for all points
together; only some of the points need a small eigenvalue problem. Each point is the start of a
search with its own trust region, which does not depend on the others.

A search passes through levels. At first a logarithmic barrier keeps it away from its bounds:
without it, searches would end in corners of wide boxes. Kinks of the cost at zero residuals are
smoothed. Barrier and smoothing are reduced from level to level. At the last level there is no
barrier, and the smoothing is that of all solvers here.

The steps minimize the quadratic model of the cost within the trust region, with the eigenvalues of
the Hessian made positive (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983). Variables that
the gradient holds at a bound do not move (Bertsekas, SIAM J. Control Optim. 20, 1982).
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
# Projected gradient at which a search goes on to the next level. With 1e-3, searches take a
# twentieth more iterations.
NEXT_LEVEL = 1e-2
# At its start, a search keeps this share of the distance between its bounds from each, as in IPOPT.
MARGIN = 1e-2


class Ends(NamedTuple):
    """Where searches from m points ended.

    Attributes
    ----------
    z : (p, m) array
    at_minimum : (m,) array of bool
        Whether the projected gradient is below the tolerance, or promises a decrease of the cost
        that rounding would hide.
    iterations : (m,) array of int
    cost : (m,) array
        The cost, with the barrier if the last level was not reached.
    """

    z: Array
    at_minimum: BoolArray
    iterations: IntArray
    cost: Array


ALL = slice(None)


def continued(ends: Ends, later: Ends, which: IntArray | slice = ALL) -> Ends:
    """Return the ends of m searches, changed in place, of which some were continued.

    `later` are the new ends of the searches with the numbers `which`. Iterations are added.
    """
    later.iterations[:] += ends.iterations[which]
    for values, replaced in zip(ends, later, strict=True):
        values[..., which] = replaced
    return ends


@dataclass(eq=False)
class _Searches:
    """The searches in progress, with a column for each. Some columns belong to ended ones.

    Attributes
    ----------
    owner : (w,) array of int
        The number of the search in each column.
    numbers : (size, w) array
        The scalars and vectors of each search, see `layout` of `newton_iteration`.
    live : (w,) array of bool
        Whether the search continues.
    data : (g, w) array
        The data of each search.
    """

    owner: IntArray
    numbers: Array
    live: BoolArray
    data: Array


def _iteration(p: int) -> tuple[Columns, ...]:
    """Return the functions `advanced` and `bounded` for p variables, for many columns."""
    functions = advanced(p, NEXT_LEVEL), bounded(p)
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
        """Store a function (z, smoothing, data), as `second_order`, and the bounds (p,) of z.

        With `roots`, a function (z, data), the function takes its result as a fourth argument.
        Searches use the rows of `barriers`, the weights (levels,) of the barrier, in turn.
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
        """Return the ends of searches from the columns of z (p, m).

        A search ends if its projected gradient is below the tolerance, if rounding would hide the
        decrease that Newton's step promises, or if it has passed the last level.

        Parameters
        ----------
        z : (p, m) array
        max_iterations : int
        tolerance : float
            On the projected gradient, divided by the cost if that is above one.
        from_near : bool
            Whether the starts are near minima: the searches then begin at the last level.
        smoothing : float, optional
            Replaces the smoothings of all levels.
        given : (g, m) array, optional
            The data of each search; by default those of the problem.
        bounds : pair of (p, m) or (p, 1) arrays, optional
            Replace those of the problem.
        last : int
            Number of the last level.
        """
        m = z.shape[1]
        data = np.repeat(self._data, m, axis=1) if given is None else given
        low, high = bounds or self._bounds
        ends = Ends(
            z=np.clip(z, low, high),
            at_minimum=np.zeros(m, bool),
            iterations=np.zeros(m, int),
            cost=np.zeros(m),
        )
        if m == 0:
            return ends

        width = high - low
        margin = np.where(np.isfinite(width) & (not from_near), MARGIN * width, 0.0)
        z = np.clip(z, low + margin, high - margin)
        rows = self._rows
        numbers = np.zeros((rows.size, m))
        numbers[rows.z] = numbers[rows.trial] = z
        numbers[rows.lower] = low
        numbers[rows.upper] = high
        # The first evaluation belongs to a search that has just switched from the level before, and
        # is no iteration.
        numbers[LEVEL] = LAST - 1 if from_near else -1
        numbers[SWITCHED] = 1
        numbers[ITERATIONS] = -1
        # The first radius is the size of the start box in the solver's variables.
        numbers[RADIUS] = 1
        searches = _Searches(np.arange(m), numbers, np.ones(m, bool), data)
        self._advance(searches, tolerance, smoothing)
        for _ in range(max_iterations):
            level = searches.numbers[LEVEL] + searches.numbers[SWITCHED]
            ended = searches.live & ((searches.numbers[END] != 0) | (level > last))
            # For few searches, numpy's `any` would take ten times as long as a count.
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
        """Store the ends of the searches that `which` (w,) marks, which are then over."""
        owner = searches.owner[which]
        numbers = searches.numbers[:, which]
        ends.z[:, owner] = numbers[self._rows.z]
        ends.at_minimum[owner] = numbers[END] > 0
        ends.iterations[owner] = numbers[ITERATIONS]
        ends.cost[owner] = numbers[COST]
        searches.live &= ~which

    def _advance(self, searches: _Searches, tolerance: float, smoothing: float | None) -> None:
        """Evaluate the trial point of every search, accept it or not, and choose the next one."""
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
        tolerances = np.full((1, len(levels)), tolerance)
        numbers, hessian_of_free = advance(
            numbers, barrier, tolerances, np.atleast_2d(cost), gradient, hessian
        )
        searches.numbers = numbers
        searches.live &= np.isfinite(numbers[COST])

        # If a search has no Newton step, or one that is too long, the eigenvalues of the Hessian
        # give the step within the radius.
        outside = searches.live & (numbers[IS_NEWTON] == 0)
        if np.count_nonzero(outside):
            values, vectors = np.linalg.eigh(hessian_of_free.T[outside].reshape(-1, p, p))
            # The function is evaluated for all searches: for another number of columns it would
            # need memory of another layout.
            eigenvalues = np.ones((p, len(levels)))
            eigenvalues[:, outside] = values.T
            eigenvectors = np.zeros((p**2, len(levels)))
            eigenvectors[:, outside] = vectors.reshape(-1, p**2).T
            [trials] = within_radius(numbers, eigenvalues, eigenvectors)
            numbers[rows.trial] = np.where(outside, trials, numbers[rows.trial])


def _narrowed(searches: _Searches, count: np.intp) -> _Searches:
    """Return the `count` live searches alone if most columns belong to ended ones.

    The columns are reduced to a quarter at once, because every number of columns needs memory of
    its own layout. For few columns no such memory is built: these are reduced by half.
    """
    live = searches.live
    width = len(live)
    reduction = 4 if width >= FEWEST_IN_A_FEW_CALLS else 2
    if count > width // reduction:
        return searches
    return _Searches(
        owner=searches.owner[live],
        numbers=searches.numbers[:, live],
        live=live[live],
        data=searches.data[:, live],
    )
