"""Many runs of one compiled problem."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.strategies import with_options
from greybox.solve.executors import packed, run_all
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.interruption import stop_requested
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.local_search import LocalSearch
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart, find_minima
from greybox.solve.outcome import Outcome, Run
from greybox.solve.transcribed_program import TranscribedProgram

Array = NDArray[np.float64]

ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

# Shares of the way from a start at which the model is finite to one at which it is not, halved until it is.
SHARES = 0.5 ** np.arange(1, 7)


def solver_for(nlp: Nlp, options: Mapping[str, Any] = MappingProxyType({})) -> LocalSolver:
    """Return the solver of a problem: Gauss-Newton steps or IPOPT where parts have hidden unknowns, else IPOPT.

    Raises
    ------
    ValueError
        For options that the solver does not take.
    """
    if not any(part.has_states for part in nlp.parts):
        return IpoptSolver(nlp, options)
    if nlp.by_ipopt:
        return TranscribedProgram(nlp, GaussNewton(nlp), options)
    return GaussNewton(nlp, settings=with_options(nlp.strategies, options))


def multistart(
    nlp: Nlp,
    solver: LocalSolver,
    starts: Array,
    progress: ProgressReport | None = None,
    movable: bool = True,
    executor: Executor | None = None,
    kept: KeptRuns | None = None,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p) and group the runs into minima.

    Starts that are `movable` go to where a run can begin. Every run is kept; runs from elsewhere, see
    `greybox.solve.local_search`, follow those of the starts. A run that fails is a result with its status; it is never
    ranked before one that converged. When a stop is requested (`greybox.solve.interruption`) the run at hand is the
    last. With an executor the runs from the starts are made by its workers, see `greybox.solve.executors`. Those that
    were `kept` are not made again.
    """
    began = time.perf_counter()
    points: Iterable[Array] = starts
    if movable and nlp.strategies.moved_starts:
        points = _moved_to_finite(nlp, solver, starts)
    memory = Memory() if kept is None else Memory(kept, packed(solver)[0])
    search = LocalSearch(nlp, solver, memory, neighbors=len(starts) > 1)
    tried: list[Array] = []
    outcomes = []
    for start, outcome in run_all(solver, points, len(starts), executor, memory):
        tried.append(start)
        outcomes.append(search.improved(outcome))
        if progress is not None:
            progress(len(tried), len(starts))

    outcomes = [*outcomes, *search.further_outcomes]
    outcomes = solver.judged(outcomes) if outcomes else []
    runs = _as_runs([*tried, *search.further_starts], outcomes)
    minima = find_minima(nlp, runs, [outcome.signature for outcome in outcomes])
    nodes = outcomes[minima[0].runs[0]].nodes if minima else None
    ends = () if minima else tuple(outcome.nodes for outcome in outcomes)
    return Multistart(runs, minima, time.perf_counter() - began, nodes, ends)


def _moved_to_finite(nlp: Nlp, solver: LocalSolver, starts: Array) -> Iterator[Array]:
    """Give the starts, those at which the model is not finite moved toward the first at which it is.

    One after the other, as the runs need them: of many starts the first run does not wait for the last.
    """
    first = next((k for k, start in enumerate(starts) if stop_requested() or solver.is_finite_at(start)), None)
    if first is None:
        yield from starts
        return
    home = nlp.scaling.to_solver(starts[first])
    for k, start in enumerate(starts):
        is_finite = k == first or (k > first and solver.is_finite_at(start))
        yield start if is_finite else _toward(nlp, solver, start, home)


def _toward(nlp: Nlp, solver: LocalSolver, start: Array, home: Array) -> Array:
    """Return the farthest point from `home`, in the solver's variables, toward a start at which the model is finite."""
    away = nlp.scaling.to_solver(start) - home
    points = (np.clip(nlp.scaling.to_parameters(home + share * away), nlp.lower, nlp.upper) for share in SHARES)
    return next((point for point in points if solver.is_finite_at(point)), start)


def _as_runs(starts: Sequence[Array], outcomes: list[Outcome]) -> tuple[Run, ...]:
    return tuple(
        Run(
            index=k,
            start=start,
            estimate=outcome.estimate,
            cost=float(outcome.cost),
            status=outcome.status,
            converged=outcome.converged and math.isfinite(outcome.cost),
            iterations=outcome.iterations,
            seconds=outcome.seconds,
        )
        for k, (start, outcome) in enumerate(zip(starts, outcomes, strict=True))
    )
