"""Many runs of one compiled problem."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.interruption import stop_requested
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.local_search import with_neighbors
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart, find_minima
from greybox.solve.outcome import Outcome, Run
from greybox.solve.transcribed_program import TranscribedProgram

Array = NDArray[np.float64]

ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

# Measured numbers up to which IPOPT continues runs that did not converge: 10 000 samples with three outputs, whose
# program builds in about three seconds (600 000 samples took 158 s, and the time grows faster than linearly).
TRANSCRIBED_SIZE = 30_000

# Shares of the way from a start at which the model is finite to one at which it is not, halved until it is.
SHARES = 0.5 ** np.arange(1, 7)


def solver_for(nlp: Nlp, options: Mapping[str, Any] = MappingProxyType({})) -> LocalSolver:
    """Return the solver of a problem: Gauss-Newton steps or IPOPT where parts have hidden unknowns, else IPOPT."""
    if not any(part.has_states for part in nlp.parts):
        return IpoptSolver(nlp, options)
    solver = GaussNewton(nlp)
    return TranscribedProgram(nlp, solver, options) if nlp.by_ipopt else solver


def multistart(
    nlp: Nlp,
    solver: LocalSolver,
    starts: Array,
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    progress: ProgressReport | None = None,
    movable: bool = True,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p), group the runs into minima, and polish the best.

    Starts that are `movable` go to where a run can begin. Every run is kept. A run that fails is a result with its
    status; it is never ranked before one that converged. When a stop is requested (`greybox.solve.interruption`) the
    run at hand is the last.
    """
    began = time.perf_counter()
    settings = nlp.strategies
    points: Iterable[Array] = starts
    if movable and settings.moved_starts:
        points = _moved_to_finite(nlp, solver, starts)
    tried: list[Array] = []
    outcomes = []
    for start in points:
        if stop_requested():
            break
        tried.append(start)
        outcomes.append(solver.run(start))
        if progress is not None:
            progress(len(tried), len(starts))

    starts = np.reshape(tried, (len(tried), len(nlp.free)))
    outcomes = solver.judged(outcomes) if outcomes else []
    if isinstance(solver, GaussNewton) and not stop_requested():
        if settings.ipopt_fallback and not any(outcome.converged for outcome in outcomes):
            outcomes = _continued_by_ipopt(nlp, solver, outcomes, solver_options)
        if len(starts) > 1 and settings.scaled_neighbors:
            starts, outcomes = with_neighbors(nlp, solver, starts, outcomes)
    runs = _as_runs(starts, outcomes)
    minima = solver.polished(find_minima(nlp, runs, [outcome.signature for outcome in outcomes]))
    nodes = outcomes[minima[0].runs[0]].nodes if minima else None
    return Multistart(runs, minima, time.perf_counter() - began, nodes)


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


def _continued_by_ipopt(
    nlp: Nlp, solver: GaussNewton, outcomes: list[Outcome], options: Mapping[str, Any]
) -> list[Outcome]:
    """Continue with IPOPT from the best ends where Gauss-Newton steps did not converge from any start."""
    settings = nlp.strategies
    ended = [k for k, outcome in enumerate(outcomes) if math.isfinite(outcome.cost)]
    best = sorted(ended, key=lambda k: outcomes[k].cost)[: settings.ipopt_runs]
    if not best or sum(part.numbers for part in nlp.parts) > TRANSCRIBED_SIZE:
        return outcomes
    ipopt = TranscribedProgram(nlp, solver, {"max_iter": settings.ipopt_iterations, **options})
    return [_continued(ipopt, o) if k in best else o for k, o in enumerate(outcomes)]


def _continued(ipopt: TranscribedProgram, before: Outcome) -> Outcome:
    """Return where IPOPT ends from the end of a run, or that run where IPOPT does not converge either."""
    after = ipopt.run(before.estimate)
    spent = {"iterations": before.iterations + after.iterations, "seconds": before.seconds + after.seconds}
    return replace(after if after.converged else before, **spent)


def _as_runs(starts: Array, outcomes: list[Outcome]) -> tuple[Run, ...]:
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
