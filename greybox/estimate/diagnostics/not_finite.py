"""Where and why a model has no finite value: which response, state or output, and what helps."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.files.arrays import Array, IntArray
from greybox.modeling.integrators import Rosenbrock
from greybox.solve.ipopt import INVALID
from greybox.solve.minima import Multistart
from greybox.solve.runs import NOT_FINITE, Runs


@dataclass(frozen=True)
class Trouble:
    """A value that is not finite.

    Attributes
    ----------
    what : str
        The same words for all runs with this trouble.
    why, cure : str
        With time and values; empty where `what` says all.
    """

    what: str
    why: str = ""
    cure: str = ""


def explained(nlp: CompiledProblem, search: Multistart) -> Multistart:
    """Return the search with a reason for every run that met a value that is not finite."""
    reasons = search.runs.reason.copy()
    for run in _not_finite(search.runs):
        trouble = _trouble(nlp, run.start) or _trouble(nlp, run.estimate)
        reasons[run.index] = run.reason if trouble is None else trouble.what
    return replace(search, runs=replace(search.runs, reason=reasons))


def not_finite_warnings(nlp: CompiledProblem, search: Multistart) -> Iterator[str]:
    """Explain the first run that could not begin, where most runs failed."""
    # A few starts outside the domain of a formula are normal, and say nothing about the answer.
    failed = [run for run in _not_finite(search.runs) if run.reason]
    if failed and search.converged < 0.5 * len(search.brought):
        trouble = _trouble(nlp, failed[0].start)
        if trouble is not None and trouble.cure:
            yield f"at the start of run {failed[0].index} {trouble.why}: {trouble.cure}."


def _not_finite(runs: Runs) -> Runs:
    return runs[~runs.converged & ((runs.status == NOT_FINITE) | (runs.status == INVALID))]


def _trouble(nlp: CompiledProblem, x: Array) -> Trouble | None:
    """Return the trouble of the first part that has one at the parameters x (p,)."""
    if not np.all(np.isfinite(x)):
        return None
    z = nlp.scaling.to_solver(np.clip(x, nlp.lower, nlp.upper))
    with np.errstate(all="ignore"):
        troubles = (_trouble_of(part, z) for part in nlp.parts)
        return next((trouble for trouble in troubles if trouble is not None), None)


def _trouble_of(part: Part, z: Array) -> Trouble | None:
    """Return the trouble of a part at the solver's point z (p,)."""
    if isinstance(part, RecordPart):
        trajectory = part.initial_trajectory(z)
        return None if trajectory.finite else _located(part, trajectory)
    if not isinstance(part, ResponsePart):
        return None

    re, im = np.asarray(part.scaled_response(z)).reshape(2, -1)
    lost = ~(np.isfinite(re) & np.isfinite(im))
    if not lost.any():
        return None
    omega = part.data.omega[int(np.argmax(lost))]
    place = "any frequency" if lost.all() else f"omega = {omega:g} rad/s"

    return Trouble(f"no finite response at {place}")


def _located(part: RecordPart, trajectory: Trajectory) -> Trouble | None:
    """Look at the first states of the segments, at the integration, and at all samples."""
    # Formulas at the nodes first: they are given, while all other states follow from integration.
    samples = np.arange(part.data.samples)
    at_nodes = _of_formulas(part, trajectory, samples[:: part.data.segment_length])
    if at_nodes is not None:
        return at_nodes
    states_are_finite = np.all(np.isfinite(trajectory.states))
    if not (states_are_finite and np.all(np.isfinite(trajectory.ends))):
        return _of_integration(part, trajectory)
    return _of_formulas(part, trajectory, samples)


def _of_formulas(part: RecordPart, trajectory: Trajectory, samples: IntArray) -> Trouble | None:
    """Return the first derivative or output that is not finite at one of the samples."""
    system = part.system
    placed = trajectory.detail
    x, data = (
        part.segments.in_order(values)[:, samples] for values in (trajectory.states, placed.data)
    )
    _, u, _, residual, _ = (value.full() for value in part.step.measurement(x, placed.q, data))
    rows = {f"the output {name}": row for name, row in zip(part.outputs, residual, strict=True)}

    if part.states:
        slopes = system.derivative(x, u, placed.q[: len(system.parameters)]).full()
        names = [f"the derivative of {name}" for name in system.states]
        rows = dict(zip(names, slopes, strict=True)) | rows

    lost = ~np.isfinite([*rows.values()])
    if not lost.any():
        return None

    # The first sample: later values that are not finite follow from it.
    at = int(np.argmax(lost.any(axis=0)))
    what = [*rows][int(np.argmax(lost[:, at]))]
    point = zip((*system.states, *system.inputs), (*x[:, at], *u[:, at]), strict=True)
    values = ", ".join(f"{name} = {value:.4g}" for name, value in point)
    when = _time(part, int(samples[at]))
    place = f"at {when:.6g} s" if part.model.record.has_time else f"in row {when + 1:.0f}"

    return Trouble(what, f"{what} is not finite {place}, where {values}", _elsewhere(part))


def _of_integration(part: RecordPart, trajectory: Trajectory) -> Trouble:
    """Return the states that diverge between samples."""
    states = part.segments.in_order(trajectory.states).T
    within = states.reshape(len(trajectory.ends), -1, part.states)
    lost = ~np.isfinite(np.concatenate([within, trajectory.ends[:, None]], axis=1))
    segment, sample = (int(k) for k in np.argwhere(lost.any(axis=2))[0])
    diverged = zip(part.system.states, lost[segment, sample], strict=True)
    names = [name for name, is_lost in diverged if is_lost]
    when = _time(part, segment * part.data.segment_length + sample)

    cure = f"{_elsewhere(part)}, or use method=MultipleShooting(segment=2)"
    if not isinstance(part.model.method.scheme, Rosenbrock):
        cure += (
            "; if the model is stiff, with time constants far below a sample, use "
            "method=MultipleShooting(integrator=Rosenbrock())"
        )

    verb = "is" if len(names) == 1 else "are"
    joined = " and ".join(names)
    return Trouble(
        f"{joined}, simulated", f"{joined} {verb} no longer finite at {when:.6g} s", cure
    )


def _elsewhere(part: RecordPart) -> str:
    initial = (
        f", or give known states, initial={{{part.system.states[0]!r}: ...}}" if part.states else ""
    )
    label = part.problem.model.label
    return f"start elsewhere, or bound the parameters to where {label} has finite values{initial}"


def _time(part: RecordPart, column: int) -> float:
    """Return the time of a sample, or the number of a row, counted over all segments."""
    experiment, time = part.data, part.model.record.time
    times = [time[None, stretch.rows] for stretch in experiment.stretches]
    padded = experiment.padded(times, None)[0]
    return float(padded[min(column, len(padded) - 1)])
