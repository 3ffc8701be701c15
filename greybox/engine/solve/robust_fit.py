"""Robust fits of records: least squares on pseudo-values, which follow from the last residuals."""

import math
from collections.abc import Sequence
from dataclasses import replace

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.solve.discretization_error import with_finer_steps
from greybox.engine.solve.local_solver import LocalSolver
from greybox.engine.solve.minima import Multistart
from greybox.engine.solve.search_method import solver_for

# Relative change of the cost between two fits that no standard error shows.
ROUNDING = 1e-9

# Fits of pseudo-values. Each reduces the distance from the robust estimate about ten times: a dozen
# usually suffices.
MOST_ROUNDS = 30


def with_robust_errors(search: Multistart, solver: LocalSolver) -> tuple[Multistart, LocalSolver]:
    """Return the search and the solver of the problem with pseudo-values instead of outliers."""
    measured = solver.nlp
    cost = math.nan
    for _ in range(MOST_ROUNDS if search.minima and _is_robust(measured) else 0):
        best = search.minima[0]
        if math.isclose(best.cost, cost, rel_tol=ROUNDING, abs_tol=ROUNDING):
            break
        cost = best.cost
        trajectories = solver.profile(best.estimate, search.nodes).trajectories
        solver = solver.with_problem(_pseudo_values(measured, trajectories))
        search = solver.polished(with_finer_steps(search, solver) or search)
    return search, solver


def with_pseudo_values(nlp: CompiledProblem, x: Array) -> CompiledProblem:
    """Return a problem with the pseudo-values of its robust estimate `x` (p,)."""
    moved = nlp
    cost = math.nan
    # Only the initial states remain to be fitted.
    for _ in range(MOST_ROUNDS if _is_robust(nlp) else 0):
        profile = solver_for(moved).profile(x)
        if math.isclose(profile.cost, cost, rel_tol=ROUNDING, abs_tol=ROUNDING):
            break
        cost = profile.cost
        moved = _pseudo_values(nlp, profile.trajectories)
    return moved


def _is_robust(nlp: CompiledProblem) -> bool:
    return any(part.has_bounded_errors for part in nlp.parts)


def _pseudo_values(nlp: CompiledProblem, trajectories: Sequence[Trajectory]) -> CompiledProblem:
    pairs = zip(nlp.parts, trajectories, strict=True)
    parts = (part.with_bounded_errors(trajectory) for part, trajectory in pairs)
    return replace(nlp, parts=tuple(parts))
