"""What came closest where no run converged, what blocks it, and what to try."""

from collections.abc import Iterator

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import assess
from greybox.estimate.diagnostics.identifiability import not_determined
from greybox.files.text_table import counted
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart, best_unfinished
from greybox.solve.runs import CUT_SHORT, Run


def failure_warnings(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver
) -> Iterator[str]:
    """Say how close the best run came, which parameters block it, and what to try."""
    run = best_unfinished(search.runs)
    if run is None:
        return

    yield (
        f"run {run.index} came closest, cost {run.cost:.6g} after "
        f"{counted(run.iterations, 'iteration')} ({run.status}); its values are no "
        f"estimate: {_cure(run)}."
    )
    # A run that was cut short says nothing about what blocks it.
    if run.status in CUT_SHORT:
        return
    nodes = search.ends[run.index] if search.ends else None
    try:
        profile = solver.profile(run.estimate, nodes)
        is_known = nodes is not None or profile.converged
        if not (is_known and all(t.finite for t in profile.trajectories)):
            return
        accuracy = assess(nlp, run.estimate, profile.trajectories)
    except np.linalg.LinAlgError:
        return

    for name in accuracy.at_bound:
        yield f"{name} ended at a bound in that run: widen it if the physics allow, or fix it."
    yield from not_determined(nlp, accuracy)


def _cure(run: Run) -> str:
    status = run.status.lower().replace("_", " ")
    if run.status in CUT_SHORT[1:]:
        return "give it more time"
    if "iterations" in status or "relaxations" in status:
        return "give it more iterations (the option max_iter of the solver)"
    return (
        "start elsewhere, narrow the start boxes, or fix parameters that the data do not determine"
    )
