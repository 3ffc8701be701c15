"""Many runs of one compiled problem: their solver, the order of their starts, and when there were enough."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.strategies import with_options
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.solve.executors import packed, run_all
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns
from greybox.solve.interruption import stop_requested
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.local_search import LocalSearch
from greybox.solve.local_solver import LocalSolver, Runner, Screened
from greybox.solve.minima import Minimum, Multistart, agreeing_runs, find_minima
from greybox.solve.response_solver import ResponseSolver
from greybox.solve.runs import Ended, Run, Runs
from greybox.solve.transcribed_program import TranscribedProgram


class Waves(ABC):
    """Parts of the starts, tried one after the other until there were enough.

    The decisions depend on the starts and their order alone, never on which run finishes first.
    """

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts (r, p) compared with each other; None if they are not compared."""
        return None

    @abstractmethod
    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield the numbers of the starts of every wave."""

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether the runs of all waves so far are enough."""
        return False


@dataclass(frozen=True)
class AllAtOnce(Waves):
    """Every start."""

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield all numbers."""
        yield range(count)


@dataclass(frozen=True)
class PromisingFirst(Waves):
    """The most promising starts first, and the others if these do not agree; all if they cannot be compared.

    Parameters
    ----------
    promising : int
        Number of starts in the first wave. On the fits of the paper each of them nearly always
        reaches the best minimum. Eight in a batch take the time of two or three runs of IPOPT; of
        runs on records, which are made one by one, four are enough.
    agreeing : int
        Number of these that must end at the lowest cost. With four of eight, as with three of four,
        the chance of an error is below 2 % if less than one start in six leads there.
    """

    promising: int
    agreeing: int

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts compared by the solver."""
        return solver.screened(starts) if len(starts) > self.promising else None

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield the promising starts, the best first, then the others in their order."""
        if screened is None:
            yield range(count)
            return
        first = screened.order[: self.promising].tolist()
        yield first
        yield [k for k in range(count) if k not in set(first)]

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether enough of the promising starts agree."""
        return len(agreeing_runs_of(nlp, runs, minima)) >= self.agreeing


@dataclass(frozen=True)
class FoundAgain(Waves):
    """Waves that double the number of starts, until another minimum is unlikely.

    If n searches from random points found w minima, and all numbers of minima and all sizes of their
    regions of attraction were equally likely a priori, the probability that there is no other is

        Π_{i=1}^{w} (n - 1 - i) / (n - 1 + i)

    (Boender and Rinnooy Kan, Bayesian stopping rules for multistart global optimization methods,
    Math. Programming 37, 1987).

    Parameters
    ----------
    error : float
        One minus the probability at which the search ends.
    """

    error: float

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield waves that double the number of starts."""
        begin = 0
        end = min(32, count)  # starts that find a single minimum again with an error of 6 %
        while begin < count:
            yield range(begin, end)
            begin = end
            end = min(2 * end, count)

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether another minimum is unlikely enough."""
        searches = sum(run.converged for run in runs)
        return 1 - probability_of_no_other(searches, len(minima)) <= self.error


def probability_of_no_other(searches: int, minima: int) -> float:
    """Return the probability that this number of searches found all minima, see `FoundAgain`."""
    if searches <= minima + 1:
        return 0.0
    return math.prod((searches - 1 - i) / (searches - 1 + i) for i in range(1, minima + 1))


def agreeing_runs_of(
    nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
) -> tuple[int, ...]:
    """Return the indices of the runs that ended at the cost of the best minimum, within the noise of the data."""
    numbers = sum(part.numbers for part in nlp.parts)
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    return agreeing_runs(runs, minima, numbers=numbers, is_likelihood=is_likelihood)


ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

BATCHED = "batched"
SEARCHES = (BATCHED, "multistart")


@one_thread_at_a_time
def solver_for(
    nlp: CompiledProblem, options: Mapping[str, Any] = MappingProxyType({}), search: str = BATCHED
) -> LocalSolver:
    """Return the solver of a problem.

    Parts with hidden unknowns, such as records, are solved by Gauss-Newton steps or IPOPT, others by
    `ResponseSolver`, which compares the starts and improves many at once if the search is
    ``"batched"``.

    Raises
    ------
    ValueError
        For options that the solver does not take.
    """
    if not any(part.has_states for part in nlp.parts):
        return ResponseSolver(nlp, options, batched=search == BATCHED)
    if nlp.by_ipopt:
        return TranscribedProgram(nlp, GaussNewton(nlp), options)
    return GaussNewton(nlp, settings=with_options(nlp.strategies, options))


