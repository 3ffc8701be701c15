"""Many runs of one compiled problem."""

import math
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.strategies import with_options
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import IpoptSolver
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
) -> Multistart:
    """Run the solver from every row of `starts` (r, p) and group the runs into minima.

    Starts that are `movable` go to where a run can begin. Every run is kept; runs from elsewhere, see
    `greybox.solve.local_search`, follow those of the starts. A run that fails is a result with its status; it is never
    ranked before one that converged.
    """
    began = time.perf_counter()
    if movable and nlp.strategies.moved_starts:
        starts = _moved_to_finite(nlp, solver, starts)
    search = LocalSearch(nlp, solver, neighbors=len(starts) > 1)
    outcomes = []
    for k, start in enumerate(starts):
        outcomes.append(search.run(start))
        if progress is not None:
            progress(k + 1, len(starts))
    outcomes = solver.judged([*outcomes, *search.further_outcomes])
    runs = _as_runs(np.vstack([starts, *search.further_starts]), outcomes)
    minima = find_minima(nlp, runs, [outcome.signature for outcome in outcomes])
    nodes = outcomes[minima[0].runs[0]].nodes if minima else None
    return Multistart(runs, minima, time.perf_counter() - began, nodes)


def _moved_to_finite(nlp: Nlp, solver: LocalSolver, starts: Array) -> Array:
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
