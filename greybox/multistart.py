"""Many IPOPT runs of one compiled problem."""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.nlp import Nlp
from greybox.result import Minimum, Multistart, find_minima
from greybox.solve import CONVERGED, POLISH, Outcome, Run, Solver

Progress = Callable[[int, int], None]
"""Called with the number of finished and of all runs."""


def multistart(
    nlp: Nlp,
    starts: NDArray[np.float64],
    solver_options: Mapping[str, Any] = MappingProxyType({}),
    progress: Progress | None = None,
) -> Multistart:
    """Run IPOPT from every row of `starts` (r, p), group the runs into minima, and polish the best.

    Every run is kept. A run that fails is a result with its status; it is never ranked before one that converged.
    """
    began = time.perf_counter()
    solver = Solver(nlp, solver_options)
    outcomes = []
    for k, start in enumerate(starts):
        outcomes.append(solver.run(start))
        if progress is not None:
            progress(k + 1, len(starts))
    runs = _as_runs(nlp, starts, outcomes)
    minima = find_minima(nlp, runs)
    if minima and any(part.criterion.smoothed for part in nlp.problem.parts):
        minima = (_polished(nlp, solver, minima[0]), *minima[1:])
    return Multistart(runs, minima, time.perf_counter() - began)


def _as_runs(nlp: Nlp, starts: NDArray[np.float64], outcomes: list[Outcome]) -> tuple[Run, ...]:
    costs = nlp.costs(np.array([outcome.estimate for outcome in outcomes]))
    return tuple(
        Run(
            index=k,
            start=start,
            estimate=outcome.estimate,
            cost=float(cost),
            status=outcome.status,
            converged=outcome.status in CONVERGED and math.isfinite(cost),
            iterations=outcome.iterations,
            seconds=outcome.seconds,
        )
        for k, (start, outcome, cost) in enumerate(zip(starts, outcomes, costs, strict=True))
    )


def _polished(nlp: Nlp, solver: Solver, best: Minimum) -> Minimum:
    """Solve once more from the best minimum with almost no smoothing; keep a solution that is no worse."""
    for smoothing in POLISH:
        outcome = solver.run(best.estimate, smoothing)
        cost = float(nlp.costs(outcome.estimate[None])[0])
        if outcome.status not in CONVERGED or not cost <= best.cost:
            break
        best = replace(best, cost=cost, estimate=outcome.estimate)
    return best
