"""Many runs of one compiled problem."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.strategies import with_options
from greybox.files.arrays import Array
from greybox.modeling.one_thread import cached_property, one_thread_at_a_time
from greybox.solve.batched_solver import BatchedSolver
from greybox.solve.executors import packed, run_all
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns
from greybox.solve.interruption import stop_requested
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.local_search import LocalSearch
from greybox.solve.local_solver import LocalSolver, Runner
from greybox.solve.minima import Minimum, Multistart, find_minima
from greybox.solve.runs import Ended, Runs
from greybox.solve.transcribed_program import TranscribedProgram
from greybox.solve.waves import AllAtOnce, Waves

ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

BATCHED, MULTISTART, GLOBAL_SEARCH = "batched", "multistart", "global-search"
SEARCHES = (BATCHED, MULTISTART, GLOBAL_SEARCH)


@one_thread_at_a_time
def solver_for(
    nlp: CompiledProblem, options: Mapping[str, Any] = MappingProxyType({}), search: str = BATCHED
) -> LocalSolver:
    """Return the solver of a problem.

    Parts with hidden unknowns, such as records, are solved by Gauss-Newton steps or IPOPT, others by
    IPOPT. The search ``"batched"`` compares the starts first, and improves many at once where
    `BatchedSolver.serves`.

    Raises
    ------
    ValueError
        For options that the solver does not take.
    """
    if not any(part.has_states for part in nlp.parts):
        return BatchedSolver(nlp, options) if search == BATCHED else IpoptSolver(nlp, options)
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
