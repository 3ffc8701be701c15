"""Why a run met a value that is not finite: which response, state or output of the model, where, and what helps."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import singledispatch

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_part import RecordPart
from greybox.compiled.response_part import ResponsePart
from greybox.files.arrays import Array, IntArray
from greybox.modeling.integrators import Rosenbrock
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.ipopt import INVALID
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import Multistart
from greybox.solve.outcome import NOT_FINITE, Run
from greybox.solve.runs import Runs

NAMED = 4  # values of parameters in a sentence
EDGE = "next to where"  # of an end beyond which the model is not finite
FEW = 0.5  # share of converged runs below which a sentence is due


@dataclass(frozen=True)
class Trouble:
    """What is not finite.

    Attributes
    ----------
    what : str
        In a few words, the same for all runs with this trouble.
    why, cure : str
        With time and values; what helps. Empty where `what` says all.
    """

    what: str
    why: str = ""
    cure: str = ""


def explained(nlp: CompiledProblem, search: Multistart, solver: LocalSolver) -> Multistart:
    """Return the search with a reason for every run that met a value that is not finite, at its start or its end."""
    reasons = search.runs.reason.copy()
    for run in _candidates(search.runs):
        trouble = _trouble(nlp, run.start) or _trouble(nlp, run.estimate)
        reasons[run.index] = run.reason if trouble is None else trouble.what
    for run in search.runs if search.ends else ():
        trouble = None if reasons[run.index] else _beyond(nlp, solver, search, run)
        if trouble is not None:
            reasons[run.index] = f"{EDGE} {trouble.what.partition(',')[0]} is not finite"
    return replace(search, runs=replace(search.runs, reason=reasons))


def not_finite_warnings(
    nlp: CompiledProblem, search: Multistart, solver: LocalSolver
) -> Iterator[str]:
    """Say of the first run that could not begin why, where few runs converged; and of the first that met an edge."""
    stopped = next(
        (run for run in search.runs[search.runs.reason != ""] if run.reason.startswith(EDGE)), None
    )
    if stopped is not None:
        trouble = _beyond(nlp, solver, search, stopped)
        if trouble is not None and trouble.cure:
            yield f"run {stopped.index} ended {EDGE} {trouble.why}: {trouble.cure}."
    troubled = [run for run in _candidates(search.runs) if run.reason]
    if troubled and search.converged < FEW * len(search.brought):
        trouble = _trouble(nlp, troubled[0].start)
        if trouble is not None and trouble.cure:
            yield f"at {_values(nlp, troubled[0].start)} {trouble.why}: {trouble.cure}."


def _beyond(
    nlp: CompiledProblem, solver: LocalSolver, search: Multistart, run: Run
) -> Trouble | None:
    """Return what is not finite where the next step of an unfinished run leads."""
    nodes = search.ends[run.index]
    if nodes is None or not np.all(np.isfinite(run.estimate)):
        return None
    with np.errstate(all="ignore"):
        trajectories = solver.lost_beyond(run.estimate, nodes) or ()
        for part, trajectory in zip(nlp.parts, trajectories, strict=False):
            if isinstance(part, RecordPart) and not trajectory.finite:
                return _located(part, trajectory)
    return None


def _candidates(runs: Runs) -> Runs:
    return runs[~runs.converged & ((runs.status == NOT_FINITE) | (runs.status == INVALID))]


def _values(nlp: CompiledProblem, start: Array) -> str:
    declared = np.array([nlp.problem.parameters[name].start for name in nlp.free])
    if np.array_equal(start, declared):
        return "the declared values"
    said = [f"{name} = {value:.4g}" for name, value in zip(nlp.free, start, strict=True)]
    return ", ".join(said[:NAMED]) + (" ..." if len(said) > NAMED else "")


def _trouble(nlp: CompiledProblem, x: Array) -> Trouble | None:
    """Return what is not finite at the parameters x (p,), of the first part with which it is so."""
    if not np.all(np.isfinite(x)):
        return None
    z = nlp.scaling.to_solver(np.clip(x, nlp.lower, nlp.upper))
    with np.errstate(all="ignore"):
        return next(
            (trouble for part in nlp.parts if (trouble := trouble_of(part, z)) is not None), None
        )


@singledispatch
def trouble_of(part: Part, z: Array) -> Trouble | None:
    """Return what of a part is not finite at the solver's point z (p,)."""
    return None


@trouble_of.register
def _(part: ResponsePart, z: Array) -> Trouble | None:
    re, im = np.asarray(part.scaled_response(z)).reshape(2, -1)
    lost = ~(np.isfinite(re) & np.isfinite(im))
    if not lost.any():
        return None
    omega = part.data.omega[int(np.argmax(lost))]
    return Trouble(
        f"no finite response at {'any frequency' if lost.all() else f'omega = {omega:g} rad/s'}"
    )


@trouble_of.register
def _(part: RecordPart, z: Array) -> Trouble | None:
    trajectory = part.initial_trajectory(z)
    return None if trajectory.finite else _located(part, trajectory)


