"""A problem whose data are a record, compiled for Gauss-Newton steps: node states eliminated, parameters left."""

import itertools
import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.condensing import solve_chain
from greybox.compiled.initial_states import FirstStates, at_samples
from greybox.compiled.residual_covariance import Noise, eased, lessened, noise_of
from greybox.compiled.sample_step import SampleStep, sample_step
from greybox.compiled.sampled_data import Experiment, experiment
from greybox.compiled.sensitivities import Blocks, Shooting
from greybox.compiled.step_size import substeps_and_segment
from greybox.compiled.transcription.method import Transcription
from greybox.data.record import Record
from greybox.data.text_table import counted
from greybox.formulation.problem import Problem
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import Names
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import traced

Array = NDArray[np.float64]
LOOKS = 100  # samples at which the model is looked at before it is cut into segments
RIDGE = 1e-10  # on node states relative to their curvature: what no output shows keeps its value


@dataclass(frozen=True, eq=False)
class Place:
    """The part at one point of the solver: parameters q, their slope by the point, data, known initial states.

    Attributes
    ----------
    q : (declared,) array
    slope : (active, p) array
    data : (width, columns) array
    initial, initial_slope : (n,) and (n, active) arrays
        Known initial states and their derivatives by the active parameters; NaN where a state is unknown.
    """

    q: Array
    slope: Array
    data: Array
    initial: Array
    initial_slope: Array


@dataclass(frozen=True, eq=False)
class Path:
    """What follows from nodes (s, n): states (n, columns), ends (s, n), gaps (s, n), residual products (k, k).

    `followed` where the first node of every stretch was followed to its end: no other node counts.
    """

    nodes: Array
    states: Array
    end: Array
    gaps: Array
    products: Array
    followed: bool = False

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return bool(np.all(np.isfinite(self.gaps)) and np.all(np.isfinite(self.products)))


@dataclass(frozen=True, eq=False)
class Reduced:
    """The Gauss-Newton system of a part without its nodes, which move by `step` + `follow` · dq, dq = `slope` · dz.

    Attributes
    ----------
    hessian, gradient : (p, p) and (p,) arrays
    slope : (active, p) array
    step, follow : (s, n) and (s, n, active) arrays
    force, force_follow : (s, n) and (s, n, active) arrays
        Multipliers of the continuity, likewise.
    held : (s, n) array
        The damping of the nodes, by half the squares of their moves.
    """

    hessian: Array
    gradient: Array
    slope: Array
    step: Array
    follow: Array
    force: Array
    force_follow: Array
    held: Array