def multistart(
    nlp: CompiledProblem,
    solver: LocalSolver,
    starts: Array,
    *,
    progress: ProgressReport | None = None,
    movable: bool = True,
    executor: Executor | None = None,
    kept: KeptRuns | None = None,
    waves: Waves | None = None,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p) and group the runs into minima.

    The `waves` decide the order, and when there were enough; by default all starts are tried. A
    `movable` start moves to where the model is finite. All runs are stored; those from further
    starts (`greybox.solve.local_search`) follow. A run that fails is a result with its status, and
    never ranks before one that converged. When a stop is requested (`greybox.solve.interruption`),
    the current run is the last. With an executor its workers make the runs
    (`greybox.solve.executors`). Runs that were `kept` are not made again.
    """
    began = time.perf_counter()
    points: Array | FiniteStarts = starts
    if movable and nlp.strategies.moved_starts:
        points = FiniteStarts(nlp, solver, starts)
    memory = Memory() if kept is None else Memory(kept, packed(solver)[0])
    ended, finished = Ended(starts), 0
    waves = waves or AllAtOnce()
    screened = waves.screened(solver, starts) if movable else None
    many = movable and screened is None and len(starts) > 1
    shared = SharedRuns.of(solver) if many and isinstance(solver, GaussNewton) else None
    search = LocalSearch(nlp, solver, memory, shared, neighbors=len(starts) > 1)
    begins = {} if screened is None else dict(enumerate(screened.begins))
    runs, minima = ended.runs(), ()
    for wave in waves.numbers(len(starts), screened):
        for runner, numbers in _runners(solver, shared, wave):
            numbered = ((number, points[number]) for number in numbers)
            runs_made = run_all(runner, numbered, len(numbers), executor, memory, begins)
            for number, start, outcome in runs_made:
                ended.put(number, start, search.improved(outcome))
                finished += 1
                if progress is not None:
                    progress(finished, len(starts))
        further = zip(search.further_starts, search.further_outcomes, strict=True)
        for row, (start, outcome) in enumerate(further, len(starts)):
            ended.put(row, start, outcome)
        runs, minima = _certified(nlp, solver, ended)
        if stop_requested() or waves.are_enough(nlp, runs, minima):
            break

    rows = ended.rows
    nodes = ended.nodes[rows[minima[0].runs[0]]] if minima else None
    ends = () if minima else tuple(ended.nodes[row] for row in rows)
    if screened is not None and finished < len(starts) and not stop_requested():
        runs = ended.among_screened(runs, screened.costs)
        minima = tuple(replace(m, runs=tuple(rows[np.array(m.runs)].tolist())) for m in minima)
    return Multistart(runs, minima, time.perf_counter() - began, nodes, ends)


def _runners(
    solver: LocalSolver, shared: SharedRuns | None, wave: Sequence[int]
) -> Iterator[tuple[Runner, Sequence[int]]]:
    """Yield what makes the runs of a wave, with their numbers; the first start of all always runs alone.

    So a longer search includes what a search from the first start alone tries.
    """
    if shared is None:
        yield solver, wave
        return
    if wave[0] == 0:
        yield solver, wave[:1]
        wave = wave[1:]
        if stop_requested():
            return
    if wave:
        yield shared, wave


def _certified(
    nlp: CompiledProblem, solver: LocalSolver, ended: Ended
) -> tuple[Runs, tuple[Minimum, ...]]:
    """Return the runs that were made and their minima, each of them certified by the solver."""
    rows, runs = ended.rows, ended.runs()
    judged = solver.judged(runs.estimate)
    costs, signatures = judged or (runs.cost, [ended.signatures[row] for row in rows])
    runs = ended.runs(costs)
    while True:
        minima = find_minima(nlp, runs, signatures)
        changed = solver.certified(runs, minima)
        if not changed:
            return runs, minima
        for k, outcome in changed.items():
            ended.put(rows[k], runs.start[k], outcome)
            runs.cost[k] = outcome.cost
            signatures[k] = outcome.signature
        runs = ended.runs(runs.cost)


class FiniteStarts:
    """Starts (r, p) by number, where those without a finite model are moved toward the first with one.

    A start is moved when it is asked for, so that the first run does not wait for the last start.
    """

    def __init__(self, nlp: CompiledProblem, solver: LocalSolver, starts: Array) -> None:
        self._nlp, self._solver, self._starts = nlp, solver, starts

    @cached_property
    def _first(self) -> int | None:
        finite = (
            k
            for k, start in enumerate(self._starts)
            if stop_requested() or self._solver.is_finite_at(start)
        )
        return next(finite, None)

    def __getitem__(self, number: int) -> Array:
        start, first = self._starts[number], self._first
        if first is None or number == first:
            return start
        if number > first and self._solver.is_finite_at(start):
            return start

        # The farthest point on the way, halved up to six times, in the solver's variables.
        nlp = self._nlp
        home = nlp.scaling.to_solver(self._starts[first])
        away = nlp.scaling.to_solver(start) - home
        for halvings in range(1, 7):
            z = home + 0.5**halvings * away
            point = np.clip(nlp.scaling.to_parameters(z), nlp.lower, nlp.upper)
            if self._solver.is_finite_at(point):
                return point
        return start
