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
from greybox.solve.interruption import Response, responding, stop_requested
from greybox.solve.ipopt import CONVERGED, INVALID, POLISH, IpoptSolver
from greybox.solve.local_search import with_neighbors
from greybox.solve.minima import Minimum, Multistart, find_minima
from greybox.solve.outcome import Outcome, Run
from greybox.solve.transcribed_program import TranscribedProgram

Array = NDArray[np.float64]

ProgressReport = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

AnySolver = IpoptSolver | GaussNewton | TranscribedProgram

# Measured numbers up to which IPOPT continues runs that did not converge: 10 000 samples with three outputs, whose
# program builds in about three seconds (600 000 samples took 158 s, and the time grows faster than linearly).
TRANSCRIBED_SIZE = 30_000

# Shares of the way from a start at which the model is finite to one at which it is not, halved until it is.
SHARES = 0.5 ** np.arange(1, 7)

# Relative cost above the best up to which a minimum is polished too: smoothing moves costs by 6e-5 and may change the
# order of close ones.
CLOSE = 1e-2


def multistart(
    nlp: Nlp,
    starts: Array,
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    progress: ProgressReport | None = None,
    movable: bool = True,
    gauss_newton: GaussNewton | None = None,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p), group the runs into minima, and polish the best.

    Starts that are `movable` go to where a model of records is finite; `gauss_newton` is the solver of these, if it was
    built before. Every run is kept. A run that fails is a result with its status; it is never ranked before one that
    converged. When a stop is requested (`greybox.solve.interruption`) the run at hand is the last.
    """
    began = time.perf_counter()
    solver = _solver(nlp, solver_options, gauss_newton)
    settings = nlp.strategies
    if movable and settings.moved_starts and not isinstance(solver, IpoptSolver):
        points: Iterable[Array] = _moved_to_finite(nlp, solver, starts)
    else:
        points = starts
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
    if isinstance(solver, GaussNewton) and not stop_requested():
        if settings.ipopt_fallback and not any(outcome.converged for outcome in outcomes):
            outcomes = _continued_by_ipopt(nlp, solver, outcomes, solver_options)
        if len(starts) > 1 and settings.scaled_neighbors:
            starts, outcomes = with_neighbors(nlp, solver, starts, outcomes)
    runs = _as_runs(nlp, starts, outcomes)
    minima = find_minima(nlp, runs, [outcome.signature for outcome in outcomes])
    if minima and isinstance(solver, IpoptSolver) and any(part.problem.criterion.smoothed for part in nlp.parts):
        minima = _polished(nlp, solver, minima)
    nodes = outcomes[minima[0].runs[0]].nodes if minima else None
    return Multistart(runs, minima, time.perf_counter() - began, nodes)


def _solver(nlp: Nlp, options: Mapping[str, Any], gauss_newton: GaussNewton | None) -> AnySolver:
    if not nlp.has_states:
        return IpoptSolver(nlp, options)
    gauss_newton = gauss_newton or GaussNewton(nlp)
    return TranscribedProgram(nlp, gauss_newton, options) if nlp.by_ipopt else gauss_newton


def _moved_to_finite(nlp: Nlp, solver: GaussNewton | TranscribedProgram, starts: Array) -> Iterator[Array]:
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


def _toward(nlp: Nlp, solver: GaussNewton | TranscribedProgram, start: Array, home: Array) -> Array:
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
    if not best or sum(part.data.samples * len(part.outputs) for part in nlp.record_parts) > TRANSCRIBED_SIZE:
        return outcomes
    ipopt = TranscribedProgram(nlp, solver, {"max_iter": settings.ipopt_iterations, **options})
    return [_continued(ipopt, o) if k in best else o for k, o in enumerate(outcomes)]


def _continued(ipopt: TranscribedProgram, before: Outcome) -> Outcome:
    """Return where IPOPT ends from the end of a run, or that run where IPOPT does not converge either."""
    after = ipopt.run(before.estimate)
    spent = {"iterations": before.iterations + after.iterations, "seconds": before.seconds + after.seconds}
    return replace(after if after.converged else before, **spent)


def _as_runs(nlp: Nlp, starts: Array, outcomes: list[Outcome]) -> tuple[Run, ...]:
    if nlp.has_states:
        costs = [outcome.cost for outcome in outcomes]
    else:
        costs = nlp.costs(np.array([outcome.estimate for outcome in outcomes])).tolist()
    reasons = _reasons(nlp, starts, outcomes)
    return tuple(
        Run(
            index=k,
            start=start,
            estimate=outcome.estimate,
            cost=float(cost),
            status=outcome.status,
            converged=outcome.converged and math.isfinite(cost),
            iterations=outcome.iterations,
            seconds=outcome.seconds,
            reason=reason,
        )
        for k, (start, outcome, cost, reason) in enumerate(zip(starts, outcomes, costs, reasons, strict=True))
    )


def _reasons(nlp: Nlp, starts: Array, outcomes: list[Outcome]) -> list[str]:
    """Say where the response is not finite, at the start or the end of every run that met an invalid number."""
    reasons = [""] * len(outcomes)
    failed = [k for k, outcome in enumerate(outcomes) if outcome.status == INVALID]
    labels = [f"{omega:g} rad/s" for part in nlp.response_parts for omega in part.problem.response.omega]
    for points in (starts, np.array([outcome.estimate for outcome in outcomes])):
        if not failed:
            break
        for k, row in zip(failed, np.isfinite(nlp.response_rows(points[failed])), strict=True):
            if not row.all():
                where = "any frequency" if not row.any() else f"omega = {labels[int(np.argmin(row))]}"
                reasons[k] = f"no finite response at {where}"
    return reasons


def _polished(nlp: Nlp, solver: IpoptSolver, minima: tuple[Minimum, ...]) -> tuple[Minimum, ...]:
    """Return the minima, those close to the best solved with ever less smoothing, best first.

    After Ctrl-C that is done for the best alone, which is the answer.
    """
    last = solver.polishing()
    close = minima[:1] if stop_requested() else [m for m in minima if m.cost <= (1 + CLOSE) * minima[0].cost]
    with responding(Response.FINISH):
        polished = [*(_polish(nlp, last, m) for m in close), *minima[len(close) :]]
    return tuple(sorted(polished, key=lambda m: m.cost))


def _polish(nlp: Nlp, solver: IpoptSolver, best: Minimum) -> Minimum:
    """Solve once more from a minimum with ever less smoothing; keep what is a solution and no worse."""
    for smoothing in POLISH:
        outcome = solver.run(best.estimate, smoothing)
        cost = float(nlp.costs(outcome.estimate[None])[0])
        if outcome.status not in CONVERGED or not cost <= best.cost:
            break
        best = replace(best, cost=cost, estimate=outcome.estimate)
    return best