def _located(part: RecordPart, trajectory: Trajectory) -> Trouble | None:
    """Look at the states to begin with, at what follows from them, and at the formulas along it."""
    every, segment = np.arange(part.data.samples), part.data.segment_length
    diverged = not (
        np.all(np.isfinite(trajectory.detail.states)) and np.all(np.isfinite(trajectory.ends))
    )
    found = _of_model(part, trajectory, every[::segment])
    return found or (
        _of_integration(part, trajectory) if diverged else _of_model(part, trajectory, every)
    )


def _of_model(part: RecordPart, trajectory: Trajectory, samples: IntArray) -> Trouble | None:
    """Return the derivative or output that is not finite at one of the samples, if one is."""
    x, data = (
        part.segments.in_order(values)[:, samples]
        for values in (trajectory.detail.states, trajectory.detail.placed.data)
    )
    _, mean, _, residual, _ = (
        value.full() for value in part.step.measurement(x, trajectory.detail.placed.q, data)
    )
    p = trajectory.detail.placed.q[: len(part.system.parameters)]
    slopes = (
        part.system.derivative(x, mean, p).full() if part.states else np.zeros((0, len(samples)))
    )
    named = [
        (f"the derivative of {name}", row)
        for name, row in zip(part.system.states, slopes, strict=True)
    ]
    named += [(f"the output {name}", row) for name, row in zip(part.outputs, residual, strict=True)]
    lost = ~np.isfinite([row for _, row in named])
    if not lost.any():
        return None
    at = int(np.argmax(lost.any(axis=0)))
    what = named[int(np.argmax(lost[:, at]))][0]
    point = dict(
        zip((*part.system.states, *part.system.inputs), (*x[:, at], *mean[:, at]), strict=True)
    )
    where = ", ".join(f"{name} = {value:.4g}" for name, value in point.items())
    when = _time(part, int(samples[at]))
    place = f"at {when:.6g} s" if part.model.record.has_time else f"in row {when + 1:.0f}"
    return Trouble(what, f"{what} is not finite {place}, where {where}", _elsewhere(part))


def _of_integration(part: RecordPart, trajectory: Trajectory) -> Trouble:
    """Return the states that diverge between the samples, and whether the steps are too long for the model."""
    within = part.segments.in_order(trajectory.detail.states).T.reshape(
        len(trajectory.ends), -1, part.states
    )
    lost = ~np.isfinite(
        np.concatenate([within, trajectory.ends[:, None]], axis=1)
    )  # of every segment, samples and end
    segment, sample = (int(k) for k in np.argwhere(lost.any(axis=2))[0])
    at = segment * part.data.segment_length + sample
    names = " and ".join(
        name for name, row in zip(part.system.states, lost[segment, sample], strict=True) if row
    )
    step, fastest = float(part.data.steps.min()), _fastest_decay(part, trajectory)
    why = (
        f"{names} {'are' if ' and ' in names else 'is'} no longer finite at {_time(part, at):.6g} s"
    )
    integrator = part.model.method.scheme
    if fastest * step / part.substeps > integrator.reach and not isinstance(integrator, Rosenbrock):
        return Trouble(
            f"{names}, stiff",
            f"{why}, since a time constant of {1 / fastest:.2g} s is too short for {part.substeps} explicit steps in a "
            f"sample of {step:.3g} s",
            "use method=MultipleShooting(integrator=Rosenbrock()), or bound the parameters to slower models",
        )
    return Trouble(
        f"{names}, simulated", why, f"{_elsewhere(part)}, or use method=MultipleShooting(segment=2)"
    )


def _elsewhere(part: RecordPart) -> str:
    known = (
        f", or give known states, initial={{{part.system.states[0]!r}: ...}}" if part.states else ""
    )
    return f"start elsewhere, or bound the parameters to where {part.problem.model.label} has finite values{known}"


@one_thread_at_a_time
def _fastest_decay(part: RecordPart, trajectory: Trajectory) -> float:
    """Return the largest |pole| of those that decay, at the first states, rad/s; 0 where there is none."""
    if not part.states:
        return 0.0
    x, u, p = (
        ca.SX.sym("v", len(v))
        for v in (part.system.states, part.system.inputs, part.system.parameters)
    )
    slope = ca.Function(
        "A", [x, u, p], [ca.densify(ca.jacobian(part.system.derivative(x, u, p), x))]
    )
    data = part.segments.in_order(trajectory.detail.placed.data)[:, :: part.data.segment_length]
    some = np.unique(np.linspace(0, len(trajectory.nodes) - 1, 20).astype(int)).tolist()
    _, mean, *_ = part.step.measurement(
        trajectory.nodes.T[:, some], trajectory.detail.placed.q, data[:, some]
    )
    q, poles = trajectory.detail.placed.q[: p.numel()], [0.0]
    for k, nodes in enumerate(trajectory.nodes[some]):
        A = slope(nodes, mean[:, k], q).full()
        if np.all(np.isfinite(A)):
            poles += [abs(pole) for pole in np.linalg.eigvals(A) if pole.real < 0]
    return max(poles)


def _time(part: RecordPart, column: int) -> float:
    """Return the time of a sample, or the number of a row, counted over all segments."""
    experiment, time = part.data, part.model.record.time
    times = [time[None, stretch.rows] for stretch in experiment.stretches]
    padded = experiment.padded(times, None)[0]
    return float(padded[min(column, len(padded) - 1)])
