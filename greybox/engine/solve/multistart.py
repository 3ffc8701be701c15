"""Many runs of one compiled problem: the order of their starts, and their minima."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.solve.executors import run_all
from greybox.engine.solve.interruption import raise_interrupt, stop_requested
from greybox.engine.solve.local_solver import LocalSolver, Screened
from greybox.engine.solve.minima import Minimum, Multistart, agreeing_runs, find_minima
from greybox.engine.solve.other_minima import points_beside
from greybox.engine.solve.promising import Promising
from greybox.engine.solve.run_storage import Memory, RunStorage, continuation
from greybox.engine.solve.runs import (
    CUT_SHORT,
    NOT_FINITE,
    SCREENED,
    Outcome,
    Run,
    Runs,
    has_no_end,
    has_raised,
)
from greybox.modeling.cached_property import cached_property

ProgressReport = Callable[[int, int], Any]
"""Called with the number of finished and of all runs."""


def multistart(
    solver: LocalSolver,
    starts: Array,
    *,
    progress: ProgressReport | None = None,
    executor: Executor | None = None,
    storage: RunStorage | None = None,
    promising: Promising | None = None,
    beside: bool = False,
) -> Multistart:
    """Run the solver from all `starts` (r, p) and group the runs into minima.

    With `promising`, the solver first runs the most promising starts; the others follow if not
    enough of these agree. On the fits of the paper each of eight nearly always reaches the best
    minimum. With four of eight, as with three of four, the chance of an error is below 2 % if less
    than one start in six leads there.

    Then, with `beside`, other minima are looked for from the best one, see `other_minima`.

    Starts move to where the model is finite. Unfinished runs at a lower cost than all that
    converged are continued. All runs are stored. A run that fails is a result with its status, and
    never ranks before one that converged. When a stop is requested
    (`greybox.engine.solve.interruption`), the current run is the last. With an executor its workers
    make the runs (`greybox.engine.solve.executors`). Runs in the `storage` are not made again.

    Raises
    ------
    Exception
        If all runs raised an error: that of the first one.
    """
    # In 18 runs each, 16 instead of 8 end at the best minimum of the tanks, and 16 instead of 14 at
    # that of the conversion.
    points = FiniteStarts(solver, starts)
    memory = Memory(storage, solver)
    waves, screened = _waves(solver, starts, promising)

    results: dict[int, tuple[Array, Outcome]] = {}
    runs, minima, lowest = Runs.of(()), (), math.inf
    for wave in waves:
        numbered = ((number, points[number]) for number in wave)
        for number, start, ended in run_all(solver, numbered, len(wave), executor, memory):
            results[number] = start, ended
            if progress is not None:
                progress(len(results), len(starts))
        # A first run of a rod that was continued before the others took two thirds of the time of
        # the fit, for a cost that was never the lowest.
        for number in sorted(results.keys() & wave, key=lambda number: results[number][1].cost):
            start, ended = results[number]
            outcome = _continued(solver, ended, lowest, memory, number)
            results[number] = start, outcome
            lowest = min(lowest, outcome.cost) if outcome.converged else lowest
        results, runs, minima = _certified(solver, results)
        if stop_requested():
            break
        _require_a_run(solver, runs, len(starts))
        agreeing = len(agreeing_runs(solver.nlp, runs, minima))
        if promising and agreeing >= promising.agree:
            # Minima that these runs have missed take the places of starts that were not tried: the
            # last ones, since among equal minima the first start decides.
            untried = sorted({*range(len(starts))} - {*results}, reverse=True)
            others = points_beside(solver.nlp, minima[0].estimate) if beside else ()
            added = {k: (x, solver.near(x)) for k, x in zip(untried, others, strict=False)}
            if added:
                results, runs, minima = _certified(solver, results | added)
            break

    # Where nothing converged, a diagnosis needs the last states of every run.
    rows = [*results]
    nodes = results[rows[minima[0].runs[0]]][1].nodes if minima else None
    ends = () if minima else tuple(outcome.nodes for _, outcome in results.values())
    if screened is not None and not stop_requested():
        runs, minima = _with_screened(starts, screened, rows, runs, minima)
    return Multistart(runs, minima, nodes, ends)


def _waves(
    solver: LocalSolver, starts: Array, promising: Promising | None
) -> tuple[list[list[int]], Screened | None]:
    """Return the numbers of the starts in the waves in which they are run, and how they compare."""
    screened = None
    if promising and promising.runs[-1] < len(starts):
        screened = _screened(solver, starts)
    if promising is None or screened is None:
        return [[*range(len(starts))]], None

    *waves, rest = [wave.tolist() for wave in np.split(screened.order, promising.runs)]
    return [*waves, sorted(rest)], screened


def _with_screened(
    starts: Array,
    screened: Screened,
    rows: Sequence[int],
    runs: Runs,
    minima: tuple[Minimum, ...],
) -> tuple[Runs, tuple[Minimum, ...]]:
    """Return runs and minima with the starts that were only compared, so that they are counted.

    The runs are those of the starts of these `rows`.
    """
    by_row = dict(zip(rows, runs, strict=True))
    listed = Runs.of(
        replace(by_row[k], index=k)
        if k in by_row
        else Run(k, start, start, float(cost), SCREENED, converged=False, stage=SCREENED)
        for k, (start, cost) in enumerate(zip(starts, screened.costs, strict=True))
    )
    return listed, tuple(replace(m, runs=tuple(rows[k] for k in m.runs)) for m in minima)


def _require_a_run(solver: LocalSolver, runs: Runs, count: int) -> None:
    """Raise the error of the first run if all of the `count` runs raised one."""
    # What no start avoids is a fault of the problem, and no result.
    if len(runs) == count and all(map(has_raised, runs.status)):
        solver.run(runs[0].start)


def _screened(solver: LocalSolver, starts: Array) -> Screened | None:
    """Compare the starts (r, p), unless the model raises an error at one of them."""
    try:
        return solver.screened(starts)
    except Exception as error:
        raise_interrupt(error)
        return None


def _continued(
    solver: LocalSolver, outcome: Outcome, lowest: float, memory: Memory, number: int
) -> Outcome:
    """Return the run from the start of this number; continued if it is unfinished and lowest."""
    # A run that a time limit or Ctrl-C has cut short must not continue.
    has_ended = outcome.converged or outcome.status in (NOT_FINITE, *CUT_SHORT)
    if has_ended or has_no_end(outcome.status) or not outcome.cost < lowest or stop_requested():
        return outcome

    later = memory.recall(continuation(number), outcome.estimate)
    if later is None:
        later = solver.continued(outcome)
        memory.keep(continuation(number), outcome.estimate, later)
    return later


def _certified(
    solver: LocalSolver, results: Mapping[int, tuple[Array, Outcome]]
) -> tuple[dict[int, tuple[Array, Outcome]], Runs, tuple[Minimum, ...]]:
    """Return the runs, by row and in columns, and their minima, certified by the solver."""
    rows = sorted(results)
    starts = [results[row][0] for row in rows]
    outcomes = [results[row][1] for row in rows]
    # There is nothing to judge after Ctrl-C in the first run, nor where the model raises an error.
    ended = [k for k, outcome in enumerate(outcomes) if not has_no_end(outcome.status)]
    if ended:
        judged = solver.judged([outcomes[k] for k in ended])
        for k, outcome in zip(ended, judged, strict=True):
            outcomes[k] = outcome
    while True:
        pairs = [*zip(starts, outcomes, strict=True)]

        # A certified run may end lower, and change which runs share a minimum.
        runs = Runs.of(outcome.as_run(k, start) for k, (start, outcome) in enumerate(pairs))
        minima = find_minima(solver.nlp, runs, [outcome.signature for outcome in outcomes])
        changed = solver.certified(runs, minima)
        if not changed:
            return dict(zip(rows, pairs, strict=True)), runs, minima
        for k, outcome in changed.items():
            outcomes[k] = outcome


@frozen
class FiniteStarts:
    """Starts (p,) by number; those without a finite model move toward the first with one.

    A start is moved when it is asked for, so that the first run does not wait for the last start.
    """

    solver: LocalSolver
    starts: Array

    @cached_property
    def _home(self) -> Array | None:
        """Return the first start with a finite model."""
        finite = (s for s in self.starts if stop_requested() or self._is_finite_at(s))
        return next(finite, None)

    def _is_finite_at(self, start: Array, *, raised: bool = False) -> bool:
        """Return whether a run can begin at a start (p,), `raised` where the model raises."""
        try:
            return self.solver.is_finite_at(start)
        except Exception as error:
            raise_interrupt(error)
            return raised

    def __getitem__(self, number: int) -> Array:
        start = self.starts[number]
        # A run from where the model raises an error fails with that error.
        if self._is_finite_at(start, raised=True) or self._home is None:
            return start

        # The farthest point on the way, halved up to six times, in the solver's variables.
        nlp = self.solver.nlp
        home = nlp.scaling.to_solver(self._home)
        away = nlp.scaling.to_solver(start) - home
        for halvings in range(1, 7):
            point = nlp.estimate_at(home + 0.5**halvings * away)
            if self._is_finite_at(point):
                return point
        return start
