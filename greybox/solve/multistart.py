"""Many runs of one compiled problem."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.strategies import with_options
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
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

# Shares of the way from a start at which the model is finite to one at which it is not, halved
# until it is.
SHARES = 0.5 ** np.arange(1, 7)


BATCHED, MULTISTART, GLOBAL_SEARCH = "batched", "multistart", "global-search"
SEARCHES = (BATCHED, MULTISTART, GLOBAL_SEARCH)


@one_thread_at_a_time
def solver_for(
    nlp: CompiledProblem, options: Mapping[str, Any] = MappingProxyType({}), search: str = BATCHED
) -> LocalSolver:
    """Return the solver of a problem.

    That is Gauss-Newton steps or IPOPT where parts have hidden unknowns; else IPOPT. Where the
    search is ``"batched"`` that compares the starts first and is behind Newton's method from many
    of them at once, if the problem has the form.

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

    The `waves` say in which order, and when there were enough; by default all are tried. Starts
    that are `movable` go to where a run can begin. Every run is kept; runs from elsewhere, see
    `greybox.solve.local_search`, follow those of the starts. A run that fails is a result with its
    status; it is never ranked before one that converged. When a stop is requested
    (`greybox.solve.interruption`) the run at hand is the last. With an executor the runs from the
    starts are made by its workers, see `greybox.solve.executors`. Those that were `kept` are not
    made again.
    """
    began = time.perf_counter()
    points: Iterable[Array] = starts
    if movable and nlp.strategies.moved_starts:
        points = _moved_to_finite(nlp, solver, starts)
    memory = Memory() if kept is None else Memory(kept, packed(solver)[0])
    ended, done = Ended(starts), 0
    drawn = _Drawn(points, starts)
    waves = waves or AllAtOnce()
    screened = waves.screened(solver, starts) if movable else None
    many = movable and screened is None and len(starts) > 1
    shared = SharedRuns.of(solver) if many and isinstance(solver, GaussNewton) else None
    search = LocalSearch(nlp, solver, memory, shared, neighbors=len(starts) > 1)
    begins = {} if screened is None else dict(enumerate(screened.begins))
    runs, minima = ended.runs(), ()
    for wave in waves.numbers(len(starts), screened):
        each = _runners(solver, shared, wave)
        given = (
            (runner, ((number, drawn[number]) for number in part), len(part))
            for runner, part in each
        )
        made = (run_all(*some, executor, memory, begins) for some in given)
        for number, start, outcome in chain.from_iterable(made):
            ended.put(number, start, search.improved(outcome))
            done += 1
            if progress is not None:
                progress(done, len(starts))
        elsewhere = zip(search.further_starts, search.further_outcomes, strict=True)
        for row, (start, outcome) in enumerate(elsewhere, len(starts)):
            ended.put(row, start, outcome)
        runs, minima = _certified(nlp, solver, ended)
        if stop_requested() or waves.are_enough(nlp, runs, minima):
            break

    rows = ended.rows
    nodes = ended.nodes[rows[minima[0].runs[0]]] if minima else None
    ends = () if minima else tuple(ended.nodes[row] for row in rows)
    if screened is not None and done < len(starts) and not stop_requested():
        runs = ended.among_screened(runs, screened.costs)
        minima = tuple(replace(m, runs=tuple(rows[np.array(m.runs)].tolist())) for m in minima)
    return Multistart(runs, minima, time.perf_counter() - began, nodes, ends)


def _runners(
    solver: LocalSolver, shared: SharedRuns | None, wave: Sequence[int]
) -> Iterator[tuple[Runner, Sequence[int]]]:
    """Give what makes the runs of a wave, and their numbers; the first start of all is run alone in any case.

    A longer search then tries what one from the first start alone does.
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


class _Drawn:
    """Points (r, p) that are made one after the other, as far as they are asked for."""

    def __init__(self, points: Iterable[Array], like: Array) -> None:
        self._rest = iter(points)
        self._made, self._count = np.empty_like(like), 0

    def __getitem__(self, number: int) -> Array:
        while self._count <= number:
            self._made[self._count] = next(self._rest)
            self._count += 1
        return self._made[number]


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


def _moved_to_finite(nlp: CompiledProblem, solver: LocalSolver, starts: Array) -> Iterator[Array]:
    """Give the starts, those at which the model is not finite moved toward the first at which it is.

    One after the other, as the runs need them: of many starts the first run does not wait for the
    last.
    """
    first = next(
        (k for k, start in enumerate(starts) if stop_requested() or solver.is_finite_at(start)),
        None,
    )
    if first is None:
        yield from starts
        return
    home = nlp.scaling.to_solver(starts[first])
    for k, start in enumerate(starts):
        is_finite = k == first or (k > first and solver.is_finite_at(start))
        yield start if is_finite else _toward(nlp, solver, start, home)


def _toward(nlp: CompiledProblem, solver: LocalSolver, start: Array, home: Array) -> Array:
    """Return the farthest point from `home`, in the solver's variables, toward a start at which the model is finite."""
    away = nlp.scaling.to_solver(start) - home
    points = (
        np.clip(nlp.scaling.to_parameters(home + share * away), nlp.lower, nlp.upper)
        for share in SHARES
    )
    return next((point for point in points if solver.is_finite_at(point)), start)
