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
    built before. Every run is kept. A run that fails is a result
    with its status; it is never ranked before one that converged.
    """
    began = time.perf_counter()
    solver = _solver(nlp, solver_options, gauss_newton)
    settings = nlp.strategies
    if movable and settings.moved_starts and not isinstance(solver, IpoptSolver):
        starts = _moved_to_finite(nlp, solver, starts)
    outcomes = []
    for k, start in enumerate(starts):
        outcomes.append(solver.run(start))
        if progress is not None:
            progress(k + 1, len(starts))

    if isinstance(solver, GaussNewton):
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


def _moved_to_finite(nlp: Nlp, solver: GaussNewton | TranscribedProgram, starts: Array) -> Array:
    """Move starts at which the model is not finite toward the first at which it is, until it is there too."""
    finite = [solver.is_finite_at(start) for start in starts]
    if not any(finite):
        return starts
    starts = starts.copy()
    home = nlp.scaling.to_solver(starts[finite.index(True)])
    for k in np.flatnonzero(np.logical_not(finite)):
        away = nlp.scaling.to_solver(starts[k]) - home
        for share in SHARES:
            point = np.clip(nlp.scaling.to_parameters(home + share * away), nlp.lower, nlp.upper)
            if solver.is_finite_at(point):
                starts[k] = point
                break
    return starts


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
    """Return the minima, those close to the best solved with ever less smoothing, best first."""
    last = solver.polishing()
    close = [m.cost <= (1 + CLOSE) * minima[0].cost for m in minima]
    polished = [_polish(nlp, last, m) if near else m for m, near in zip(minima, close, strict=True)]
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
