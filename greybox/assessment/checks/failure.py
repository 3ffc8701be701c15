"""What came closest where no run converged, what blocks it, and what to try."""

import numpy as np

from greybox.assessment.checks.finding import Finding, Findings
from greybox.assessment.checks.not_determined import undetermined
from greybox.data.files.wording import counted
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.covariance.covariance import accuracy_at
from greybox.engine.solve.minima import best_unfinished
from greybox.engine.solve.runs import CUT_SHORT, Run
from greybox.engine.solve.search import Search


def failure(result: Search) -> Findings:
    """Say how close the best run came, which parameters block it, and what to try."""
    search, solver = result.found, result.solver
    run = best_unfinished(search.runs)
    if run is None:
        return

    yield Finding(
        f"run {run.index} came closest, cost {run.cost:.6g} after "
        f"{counted(run.iterations, 'iteration')} ({run.status}); its values are no "
        f"estimate: {_cure(run, solver.nlp)}."
    )
    # A run that was cut short says nothing about what blocks it.
    if run.status in CUT_SHORT:
        return
    nlp = solver.nlp
    limits = nlp.constraint(nlp.all_values(run.estimate)).full().ravel()
    for limit, value in zip(nlp.limits, limits, strict=True):
        if value < -1e-6:
            yield Finding(
                f"{limit} is {value:.3g} in that run and must be at least 0: check its sign, or "
                "whether any values within the bounds meet all constraints."
            )
    nodes = search.ends[run.index] if search.ends else None
    try:
        profile = solver.profile(run.estimate, nodes)
        is_known = nodes is not None or profile.converged
        if not (is_known and all(t.finite for t in profile.trajectories)):
            return
        accuracy = accuracy_at(nlp, run.estimate, profile.trajectories)
    except np.linalg.LinAlgError:
        return

    for name in accuracy.at_bound:
        yield Finding(
            f"{name} ended at a bound in that run: widen it if the physics allow, or fix it."
        )
    yield from undetermined(accuracy)


def _cure(run: Run, nlp: CompiledProblem) -> str:
    status = run.status.lower().replace("_", " ")
    if run.status in CUT_SHORT[1:]:
        return "give it more time"
    if "iterations" in status or "relaxations" in status:
        return "give it more iterations (the option max_iter of the solver)"
    cure = (
        "start elsewhere, narrow the start boxes, or fix parameters that the data do not determine"
    )
    records = nlp.parts_of(RecordPart)
    hidden = [part for part in records if part.unknown_initial_states > len(part.outputs)]
    if hidden:
        # As a chain of tanks, of which the last level alone is measured.
        state = hidden[0].system.states[0]
        cure += f", or give initial states that you know, OutputError(initial={{{state!r}: ...}})"
    return cure