class RecordPart:
    """One record of a problem, with all functions that the estimators need."""

    def __init__(self, part: Problem, expressions: Mapping[str, Any], z: ca.SX, method: Transcription) -> None:
        """Compile for the point z, of which `expressions` gives every parameter of the problem by outside name."""
        assert isinstance(part.data, Record)
        assert isinstance(part.criterion, TimeCriterion)
        self.part, self.method = part, method
        self.record: Record = part.data
        self.criterion: TimeCriterion = part.criterion
        self.system: Dynamics = dynamics(part.model, delay_order(part.delay))
        self.outputs = self.criterion.compared(part.model, part.data)
        self._locate(part, expressions, z)
        whole = experiment(
            self.record,
            self.system.inputs,
            self.outputs,
            lead=_longest_delay(part, self.system),
            segment=1,
            complete=self.criterion.noise == "full",
        )
        self._first_states = FirstStates(self.system, self.outputs)
        seen = at_samples(whole, max(whole.segments // LOOKS, 1))
        known = lambda q: self.initial(q)[0].full().ravel()  # noqa: E731  (of one line and one use)
        substeps, segment = substeps_and_segment(part, method, self.system, self._first_states, seen, known)
        self.experiment: Experiment = replace(whole, segment=segment)
        self.substeps = substeps
        self.step: SampleStep = self._step(method.integrator, substeps)
        self.shooting = Shooting(self.step, self.experiment, self.active, method.compile)
        self.noise: Noise = noise_of(self.criterion, self.outputs, self.experiment.measured)
        self.first, self.coupled = self.experiment.first, self.experiment.coupled
        self.begins = self.experiment.begins
        self._nodes_see = at_samples(self.experiment, self.experiment.segment)

    def _step(self, integrator: Integrator, substeps: int) -> SampleStep:
        return sample_step(self.system, self.criterion, self.outputs, tuple(self.part.declared), integrator, substeps)

    def _locate(self, part: Problem, expressions: Mapping[str, Any], z: ca.SX) -> None:
        q = ca.vertcat(ca.SX(0, 1), *part.local_values(expressions).values())
        slope = ca.jacobian(q, z)
        self.active = np.array([i for i in range(q.numel()) if slope[i, :].nnz()], dtype=int)
        delay = self.system.delay(q[: len(self.system.parameters)])
        active = self.active.tolist()
        self.locate = ca.Function("locate", [z], [q, ca.densify(slope[active, :]), ca.densify(delay)])
        known, symbol = self.criterion.initial, ca.SX.sym("q", q.numel())
        local = Names(dict(zip(part.declared, ca.vertsplit(symbol), strict=True)), part.model.label)
        self.known_states = np.array([name in known for name in self.system.states], dtype=bool)
        initial = ca.vertcat(
            ca.SX(0, 1),
            *[_called(f"initial[{name!r}]", known.get(name, math.nan), local) for name in self.system.states],
        )
        by = ca.densify(ca.jacobian(initial, symbol[active]))
        self.initial = ca.Function("initial", [symbol], [initial, by])

    @cached_property
    def jumping(self) -> dict[str, tuple[str, str]]:
        """Parameters at whose whole samples the cost jumps, with the held input that is late and the output it reaches.

        The input reaches that output directly.
        """
        system, rename, found = self.system, self.part.rename, dict[str, tuple[str, str]]()
        if self.criterion.inputs != "held" or not system.delayed:
            return found
        x, u, p = (ca.SX.sym("v", len(v)) for v in (system.states, system.inputs, system.parameters))
        through, delay = ca.jacobian(system.output(x, u, p), u), system.delay(p)
        for i, j in itertools.product(range(u.numel()), range(p.numel())):
            shown = [name for k, name in enumerate(system.outputs) if through.has_nz(k, i) and name in self.outputs]
            if shown and ca.depends_on(delay[i], p[j]):
                found[rename.get(system.parameters[j], system.parameters[j])] = (system.inputs[i], shown[0])
        return found

    @property
    def words(self) -> str:
        """The method with what it chose."""
        scheme = type(self.method.integrator).__name__
        segment = counted(self.experiment.segment, "sample")
        return f"{self.method.label}, {segment} a segment, {scheme} {self.substeps} a sample"

    def thinned(self, samples: int) -> "RecordPart":
        """Return the same for some stretches, evenly over the record, of so many samples in all."""
        result = copy(self)
        result.experiment = self.experiment.thinned(samples)
        result.shooting = self.shooting.on(result.experiment)
        result.noise = noise_of(self.criterion, self.outputs, result.experiment.measured)
        result.first, result.coupled = result.experiment.first, result.experiment.coupled
        result.begins = result.experiment.begins
        result._nodes_see = at_samples(result.experiment, result.experiment.segment)
        return result

    def refined(self, factor: int, compiled: bool = True) -> "RecordPart":
        """Return the same with so many times as many substeps; not `compiled` for a look that no compiler is worth."""
        result = copy(self)
        result.substeps = factor * self.substeps
        result.step = self._step(self.method.integrator, result.substeps)
        result.shooting = Shooting(result.step, self.experiment, self.active, self.method.compile and compiled)
        return result

    @property
    def states(self) -> int:
        """Number of states."""
        return len(self.system.states)

    @property
    def unknown_initial(self) -> int:
        """Number of unknown initial states, of all stretches."""
        return int(self.first.sum()) * self.states - int(self.begins.sum()) * int(self.known_states.sum())

    def place(self, z: Array) -> Place:
        """Return the part at the point z (p,)."""
        q, slope, delay = (value.full() for value in self.locate(z))
        initial, by = (value.full() for value in self.initial(q))
        return Place(q.ravel(), slope, self.shooting.data(delay.ravel()), initial.ravel(), by)

    def first_nodes(self, place: Place) -> Array:
        """Return nodes (s, n) to begin with, see `greybox.compiled.initial_states`."""
        p = place.q[: len(self.system.parameters)]
        return self.pinned(self._first_states.at(*self._nodes_see, p, place.initial).T, place)

    def pinned(self, nodes: Array, place: Place) -> Array:
        """Return the nodes with the known initial states in them."""
        if not self.known_states.any():
            return nodes
        nodes = nodes.copy()
        rows = np.ix_(self.begins, self.known_states)
        nodes[rows] = place.initial[self.known_states]
        return nodes

    def path(self, nodes: Array, place: Place) -> Path:
        """Follow all segments from their nodes (s, n), known initial states put in."""
        nodes = self.pinned(nodes, place)
        states, end = self.shooting.paths(nodes, place.q, place.data)
        gaps = np.zeros_like(end)
        gaps[:-1] = end[:-1] - nodes[1:]
        gaps[~self.coupled] = 0
        residuals = self.shooting.residuals(states, place.q, place.data)
        return Path(nodes, states, end, gaps, residuals @ residuals.T)

    def lost(self, path: Path, place: Place) -> NDArray[np.bool_]:
        """Return which segments (s,) leave the domain of the model."""
        residuals = self.shooting.residuals(path.states, place.q, place.data)
        inside = np.isfinite(residuals).reshape(len(residuals), self.experiment.segment, -1).all(axis=(0, 1))
        return np.asarray(~(inside & np.isfinite(path.end).all(axis=1)))

    def linearize(self, path: Path, place: Place, weight: Array, moments: bool = False) -> Blocks:
        """Return the blocks, known initial states eliminated; with `moments` where the noise is estimated."""
        moments = moments and self.noise.known is None and len(self.outputs) > 1
        blocks = self.shooting.blocks(path.states, path.end, place.q, weight, place.data, moments)
        blocks = self._flexible(blocks)
        return self._without_known(blocks, place) if self.known_states.any() else blocks

    def _flexible(self, b: Blocks) -> Blocks:
        """Add variables t to the parameters, of the cost t²/2 - t · uᵀx: its least is -(uᵀx)²/2, see `flexibility`."""
        if b.moments is None:
            return b
        of_nodes, of_parameters = (self.noise.flexibility(m) for m in b.moments)
        r = of_parameters.shape[1]
        own = np.block([[b.own, -of_parameters], [-of_parameters.T, np.eye(r)]])
        still = np.zeros((*b.to_parameters.shape[:2], r))
        return replace(
            b,
            to_parameters=np.concatenate([b.to_parameters, still], axis=2),
            mixed=np.concatenate([b.mixed, -of_nodes], axis=2),
            own=own,
            slope=np.concatenate([b.slope, np.zeros(r)]),
        )

    def _without_known(self, b: Blocks, place: Place) -> Blocks:
        """Let known initial states follow the parameters: x = x' + (dx/dq) dq, of which x' does not move."""
        follow = np.where(self.known_states[:, None], place.initial_slope, 0.0)
        follow = np.pad(follow, ((0, 0), (0, b.mixed.shape[2] - follow.shape[1])))
        corner, mixed, gradient = b.corner.copy(), b.mixed.copy(), b.gradient.copy()
        to_state, to_parameters = b.to_state.copy(), b.to_parameters.copy()
        own, slope = b.own.copy(), b.slope.copy()
        for at in np.flatnonzero(self.begins):
            own += follow.T @ mixed[at] + mixed[at].T @ follow + follow.T @ corner[at] @ follow
            slope += follow.T @ gradient[at]
            mixed[at] += corner[at] @ follow
            to_parameters[at] += to_state[at] @ follow
            corner[at, self.known_states, :] = 0
            corner[at, :, self.known_states] = 0
            corner[at, self.known_states, self.known_states] = 1
            mixed[at, self.known_states] = 0
            gradient[at, self.known_states] = 0
            to_state[at, :, self.known_states] = 0
        return Blocks(b.end, to_state, to_parameters, corner, mixed, gradient, own, slope)

    def reduce(self, blocks: Blocks, place: Place, gaps: Array, soft: Array, damping: float = 0.0) -> Reduced:
        """Eliminate the nodes; `soft` (n,) is the variance by which continuity may be missed.

        Where it may be, `damping` holds the nodes, relative to their curvature (Levenberg-Marquardt).
        """
        mixed, B = blocks.mixed, blocks.to_parameters
        held = np.zeros_like(gaps)
        if damping and np.all(soft > 0):
            held = damping * self._curvature(blocks, soft)
            blocks = replace(blocks, corner=blocks.corner + held[:, :, None] * np.eye(self.states))
        right = -np.concatenate([blocks.gradient[:, :, None], mixed], axis=2)
        continuity = -np.concatenate([gaps[:, :, None], B], axis=2)
        x, force = self._solved(blocks, right, continuity, soft)
        linked = np.where(self.coupled[:, None, None], B, 0.0)
        both = np.tensordot(mixed, x, ((0, 1), (0, 1))) + np.tensordot(linked, force, ((0, 1), (0, 1)))
        hessian, gradient = blocks.own + both[:, 1:], blocks.slope + both[:, 0]
        q = place.slope.shape[0]
        if len(gradient) > q:
            follows = eased(hessian[q:, q:], np.concatenate([gradient[q:, None], hessian[q:, :q]], axis=1))
            gradient = gradient[:q] + hessian[:q, q:] @ follows[:, 0]
            hessian = lessened(hessian[:q, :q], -hessian[:q, q:] @ follows[:, 1:])
            x, force = (v[:, :, : 1 + q] + v[:, :, 1 + q :] @ follows for v in (x, force))
        return Reduced(
            hessian=place.slope.T @ ((hessian + hessian.T) / 2) @ place.slope,
            gradient=place.slope.T @ gradient,
            slope=place.slope,
            step=x[:, :, 0],
            follow=x[:, :, 1:],
            force=force[:, :, 0],
            force_follow=force[:, :, 1:],
            held=held,
        )

    def _curvature(self, blocks: Blocks, soft: Array) -> Array:
        """Return the second derivatives of outputs and missed continuity by every node state, (s, n)."""
        linked = np.where(self.coupled[:, None], (blocks.to_state**2 / soft[:, None]).sum(axis=1), 0.0)
        linked[1:] += np.where(self.coupled[:-1, None], 1 / soft, 0.0)
        return blocks.corner.diagonal(axis1=1, axis2=2) + linked

    def closing(self, blocks: Blocks, gaps: Array) -> Array:
        """Return the change of the nodes (s, n) that closes gaps (s, n) with the least change of the outputs."""
        nothing = np.zeros((*gaps.shape, 1 + blocks.mixed.shape[2]))  # as in `reduce`, whose factorization then serves
        wanted = nothing.copy()
        wanted[:, :, 0] = -gaps
        return self._solved(blocks, nothing, wanted, np.zeros(self.states))[0][:, :, 0]

    def _solved(self, blocks: Blocks, right: Array, continuity: Array, soft: Array) -> tuple[Array, Array]:
        """Solve the chain in units in which the curvature is one: nodes and multipliers are then of one size."""
        curvature = np.mean(blocks.corner.diagonal(axis1=1, axis2=2), axis=0)
        seen = curvature > 1e-30 * curvature.max(initial=0.0) + 1e-300
        unit = 1 / np.sqrt(np.where(seen, curvature, 1.0))
        corner = blocks.corner * unit * unit[:, None] + RIDGE * np.eye(self.states)
        transition, column = blocks.to_state * unit / unit[:, None], unit[:, None]
        x, force = solve_chain(corner, transition, self.coupled, right * column, continuity / column, soft / unit**2)
        return x * column, force / column

    def followed(self, nodes: Array, place: Place) -> Path:
        """Return the path from the first of the nodes (s, n) of every stretch to its end."""
        length = self.experiment.segment
        rows, nodes = self.shooting.rows(place.data), self.pinned(nodes, place)
        states, end = np.empty((len(rows), self.states)), np.empty_like(nodes)
        products, at = np.zeros((len(self.outputs), len(self.outputs))), 0
        for count in self.experiment.counts:
            some = slice(at * length, (at + count) * length)
            run, residuals = self.step.follow(nodes[at], place.q, rows[some])
            states[some], end[at : at + count] = run[:-1], run[length::length]
            products += residuals.T @ residuals
            at += count
        columns, gaps = self.shooting.columns(states.T), np.zeros_like(end)
        return Path(states[::length].copy(), columns, end, gaps, products, followed=True)

    def moved(self, nodes: Array, reduced: Reduced, dz: Array, length: float) -> Array:
        """Return the nodes after a step `dz` (p,), of which `length` is taken."""
        return nodes + length * (reduced.step + reduced.follow @ (reduced.slope @ dz))


def _called(what: str, value: Any, local: Names) -> Any:
    if not callable(value):
        return value
    try:
        return ca.SX(traced(what, value, local))
    except (AttributeError, KeyError, ArithmeticError) as error:
        raise ValueError(f"{what}: {error}") from error


def _longest_delay(part: Problem, system: Dynamics) -> Array:
    """Return the longest delay of every input within the bounds (m,), s; what is unbounded counts with its start."""
    if not system.delayed:
        return np.zeros(len(system.inputs))
    values: dict[str, float] = {}
    for name, p in part.parameters.items():
        high = p.bounds[1] if math.isfinite(p.bounds[1]) else max(p.box[1], p.start)
        values[name] = p.start if p.fixed or not math.isfinite(high) else high
    q = list(part.local_values(values).values())[: len(system.parameters)]
    return np.maximum(system.delay(q).full().ravel(), 0.0)
