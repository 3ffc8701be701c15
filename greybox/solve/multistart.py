"""Many runs of one compiled problem."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import CONVERGED, INVALID, POLISH, Outcome, Run, Solver
from greybox.solve.local_search import hopped, simulated_first
from greybox.solve.minima import Minimum, Multistart, find_minima
from greybox.solve.transcribed_program import WholeProblem

Progress = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""

RESCUED, RESCUE_SIZE = 3, 30_000  # runs, and measured numbers, that IPOPT takes over
RESCUE = {"max_iter": 150}  # unless a user says more
SHARES = 0.5 ** np.arange(1, 7)  # of the way from a start that is finite to one that is not
CLOSE = 1e-2  # relative cost up to which a minimum is polished too: smoothing may change the order of close ones


def multistart(
    nlp: Nlp,
    starts: NDArray[np.float64],
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    progress: Progress | None = None,
    movable: bool = True,
) -> Multistart:
    """Run the solver from every row of `starts` (r, p), group the runs into minima, and polish the best.

    Starts that are `movable` go to where a model of records is finite. Every run is kept. A run that fails is a result
    with its status; it is never ranked before one that converged.
    """
    began = time.perf_counter()
    solver = _solver(nlp, solver_options)
    if movable and not isinstance(solver, Solver):
        starts = _finite(nlp, solver, starts)
    outcomes = []
    for k, start in enumerate(starts):
        outcomes.append(solver.run(start))
        if progress is not None:
            progress(k + 1, len(starts))
    if isinstance(solver, GaussNewton):
        if len(starts) > 1:
            starts, outcomes = simulated_first(nlp, solver, starts, outcomes)
        if not any(outcome.converged for outcome in outcomes):
            outcomes = _by_ipopt(nlp, outcomes, solver_options)
        if len(starts) > 1:
            starts, outcomes = hopped(nlp, solver, starts, outcomes)
    runs = _as_runs(nlp, starts, outcomes)
    minima = find_minima(nlp, runs, [outcome.trace for outcome in outcomes])
    if minima and isinstance(solver, Solver) and any(part.criterion.smoothed for part in nlp.problem.parts):
        last = solver.polishing()
        close = [m.cost <= (1 + CLOSE) * minima[0].cost for m in minima]
        minima = tuple(_polished(nlp, last, m) if near else m for m, near in zip(minima, close, strict=True))
        minima = tuple(sorted(minima, key=lambda m: m.cost))
    nodes = outcomes[minima[0].runs[0]].nodes if minima else None
    return Multistart(runs, minima, time.perf_counter() - began, nodes)


def _finite(nlp: Nlp, solver: GaussNewton | WholeProblem, starts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move starts at which the model is not finite toward the first at which it is, until it is there too."""
    begins = [solver.begins(start) for start in starts]
    if not any(begins):
        return starts
    starts, home = starts.copy(), nlp.scaling.to_solver(starts[begins.index(True)])
    for k in np.flatnonzero(np.logical_not(begins)):
        away = nlp.scaling.to_solver(starts[k]) - home
        for share in SHARES:
            point = np.clip(nlp.scaling.to_parameters(home + share * away), nlp.lower, nlp.upper)
            if solver.begins(point):
                starts[k] = point
                break
    return starts


def _by_ipopt(nlp: Nlp, outcomes: list[Outcome], options: Mapping[str, Any]) -> list[Outcome]:
    """Go on with IPOPT where Gauss-Newton steps did not converge from any start, from the best of their ends."""
    ended = [k for k, outcome in enumerate(outcomes) if math.isfinite(outcome.cost)]
    best = sorted(ended, key=lambda k: outcomes[k].cost)[:RESCUED]
    if not best or sum(part.experiment.measured.size for part in nlp.records) > RESCUE_SIZE:
        return outcomes
    solver = WholeProblem(nlp, {**RESCUE, **options})
    return [solver.run(o.estimate) if k in best else o for k, o in enumerate(outcomes)]


def _solver(nlp: Nlp, options: Mapping[str, Any]) -> Solver | GaussNewton | WholeProblem:
    if not nlp.records:
        return Solver(nlp, options)
    return WholeProblem(nlp, options) if nlp.records[0].method.by_ipopt else GaussNewton(nlp)


def _as_runs(nlp: Nlp, starts: NDArray[np.float64], outcomes: list[Outcome]) -> tuple[Run, ...]:
    if nlp.records:
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


def _reasons(nlp: Nlp, starts: NDArray[np.float64], outcomes: list[Outcome]) -> list[str]:
    """Say where the response is not finite, at the start or the end of every run that met an invalid number."""
    reasons = [""] * len(outcomes)
    failed = [k for k, outcome in enumerate(outcomes) if outcome.status == INVALID]
    labels = [f"{omega:g} rad/s" for part in nlp.responding for omega in part.response.omega]
    for points in (starts, np.array([outcome.estimate for outcome in outcomes])):
        if not failed:
            break
        for k, row in zip(failed, np.isfinite(nlp.response_rows(points[failed])), strict=True):
            if not row.all():
                where = "any frequency" if not row.any() else f"omega = {labels[int(np.argmin(row))]}"
                reasons[k] = f"no finite response at {where}"
    return reasons


def _polished(nlp: Nlp, solver: Solver, best: Minimum) -> Minimum:
    """Solve once more from a minimum with ever less smoothing; keep what is a solution and no worse."""
    for smoothing in POLISH:
        outcome = solver.run(best.estimate, smoothing)
        cost = float(nlp.costs(outcome.estimate[None])[0])
        if outcome.status not in CONVERGED or not cost <= best.cost:
            break
        best = replace(best, cost=cost, estimate=outcome.estimate)
    return best
