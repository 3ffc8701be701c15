"""Newton's method from many points at once: every operation is done for all of them by one call.

IPOPT spends most of a small fit on itself: of 130 µs an iteration some 15 are the functions. Here
the functions are evaluated for all points together, and so is the iteration itself, see
`newton_iteration`; what is left for some of the points is a small eigenvalue problem. Each point is
a search of its own, with a trust region of its own; none depends on the others.

A search passes through levels. At first a logarithmic barrier keeps it away from its bounds, at
which it would end in corners of wide boxes, and kinks of the cost at zero residuals are rounded
off; both are reduced from level to level. At the last one there is no barrier and the smoothing is
that of every solver here. The steps minimize the quadratic model within the trust region, with the
eigenvalues of the Hessian made positive (Moré and Sorensen, SIAM J. Sci. Stat. Comput. 4, 1983),
over the variables that are not held at a bound by the gradient (Bertsekas, SIAM J. Control Optim.
20, 1982).
"""

import threading
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from greybox.compiled.alike_terms import FEWEST_COLUMNS, SecondOrder
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.vectorized import Columns
from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.interruption import reason_to_end
from greybox.solve.newton_iteration import (
    COST,
    END,
    IS_NEWTON,
    ITERATIONS,
    LEVEL,
    RADIUS,
    SWITCHED,
    Vectors,
    advanced,
    bounded,
)

# Factors of the barrier, and smoothings of a cost with kinks, one after the other. The first
# smoothing rounds off what is smaller than the measured response. Without a barrier 81 % instead of
# all of the searches for the yaw axis of the paper reach its minimum, and 15 instead of 60 % of
# those for two resonances with a delay. But a strong barrier misses minima at a bound: of the
# searches for the pitch axis at 5° with its drag free, which is zero at the minimum, 0.5 % find it
# with a first factor of 1, and 96 % with 0.01 (IPOPT 22 %). So every second search has a weak
# barrier.
BARRIERS = np.array([[1.0, 1e-2, 1e-4, 0.0], [1e-2, 1e-3, 1e-4, 0.0]])
SMOOTHINGS = np.array([1.0, 1e-2, 1e-4, SMOOTHING])
LOOSE = 1e-2  # projected gradient at which the next level is taken: with 1e-3 searches take a twentieth more iterations

# Of the distance of its bounds, how near to one a search begins: that of IPOPT.
INSIDE = 1e-2

LAST = BARRIERS.shape[1] - 1

FIRST_RADIUS = 1.0  # of the trust region: that of the box of the starts in the solver's variables

# A batch is narrowed to a quarter or less, so that few layouts of registers serve; to a half where
# none are laid out.
NARROWER, NARROWER_OF_FEW = 4, 2

SIZES = 16  # numbers of variables of which the iterations are kept


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
    at_minimum: BoolArray
    iterations: IntArray


@dataclass(eq=False)
class _Searches:
    """The searches that are under way, a column for each, and some that fill up to a width."""

    owner: IntArray  # of the column, where it is live
    path: IntArray  # row of the barriers
    numbers: Array  # see `newton_iteration`
    live: BoolArray
    given: Array  # (g, m), what the function takes besides, of each search

    def taken(self, columns: IntArray) -> "_Searches":
        """Return those in some columns, and one of them as often as a width takes."""
        live = np.arange(_width(len(columns))) < len(columns)
        columns = _filled(columns)
        return _Searches(
            self.owner[columns],
            self.path[columns],
            self.numbers[:, columns],
            live,
            self.given[:, columns],
        )


class _Iterations(threading.local):
    """Those of problems with the same number of variables are the same; CasADi's functions serve one thread."""

    def __init__(self) -> None:
        self.of = lru_cache(maxsize=SIZES)(_iteration)


@one_thread_at_a_time
def _iteration(p: int) -> tuple[Columns, Columns]:
    """Return `advanced` and `bounded` for p variables."""
    return (
        Columns(advanced(p, LAST, LOOSE), fewest=FEWEST_COLUMNS),
        Columns(bounded(p, LAST), fewest=FEWEST_COLUMNS),
    )


_iterations = _Iterations()


