"""Why a fit failed although its runs ended at finite costs: what came closest, what blocks it, and what to try."""

from collections.abc import Iterator

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.estimate.covariance import assess, steepness
from greybox.estimate.diagnostics.identifiability import not_determined
from greybox.files.text_table import counted, listed
from greybox.solve.local_solver import LocalSolver, Profile
from greybox.solve.minima import Multistart, best_unfinished
from greybox.solve.outcome import CUT_SHORT, Run
from greybox.solve.transcribed_program import TranscribedProgram

# Standard errors that a minimum along one parameter alone must be away for the cost to count as
# falling there: a tenth is what "converged" allows.
STEEP = 0.1

# IPOPT's steps are not damped along initial states and parameters that the outputs hardly show.
UNDAMPED = (
    ", or leave out method: the steps of the default one are damped where the data determine little"
)

# Parameters named in a sentence, the steepest first.
NAMED = 4


def failure_warnings(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver
) -> Iterator[str]:
    """Say how close the best run came, which parameters block it, and what to try."""
    run = best_unfinished(search.runs)
    if run is None:
        return
    yield (
        f"run {run.index} came closest, cost {run.cost:.6g} after {counted(run.iterations, 'iteration')} "
        f"({run.status}); its values, no estimate and without errors, are in best_effort: {_cure(run)}"
        f"{UNDAMPED if isinstance(solver, TranscribedProgram) else ''}."
    )
    if run.status in CUT_SHORT:
        return
    profile = _end(search, solver, run)
    if profile is None:
        return
    accuracy = assess(nlp, run.estimate, profile.trajectories)
    if accuracy.at_bound:
        yield (
            f"{listed(accuracy.at_bound)} ended at a bound there: widen it if the physics allow, or fix the parameter."
        )
    yield from not_determined(nlp, accuracy)
    steep = steepness(nlp, run.estimate, profile.trajectories)
    steep[[name in accuracy.at_bound for name in nlp.free]] = 0
    order = [k for k in np.argsort(-steep)[:NAMED] if steep[k] > STEEP]
    if order:
        falls = listed([f"{nlp.free[k]} ({steep[k]:.2g})" for k in order])
        yield (
            f"the cost still falls there along {falls}, in parentheses how many of its standard errors further if all "
            "others stayed."
        )


def _cure(run: Run) -> str:
    """Return what to try after such an end."""
    status = run.status.lower().replace("_", " ")
    if run.status in CUT_SHORT[1:]:
        return "give it more time"
    if "iterations" in status or "relaxations" in status:
        return "give it more iterations, solver_options={'max_iter': ...}"
    return (
        "start elsewhere, narrow the start boxes, or fix parameters that the data do not determine"
    )


def _end(search: Multistart, solver: LocalSolver, run: Run) -> Profile | None:
    """Return the best trajectories at the end of a run; None where they are not known or not finite."""
    nodes = search.ends[run.index] if search.ends else None
    try:
        profile = solver.profile(run.estimate, nodes)
    except np.linalg.LinAlgError:
        return None
    known = nodes is not None or profile.converged
    return profile if known and all(t.finite for t in profile.trajectories) else None
