"""Many runs of one compiled problem: their solver, the order of their starts, and their minima."""

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
from greybox.solve.executors import run_all
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns
from greybox.solve.interruption import stop_requested
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.local_search import LocalSearch
from greybox.solve.local_solver import LocalSolver, Runner
from greybox.solve.minima import Minimum, Multistart, agreeing_runs, find_minima, zero_cost
from greybox.solve.response_solver import ResponseSolver
from greybox.solve.runs import SCREENED, Outcome, Run, Runs
from greybox.solve.transcribed_program import TranscribedProgram


def agreeing_runs_of(
    nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
) -> tuple[int, ...]:
    """Return the indices of the runs at the lowest cost, within the noise of the data."""
    numbers = sum(part.numbers for part in nlp.parts)
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    return agreeing_runs(
        runs, minima, numbers=numbers, is_likelihood=is_likelihood, zero=zero_cost(nlp)
    )


ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

BATCHED = "batched"
SEARCHES = (BATCHED, "multistart")


@one_thread_at_a_time
def solver_for(
    nlp: CompiledProblem, options: Mapping[str, Any] = MappingProxyType({}), search: str = BATCHED
) -> LocalSolver:
    """Return the solver of a problem.

    Parts with hidden unknowns, such as records, are solved by Gauss-Newton steps or IPOPT, others
    by `ResponseSolver`, which compares the starts and improves many at once if the search is
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
    promising: tuple[int, int] | None = None,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p) and group the runs into minima.

    With `promising`, so many starts are run first that the solver finds the most promising; the
    others follow if not enough of these, the second number, agree. On the fits of the paper each of
    eight nearly always reaches the best minimum. With four of eight, as with three of four, the
    chance of an error is below 2 % if less than one start in six leads there.

    A `movable` start moves to where the model is finite. All runs are stored; those from further
    starts (`greybox.solve.local_search`) follow. A run that fails is a result with its status, and
    never ranks before one that converged. When a stop is requested (`greybox.solve.interruption`),
    the current run is the last. With an executor its workers make the runs
    (`greybox.solve.executors`). Runs that were `kept` are not made again.
    """
    began = time.perf_counter()
    points: Array | FiniteStarts = starts
    if movable and nlp.strategies.moved_starts:
        points = FiniteStarts(nlp, solver, starts)
    memory = Memory() if kept is None else Memory(kept, solver.fingerprint)
    few, enough = promising or (len(starts), 0)
    screened = solver.screened(starts) if movable and few < len(starts) else None

    # Four screened runs, which begin near their ends, gain little from excerpts.
    many = movable and screened is None and len(starts) > 1
    shared = SharedRuns.of(solver) if many and isinstance(solver, GaussNewton) else None
    search = LocalSearch(nlp, solver, memory, shared, neighbors=len(starts) > 1)

    waves: list[Sequence[int]] = [range(len(starts))]
    begins: dict[int, Array] = {}
    if screened is not None:
        first = screened.order[:few].tolist()
        waves = [first, sorted(set(range(len(starts))) - set(first))]
        begins = dict(enumerate(screened.begins))

    results: dict[int, tuple[Array, Outcome]] = {}
    finished, runs, minima = 0, Runs.of(()), ()
    for wave in waves:
        for runner, numbers in _runners(solver, shared, wave):
            numbered = ((number, points[number]) for number in numbers)
            runs_made = run_all(runner, numbered, len(numbers), executor, memory, begins)
            for number, start, outcome in runs_made:
                results[number] = start, search.improved(outcome)
                finished += 1
                if progress is not None:
                    progress(finished, len(starts))
        results |= enumerate(search.further, len(starts))
        results, runs, minima = _certified(nlp, solver, results)
        if stop_requested() or len(agreeing_runs_of(nlp, runs, minima)) >= enough > 0:
            break

    # Where nothing converged, a diagnosis needs the last states of every run.
    rows = [*results]
    nodes = results[rows[minima[0].runs[0]]][1].nodes if minima else None
    ends = () if minima else tuple(outcome.nodes for _, outcome in results.values())
    if screened is not None and finished < len(starts) and not stop_requested():
        # Starts that were only compared are listed too, so that the answer counts them.
        listed = dict(zip(rows, runs, strict=True))
        for k in set(range(len(starts))) - set(results):
            cost = float(screened.costs[k])
            listed[k] = Run(
                k, starts[k], starts[k], cost, SCREENED, converged=False, stage=SCREENED
            )
        runs = Runs.of(replace(listed[k], index=k) for k in sorted(listed))
        minima = tuple(replace(m, runs=tuple(rows[k] for k in m.runs)) for m in minima)
    return Multistart(runs, minima, time.perf_counter() - began, nodes, ends)


def _runners(
    solver: LocalSolver, shared: SharedRuns | None, wave: Sequence[int]
) -> Iterator[tuple[Runner, Sequence[int]]]:
    """Yield what makes the runs of a wave, with their numbers.

    The first start of all always runs alone: a longer search then includes what a search from this
    start alone tries.
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
    nlp: CompiledProblem, solver: LocalSolver, results: Mapping[int, tuple[Array, Outcome]]
) -> tuple[dict[int, tuple[Array, Outcome]], Runs, tuple[Minimum, ...]]:
    """Return the runs, by row and in columns, and their minima, certified by the solver."""
    rows = sorted(results)
    starts = [results[row][0] for row in rows]
    outcomes = [results[row][1] for row in rows]
    judged = solver.judged(np.array([outcome.estimate for outcome in outcomes]))
    if judged is not None:
        outcomes = [
            replace(outcome, cost=cost, signature=signature)
            for outcome, cost, signature in zip(
                outcomes, judged[0].tolist(), judged[1], strict=True
            )
        ]
    while True:
        pairs = zip(starts, outcomes, strict=True)

        # A certified run may end lower, and change which runs share a minimum.
        runs = Runs.of(outcome.as_run(k, start) for k, (start, outcome) in enumerate(pairs))
        minima = find_minima(nlp, runs, [outcome.signature for outcome in outcomes])
        changed = solver.certified(runs, minima)
        if not changed:
            return dict(zip(rows, zip(starts, outcomes, strict=True), strict=True)), runs, minima
        for k, outcome in changed.items():
            outcomes[k] = outcome


class FiniteStarts:
    """Starts (r, p) by number; those without a finite model move toward the first with one.

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