class BatchedNewton:
    """Minimizes a function of z within bounds, from many points at once."""

    @one_thread_at_a_time
    def __init__(
        self,
        program: ca.Function,
        lower: Array,
        upper: Array,
        roots: ca.Function | None = None,
    ) -> None:
        """Take an SX function (z, smoothing, ...) -> cost, ..., and the bounds (p,) of z.

        The function also takes the `roots` of z, if there are any, which its derivatives may
        contain, and what differs between the searches: `given` of `minimize`.
        """
        inputs = [ca.SX.sym("v", program.numel_in(k)) for k in range(program.n_in())]
        self._function = SecondOrder(inputs, program(*inputs)[0])
        self._roots = None if roots is None else Columns(roots)
        self._bounds = lower[:, None], upper[:, None]
        self._rows = Vectors(len(lower))

    def minimize(
        self,
        z: Array,
        *,
        max_iterations: int,
        tolerance: float,
        from_near: bool = False,
        given: Array | None = None,
        bounds: tuple[Array, Array] | None = None,
    ) -> Ends:
        """Search from the columns of z (p, m); with `from_near` at the last level only.

        A search ends where its projected gradient is at most the `tolerance`, relative to the cost
        where that is above one. The columns of `given` (g, m) belong to the searches, where the
        program takes them, and so do those of other `bounds`, (p, m) each, than the problem's.
        """
        m = z.shape[1]
        low, high = bounds or self._bounds
        ends = Ends(np.clip(z, low, high), np.zeros(m, bool), np.zeros(m, int))
        if not m:
            return ends
        margin = np.where(np.isfinite(high - low) & (not from_near), INSIDE * (high - low), 0.0)
        z = np.clip(z, low + margin, high - margin)
        searches = self._begun(z, low, high, LAST if from_near else 0, given)
        self._advance(searches, tolerance)
        for _ in range(max_iterations):
            ended = searches.live & (searches.numbers[END] != 0)
            if ended.any():
                self._end(searches, ended, ends)
            if reason_to_end() or not searches.live.any():
                break
            searches = _narrowed(searches)
            self._advance(searches, tolerance)
        self._end(searches, searches.live, ends)
        return ends

    def _begun(
        self, z: Array, low: Array, high: Array, level: int, given: Array | None
    ) -> _Searches:
        """Return the searches from the columns of z (p, m), at a level."""
        m, rows = z.shape[1], self._rows
        numbers = np.zeros((rows.size, m))
        numbers[rows.z] = numbers[rows.trial] = z
        numbers[rows.lower], numbers[rows.upper] = low, high
        # Taken over as any other level is.
        numbers[RADIUS], numbers[LEVEL], numbers[SWITCHED], numbers[ITERATIONS] = (
            FIRST_RADIUS,
            level - 1,
            1,
            -1,
        )
        every = np.arange(m)
        given = np.zeros((0, m)) if given is None else given
        return _Searches(every, every % len(BARRIERS), numbers, np.ones(m, bool), given).taken(
            every
        )

    def _end(self, searches: _Searches, which: BoolArray, ends: Ends) -> None:
        """Take searches out."""
        owner, numbers = searches.owner[which], searches.numbers[:, which]
        ends.z[:, owner] = numbers[self._rows.z]
        ends.at_minimum[owner] = numbers[END] > 0
        ends.iterations[owner] = numbers[ITERATIONS]
        searches.live &= ~which

    def _advance(self, searches: _Searches, tolerance: float) -> None:
        """Evaluate the trial of every search, and take it or not; or the next level."""
        numbers, rows = searches.numbers, self._rows
        trial, levels = numbers[rows.trial], (numbers[LEVEL] + numbers[SWITCHED]).astype(int)
        inputs = [trial, SMOOTHINGS[levels][None]]
        inputs += [] if self._roots is None else self._roots(trial)
        inputs += [searches.given] if len(searches.given) else []
        cost, gradient, hessian = self._function(*inputs)
        advance, within_radius = _iterations.of(rows.p)
        own = [BARRIERS[searches.path, levels][None], np.full((1, len(levels)), tolerance)]
        numbers, of_free = advance(numbers, *own, cost[None], gradient, hessian)
        searches.numbers = numbers
        searches.live &= np.isfinite(numbers[COST])
        others = np.flatnonzero(searches.live & (numbers[IS_NEWTON] == 0))
        if others.size:
            eigenvalues, vectors = np.linalg.eigh(of_free.T[others].reshape(-1, rows.p, rows.p))
            vectors, each = vectors.reshape(-1, rows.p**2), _filled(np.arange(others.size))
            [trials] = within_radius(
                numbers.take(others[each], axis=1), eigenvalues[each].T, vectors[each].T
            )
            numbers[rows.trial, others] = trials[:, : others.size]


def _filled(columns: IntArray) -> IntArray:
    """Return the columns, the first of them repeated up to a power of two, so that few layouts serve."""
    return np.concatenate([columns, np.full(_width(len(columns)) - len(columns), columns[0])])


def _width(m: int) -> int:
    """Return the number of columns that are evaluated for m points, at least one."""
    return 1 << (m - 1).bit_length()


def _narrowed(searches: _Searches) -> _Searches:
    """Return the searches without those that ended, where these are the most."""
    live = np.flatnonzero(searches.live)
    width = _width(len(live))
    narrower = NARROWER if width >= FEWEST_COLUMNS else NARROWER_OF_FEW
    return searches if narrower * width > len(searches.live) else searches.taken(live)
