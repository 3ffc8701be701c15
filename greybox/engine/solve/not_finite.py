"""Where and why a model has no finite value: which response, state or output, and what helps."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.wording import some
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.solve.minima import Multistart
from greybox.engine.solve.runs import NOT_FINITE, Run, Runs


@dataclass(frozen=True)
class Trouble:
    """A value that is not finite.

    Attributes
    ----------
    what : str
        The same words for all runs with this trouble.
    why, cure : str
        With time and values; empty where `what` is enough.
    """

    what: str
    why: str = ""
    cure: str = ""


def explained(nlp: CompiledProblem, search: Multistart) -> Multistart:
    """Return the search with a reason for every run that met a value that is not finite."""
    reasons = search.runs.reason.copy()
    for run in _not_finite(search.runs):
        if trouble := _trouble(nlp, run):
            reasons[run.index] = trouble.what
    return replace(search, runs=replace(search.runs, reason=reasons))


def not_finite_warnings(nlp: CompiledProblem, search: Multistart) -> Iterator[str]:
    """Explain the first run that could not begin, where most runs failed."""
    # A few starts outside the domain of a formula are normal, and say nothing about the answer.
    failed = [run for run in _not_finite(search.runs) if run.reason]
    if failed and search.converged < 0.5 * len(search.brought):
        trouble = _trouble(nlp, failed[0])
        if trouble and trouble.cure:
            yield f"at the start of run {failed[0].index} {trouble.why}: {trouble.cure}."
        elif not np.isfinite(search.runs.cost).any():
            yield (
                "no run reached a finite cost: give bounds that exclude values at which the model "
                "is not finite, such as those at which it divides by zero."
            )


def _not_finite(runs: Runs) -> Runs:
    is_lost = (runs.status == NOT_FINITE) | (runs.status == "Invalid_Number_Detected")  # by IPOPT
    return runs[~runs.converged & is_lost]


def _trouble(nlp: CompiledProblem, run: Run) -> Trouble | None:
    """Return the trouble of the first part that has one where a run began, or else ended."""
    # Screening moves starts, so a run may have begun elsewhere: then look at its end.
    points = [x for x in (run.start, run.estimate) if all_finite(x)]
    with np.errstate(all="ignore"):
        for x, part in itertools.product(points, nlp.parts):
            z = nlp.scaling.to_solver(np.clip(x, nlp.lower, nlp.upper))
            if trouble := _trouble_of(part, z):
                return trouble
    return None


def _trouble_of(part: Part, z: Array) -> Trouble | None:
    """Return the trouble of a part at the solver's point z (p,)."""
    if isinstance(part, RecordPart):
        trajectory = part.trajectory(z)
        return None if trajectory.finite else _of_record(part, trajectory)
    if not isinstance(part, ResponsePart):
        return None if part.trajectory(z).finite else Trouble("no finite response")

    re, im = np.asarray(part.scaled_response(z)).reshape(2, -1)
    lost = ~(np.isfinite(re) & np.isfinite(im))
    if not lost.any():
        return None
    omega = part.data.omega[np.argmax(lost)]
    place = "any frequency" if lost.all() else f"omega = {omega:g} rad/s"
    return Trouble(f"no finite response at {place}")


def _of_record(part: RecordPart, trajectory: Trajectory) -> Trouble | None:
    """Return the first derivative, output or simulated state that is not finite."""
    system, placed, sampled = part.system, trajectory.detail, part.data
    x = part.segments.in_order(trajectory.states)
    data = part.segments.in_order(placed.data)
    _, u, _, residual, _ = [matrix.full() for matrix in part.step.measurement(x, placed.q, data)]
    slopes = system.derivative(x, u, placed.q[: len(system.parameters)]).full()
    # A state is simulated to the next sample, also at the end of a segment.
    segments = len(trajectory.ends), sampled.segment_length, part.states
    within = x.T.reshape(segments)[:, 1:]
    later = np.hstack([within, trajectory.ends[:, None]]).reshape(x.T.shape).T

    # Later values that are not finite follow from the first.
    lost = ~np.isfinite(np.vstack([slopes, residual, later]))
    if not lost.any():
        return None
    at = np.argmax(lost.any(axis=0))
    first = np.argmax(lost[:, at])
    times = sampled.at_samples(part.model.record.time)
    label, method = part.problem.model.label, part.model.method
    cure = f"start elsewhere, or bound the parameters to where {label} has finite values"
    if part.states:
        cure += (
            f", or give known states, initial={{{system.states[0]!r}: ...}}, or guard roots, "
            "logarithms and quotients of states, as by gb.sqrt(gb.maximum(h, 0))"
        )

    names = [
        *(f"the derivative of {name}" for name in system.states),
        *(f"the output {name}" for name in part.outputs),
    ]
    if first < len(names):
        when = times[0, at]
        place = f"at {when:.6g} s" if part.model.record.has_time else f"in row {when + 1:.0f}"
        point = zip((*system.states, *system.inputs), (*x[:, at], *u[:, at]), strict=True)
        values = ", ".join(f"{name} = {value:.4g}" for name, value in point)
        return Trouble(names[first], f"{names[first]} is not finite {place}, where {values}", cure)

    cure += f", or use method=MultipleShooting(segment=2){method.other_cure}"
    diverged = [system.states[k] for k in np.flatnonzero(lost[len(names) :, at])]
    verb = "is" if len(diverged) == 1 else "are"
    joined = some(diverged)
    when = times[0, min(at + 1, times.size - 1)]
    why = f"{joined} {verb} no longer finite at {when:.6g} s"
    return Trouble(f"{joined}, simulated", why, cure)
