"""A record with its model, compiled: nodes, trajectories, their linearization, and what they say of the parameters."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from greybox.compiled.condensing import solve_continuity
from greybox.compiled.initial_states import InitialStates, at_samples
from greybox.compiled.part import ColoredErrors, Condensed, Information, Part, Program, Trajectory
from greybox.compiled.record_information import colored_errors, independent_numbers
from greybox.compiled.residual_covariance import (
    ResidualCovariance,
    followed_by_covariance,
    reduced_hessian,
    residual_covariance_of,
)
from greybox.compiled.sample_step import SampleStep, sample_step
from greybox.compiled.sampled_data import SampledData, sampled_data
from greybox.compiled.segments import Linearization, Segments
from greybox.compiled.step_size import substeps_and_segment
from greybox.compiled.strategies import Strategies
from greybox.compiled.transcription.method import Transcription
from greybox.data.intersample import Intersample
from greybox.data.record import Record
from greybox.formulation.input_assumptions import between_samples
from greybox.formulation.problem import Problem
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import Names
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import traced

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Placed:
    """The parameters of a record at one point z of the solver.

    Attributes
    ----------
    q : (declared,) array
        Values of all declared parameters.
    slope : (active, p) array
        Derivatives of the estimated ones by z.
    data : (width, columns) array
        The data, with the inputs placed for these delays.
    initial, initial_slope : (n,) and (n, active) arrays
        Known initial states and their derivatives by the active parameters; NaN where a state is unknown.
    """

    q: Array
    slope: Array
    data: Array
    initial: Array
    initial_slope: Array


@dataclass(frozen=True, eq=False)
class Along:
    """What a trajectory of a record knows besides its nodes: where it is placed, and its states (n, columns)."""

    placed: Placed
    states: Array


@dataclass(frozen=True, eq=False)
class RecordModel:
    """What a record and its model are, whatever the cut into segments and the substeps.

    Problem, record and criterion stay where they were compiled when this is pickled: solvers need the rest alone.

    Attributes
    ----------
    system : Dynamics
        Its delays include by how much interpolated inputs come late.
    between : tuple of Intersample
        How each input runs between its samples.
    parameters, outside_names : tuple of str
        The declared parameters, by the model's names and the problem's.
    gains : tuple of (str, str)
        State and output of every estimated entry of the Kalman gain.
    active : (q,) array
        Places of the estimated parameters among the declared ones.
    locate : casadi.Function
        (z) -> values of the declared parameters, derivatives of the active ones by z, delays.
    initial : casadi.Function
        (declared parameters) -> known initial states, and their derivatives by the active parameters.
    known_states : (n,) bool array
    """

    problem: Problem
    record: Record
    criterion: TimeCriterion
    method: Transcription
    system: Dynamics
    between: tuple[Intersample, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outside_names: tuple[str, ...]
    gains: tuple[tuple[str, str], ...]
    active: NDArray[np.integer]
    locate: ca.Function
    initial: ca.Function
    known_states: NDArray[np.bool_]
    initial_states: InitialStates

    def __getstate__(self) -> dict[str, Any]:
        """Leave behind what may be of the user's classes."""
        left = ("problem", "record", "criterion")
        return {name: value for name, value in vars(self).items() if name not in left}

    @property
    def strategies(self) -> Strategies:
        """The settings of the solver."""
        return self.method.strategies

    def with_inputs(self, between: tuple[Intersample, ...]) -> "RecordModel":
        """Return the same with inputs that run otherwise between their samples."""
        later = [new.late - now.late for new, now in zip(between, self.between, strict=True)]
        z = ca.SX.sym("z", self.locate.numel_in(0))
        q, slope, delay = self.locate(z)
        return replace(
            self,
            between=between,
            system=self.system.later(later),
            locate=ca.Function("locate", [z], [q, slope, delay + ca.DM(later)]),
        )

    def step(self, integrator: Integrator, substeps: int) -> SampleStep:
        """Compile one sample."""
        held = tuple(between.held for between in self.between)
        return sample_step(self.system, held, self.criterion, self.outputs, self.parameters, integrator, substeps)


class RecordPart(Part):
    """One record of a problem: a model, the data cut into segments, and the step from sample to sample."""

    def __init__(
        self,
        model: RecordModel,
        data: SampledData,
        substeps: int,
        *,
        step: SampleStep | None = None,
        compile_linearization: bool = False,
    ) -> None:
        """Build the functions; `step`, if given, has the same substeps."""
        super().__init__(model.problem)
        self.model = model
        self.data = data
        self._substeps = substeps
        self.step = step or model.step(model.method.scheme, substeps)
        self.segments = Segments(self.step, data.segments, data.segment_length, model.active, compile_linearization)
        self._measured = self.segments.columns(_measured_rows(data))
        self._placed_data: tuple[tuple[float, ...], Array] | None = None
        self.covariance: ResidualCovariance = residual_covariance_of(model.criterion, model.outputs, data.measured)
        self.system: Dynamics = model.system
        self.outputs = model.outputs
        self.states = len(model.system.states)
        self._at_nodes = at_samples(data, data.segment_length)

    def excerpt(self, samples: int) -> "RecordPart":
        """Return the part on excerpts, evenly over the record, of about so many samples in all."""
        return RecordPart(self.model, self.data.excerpts(samples), self.substeps, step=self.step)

    def with_inputs(self, between: tuple[Intersample, ...]) -> "RecordPart":
        """Return the part with inputs that run otherwise between their samples."""
        return RecordPart(self.model.with_inputs(between), self.data, self.substeps)

    def refined(self, factor: int, *, compiled: bool = True) -> "RecordPart":
        """Return the part with `factor` times the substeps; not `compiled` for a look that no compiler is worth."""
        compile_linearization = self.model.method.compile and compiled
        return RecordPart(self.model, self.data, factor * self.substeps, compile_linearization=compile_linearization)

    # --- facts --------------------------------------------------------------------------------------------------------

    @property
    def has_states(self) -> bool:
        """A record has nodes."""
        return True

    @property
    def samples(self) -> int:
        """All that are simulated, padding of segments included."""
        return self.data.samples

    @property
    def substeps(self) -> int:
        """Steps of the integrator in a sample."""
        return self._substeps

    @property
    def numbers(self) -> int:
        """Measured values that are compared."""
        return int(self.covariance.counts.sum())

    @property
    def unknown_initial_states(self) -> int:
        """Unknown initial states of all stretches."""
        known = int(self.data.begins_record.sum()) * int(self.model.known_states.sum())
        return int(self.data.begins_stretch.sum()) * self.states - known

    @property
    def gains(self) -> tuple[tuple[str, str], ...]:
        """State and output of every estimated entry of the Kalman gain."""
        return self.model.gains

    @cached_property
    def discontinuous_delays(self) -> Mapping[str, tuple[str, str]]:
        """Delays at whose whole samples the cost jumps: a held input reaches an output directly."""
        system = self.system
        result: dict[str, tuple[str, str]] = {}
        held = [between.held for between in self.model.between]
        if not any(held) or not system.delayed:
            return result
        x, u, p = (ca.SX.sym("v", len(v)) for v in (system.states, system.inputs, system.parameters))
        feedthrough = ca.jacobian(system.output(x, u, p), u)
        delay = system.delay(p)
        for i, j in itertools.product(range(u.numel()), range(p.numel())):
            reached = [n for k, n in enumerate(system.outputs) if feedthrough.has_nz(k, i) and n in self.outputs]
            if held[i] and reached and ca.depends_on(delay[i], p[j]):
                name = self.model.outside_names[self.model.parameters.index(system.parameters[j])]
                result[name] = (system.inputs[i], reached[0])
        return result

    @property
    def description(self) -> str:
        """The method, with the segments and steps that were chosen."""
        return self.model.method.described(self.data.segment_length, self.substeps)

    # --- trajectories -------------------------------------------------------------------------------------------------

    def place(self, z: Array) -> Placed:
        """Return the parameters and the data at z (p,)."""
        q, slope, delay = (value.full() for value in self.model.locate(z))
        initial, initial_slope = (value.full() for value in self.model.initial(q))
        return Placed(q.ravel(), slope, self._data_at(delay.ravel()), initial.ravel(), initial_slope)

    def _data_at(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), inputs placed for these delays (m,).

        The same array as the last time, as long as no delay has passed a whole sample.
        """
        steps = [stretch.step for stretch in self.data.stretches]
        whole = tuple(np.floor(np.asarray(delays)[:, None] / steps + 1e-9).ravel())
        if self._placed_data is None or self._placed_data[0] != whole:
            inputs = self.segments.columns(np.vstack(self.data.delayed_inputs(delays)))
            self._placed_data = (whole, np.vstack([inputs, self._measured]))
        return self._placed_data[1]

    def initial_trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory at z (p,) with nodes from the data, see `greybox.compiled.initial_states`."""
        placed = self.place(z)
        p = placed.q[: len(self.system.parameters)]
        nodes = self.model.initial_states.at(*self._at_nodes, p, placed.initial).T
        return self._trajectory(z, nodes, placed)

    def trajectory(self, z: Array, nodes: Array, *, simulated: bool = False) -> Trajectory:
        """Return the trajectory at z (p,) from nodes (s, n); `simulated` from the first one of every stretch alone."""
        placed = self.place(z)
        return self._simulated(z, nodes, placed) if simulated else self._trajectory(z, nodes, placed)

    def _trajectory(self, z: Array, nodes: Array, placed: Placed) -> Trajectory:
        nodes = self._with_known_states(nodes, placed)
        states, ends = self.segments.simulate(nodes, placed.q, placed.data)
        gaps = np.zeros_like(ends)
        gaps[:-1] = ends[:-1] - nodes[1:]
        gaps[~self.data.coupled] = 0
        residuals = self.segments.residuals(states, placed.q, placed.data)
        products = residuals @ residuals.T
        return Trajectory(z, nodes, ends, gaps, products, simulated=False, detail=Along(placed, states))

    def _simulated(self, z: Array, nodes: Array, placed: Placed) -> Trajectory:
        nodes = self._with_known_states(nodes, placed)
        nodes, states, ends, products = self.segments.simulate_stretches(
            self.data.segment_counts, nodes, placed.q, placed.data
        )
        gaps = np.zeros_like(ends)
        return Trajectory(z, nodes, ends, gaps, products, simulated=True, detail=Along(placed, states))

    def _with_known_states(self, nodes: Array, placed: Placed) -> Array:
        """Return the nodes with the known initial states in them."""
        known = self.model.known_states
        if not known.any():
            return nodes
        nodes = nodes.copy()
        nodes[np.ix_(self.data.begins_record, known)] = placed.initial[known]
        return nodes

    def residuals(self, trajectory: Trajectory) -> Array:
        """Return measured less simulated outputs (k, samples) in the order of the samples, zero where missing."""
        along = trajectory.detail
        return self.segments.in_order(self.segments.residuals(along.states, along.placed.q, along.placed.data))

    def simulated_outputs(self, trajectory: Trajectory) -> Array:
        """Return the outputs (k, samples) along a trajectory, in the order of the samples."""
        along = trajectory.detail
        return self.segments.in_order(self.segments.outputs(along.states, along.placed.q, along.placed.data))

    def is_near_data(self, trajectory: Trajectory, factor: float) -> bool:
        """Tell whether the rms of the residuals of every output is below `factor` times the spread of its signal."""
        limit = self.covariance.counts * (factor * self.covariance.spread) ** 2
        return bool(np.all(np.diag(trajectory.products) <= limit))

    def signature(self, trajectory: Trajectory) -> Array:
        """Return up to some 500 simulated samples of every output, in units of the measured signal's spread."""
        along = trajectory.detail
        columns = slice(None, None, max(along.placed.data.shape[1] // 500, 1))
        outputs = self.segments.outputs(along.states[:, columns], along.placed.q, along.placed.data[:, columns])
        return (outputs / self.covariance.spread[:, None]).ravel()

    # --- cost ---------------------------------------------------------------------------------------------------------

    def cost(self, trajectory: Trajectory, smoothing: float = 0.0) -> float:
        """Return the negative log-likelihood of the residuals along a trajectory."""
        return self.covariance.cost(trajectory.products)

    def squared_cost(self, trajectory: Trajectory, weight: Array, smoothing: float) -> float:
        """Return half the sum of squares of the residuals times `weight`."""
        return float(np.trace(weight @ trajectory.products @ weight.T)) / 2

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return W (k, k) with WᵀW the inverse of the residual covariance along a trajectory."""
        return self.covariance.weight(trajectory.products)

    def initial_weight(self, share: float) -> Array:
        """Return W (k, k) for residuals of a `share` of each signal's spread."""
        return np.diag(1 / (share * self.covariance.spread))

    # --- linearization ------------------------------------------------------------------------------------------------

    def linearize(self, trajectory: Trajectory, weight: Array, *, covariance_curvature: bool = False) -> Linearization:
        """Linearize along a trajectory, known initial states eliminated."""
        moments = covariance_curvature and self.covariance.known is None and len(self.outputs) > 1
        placed = trajectory.detail.placed
        result = self.segments.linearize(trajectory.detail.states, placed.q, weight, placed.data, moments=moments)
        if result.moments is not None:
            result = self._with_covariance(result)
        return self._without_known_states(result, placed) if self.model.known_states.any() else result

    def _with_covariance(self, b: Linearization) -> Linearization:
        """Let the covariance follow: variables t join the parameters, of cost t²/2 - t · uᵀx, at best -(uᵀx)²/2."""
        assert b.moments is not None
        of_nodes, of_parameters = (self.covariance.curvature_of_covariance(m) for m in b.moments)
        r = of_parameters.shape[1]
        hessian = np.block([[b.parameter_hessian, -of_parameters], [-of_parameters.T, np.eye(r)]])
        without = np.zeros((*b.parameter_sensitivity.shape[:2], r))
        return replace(
            b,
            parameter_sensitivity=np.concatenate([b.parameter_sensitivity, without], axis=2),
            cross_hessian=np.concatenate([b.cross_hessian, -of_nodes], axis=2),
            parameter_hessian=hessian,
            parameter_gradient=np.concatenate([b.parameter_gradient, np.zeros(r)]),
        )

    def _without_known_states(self, b: Linearization, placed: Placed) -> Linearization:
        """Let known initial states follow the parameters: x = x' + (dx/dq) dq, of which x' does not move."""
        known = self.model.known_states
        follow = np.where(known[:, None], placed.initial_slope, 0.0)
        follow = np.pad(follow, ((0, 0), (0, b.cross_hessian.shape[2] - follow.shape[1])))
        node_hessian = b.node_hessian.copy()
        cross_hessian = b.cross_hessian.copy()
        node_gradient = b.node_gradient.copy()
        transition = b.transition.copy()
        sensitivity = b.parameter_sensitivity.copy()
        hessian = b.parameter_hessian.copy()
        gradient = b.parameter_gradient.copy()
        for k in np.flatnonzero(self.data.begins_record):
            mixed = follow.T @ cross_hessian[k]
            hessian += mixed + mixed.T + follow.T @ node_hessian[k] @ follow
            gradient += follow.T @ node_gradient[k]
            cross_hessian[k] += node_hessian[k] @ follow
            sensitivity[k] += transition[k] @ follow
            node_hessian[k, known, :] = 0
            node_hessian[k, :, known] = 0
            node_hessian[k, known, known] = 1
            cross_hessian[k, known] = 0
            node_gradient[k, known] = 0
            transition[k, :, known] = 0
        return Linearization(
            transition=transition,
            parameter_sensitivity=sensitivity,
            node_hessian=node_hessian,
            cross_hessian=cross_hessian,
            node_gradient=node_gradient,
            parameter_hessian=hessian,
            parameter_gradient=gradient,
        )

    def continuity_variance(self, linearization: Linearization, spread: float) -> Array:
        """Return variances (n,) by which states must jump to change the outputs of a segment by `spread`.

        `spread` is in units of the residuals that the linearization was weighted with.
        """
        curvature = np.nan_to_num(np.mean(linearization.node_hessian.diagonal(axis1=1, axis2=2), axis=0))
        signal = spread**2 * self.data.segment_length * len(self.outputs)
        # A state that no output shows has no such scale: any will do.
        return np.where(curvature > 1e-200, signal / np.maximum(curvature, 1e-200), 1.0)

    # --- condensing ---------------------------------------------------------------------------------------------------

    def condense(
        self, linearization: Linearization, trajectory: Trajectory, continuity_variance: Array, damping: float = 0.0
    ) -> Condensed:
        """Eliminate the nodes, see `greybox.compiled.condensing`.

        `damping` holds the nodes that are free, relative to their curvature (Levenberg-Marquardt).
        """
        b = linearization
        gaps = trajectory.gaps
        slope = trajectory.detail.placed.slope
        node_damping = np.zeros_like(gaps)
        if damping:
            node_damping = damping * self._node_curvature(b, continuity_variance)
            b = replace(b, node_hessian=b.node_hessian + node_damping[:, :, None] * np.eye(self.states))

        stationarity = -np.concatenate([b.node_gradient[:, :, None], b.cross_hessian], axis=2)
        continuity = -np.concatenate([gaps[:, :, None], b.parameter_sensitivity], axis=2)
        x, multiplier = self._solve_continuity(b, stationarity, continuity, continuity_variance)
        linked = np.where(self.data.coupled[:, None, None], b.parameter_sensitivity, 0.0)
        change = np.tensordot(b.cross_hessian, x, ((0, 1), (0, 1)))
        change += np.tensordot(linked, multiplier, ((0, 1), (0, 1)))
        hessian = b.parameter_hessian + change[:, 1:]
        gradient = b.parameter_gradient + change[:, 0]

        q = slope.shape[0]
        least = self.model.strategies.least_curvature
        if len(gradient) > q:  # the variables of the covariance, see `_with_covariance`
            right = np.concatenate([gradient[q:, None], hessian[q:, :q]], axis=1)
            follows = followed_by_covariance(hessian[q:, q:], right, least)
            gradient = gradient[:q] + hessian[:q, q:] @ follows[:, 0]
            hessian = reduced_hessian(hessian[:q, :q], -hessian[:q, q:] @ follows[:, 1:], least)
            x, multiplier = (v[:, :, : 1 + q] + v[:, :, 1 + q :] @ follows for v in (x, multiplier))

        node_step = x[:, :, 0]
        return Condensed(
            hessian=slope.T @ ((hessian + hessian.T) / 2) @ slope,
            gradient=slope.T @ gradient,
            node_step=node_step,
            node_sensitivity=x[:, :, 1:] @ slope,
            multiplier=multiplier[:, :, 0],
            multiplier_sensitivity=multiplier[:, :, 1:] @ slope,
            damping=node_damping,
            decrease=_predicted_decrease(linearization, node_step, multiplier[:, :, 0], gaps, continuity_variance, q),
        )

    def _node_curvature(self, b: Linearization, continuity_variance: Array) -> Array:
        """Return the second derivatives of outputs and continuity penalty by every node state that is free, (s, n).

        Where continuity is exact these are the first ones of every stretch.
        """
        coupled = self.data.coupled
        if not np.all(continuity_variance > 0):
            return np.where(self.data.begins_stretch[:, None], b.node_hessian.diagonal(axis1=1, axis2=2), 0.0)
        penalty = np.where(coupled[:, None], (b.transition**2 / continuity_variance[:, None]).sum(axis=1), 0.0)
        penalty[1:] += np.where(coupled[:-1, None], 1 / continuity_variance, 0.0)
        return b.node_hessian.diagonal(axis1=1, axis2=2) + penalty

    def close_gaps(self, linearization: Linearization, trajectory: Trajectory) -> Array:
        """Return the nodes (s, n) that close the gaps with the least change of the outputs."""
        columns = 1 + linearization.cross_hessian.shape[2]  # as in `condense`, whose factorization then serves
        stationarity = np.zeros((*trajectory.gaps.shape, columns))
        continuity = np.zeros_like(stationarity)
        continuity[:, :, 0] = -trajectory.gaps
        exact = np.zeros(self.states)
        return trajectory.nodes + self._solve_continuity(linearization, stationarity, continuity, exact)[0][:, :, 0]

    def _solve_continuity(
        self, b: Linearization, stationarity: Array, continuity: Array, variance: Array
    ) -> tuple[Array, Array]:
        """Solve in units in which the curvature is one: nodes and multipliers are then of one size."""
        curvature = np.mean(b.node_hessian.diagonal(axis1=1, axis2=2), axis=0)
        visible = curvature > 1e-30 * curvature.max(initial=0.0) + 1e-300  # above what rounding makes of zero
        unit = 1 / np.sqrt(np.where(visible, curvature, 1.0))
        column = unit[:, None]
        x, multiplier = solve_continuity(
            b.node_hessian * unit * column + self.model.strategies.state_ridge * np.eye(self.states),
            b.transition * unit / column,
            self.data.coupled,
            stationarity * column,
            continuity / column,
            variance / unit**2,
        )
        return x * column, multiplier / column

    # --- for IPOPT and for the covariance of the estimate -------------------------------------------------------------

    def program(self, z: ca.MX) -> "RecordProgram":
        """Return the record as its method transcribes it, at z (p,)."""
        return RecordProgram(self, z)

    def information(
        self,
        names: tuple[str, ...],
        values: Array,
        uncertain: tuple[int, ...],
        trajectory: Trajectory | None,
        dz_dx: Array,
    ) -> Information:
        """Return what the record says about the values (k,), the initial states fitted along.

        For errors with the autocorrelation of the residuals, or white ones where the criterion takes them so.
        """
        assert trajectory is not None
        columns = tuple(range(trajectory.z.size))
        part: RecordPart = self
        if uncertain:
            # Constants with a covariance of their own join the unknowns, all of them without scaling.
            columns = (*columns, *uncertain)
            point = ca.SX.sym("x", len(columns))
            named: dict[str, Any] = dict(zip(names, values.tolist(), strict=True))
            named |= {names[column]: point[i] for i, column in enumerate(columns)}
            part = RecordPart(record_model(self.problem, named, point, self.model.method), self.data, self.substeps)
            trajectory = part.trajectory(values[list(columns)], trajectory.nodes, simulated=trajectory.simulated)
            dz_dx = np.ones(len(columns))

        weight = part.covariance.weight(trajectory.products)
        triangle, white, weighted = part._jacobian(trajectory, weight)
        score = white
        if part.covariance.known is not None:  # what was given is not what the residuals show
            variance = np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1)
            score = np.einsum("k,kpt,kqt->pq", variance, weighted, weighted)
        initial = self.unknown_initial_states
        independent = independent_numbers(self.numbers, initial, len(white), 1.0)

        def of_all_values(matrix: Array) -> Array:
            result = np.zeros((len(values), len(values)))
            result[np.ix_(columns, columns)] = matrix * dz_dx * dz_dx[:, None]
            return result

        jacobian = np.zeros((len(triangle), len(values)))
        jacobian[:, columns] = triangle * dz_dx
        meat = of_all_values(score * independent / (independent - initial))

        def spread(correction: float) -> tuple[float, Array]:
            return 1.0, meat * correction**2

        def colored(inverse: Array) -> ColoredErrors:
            found = colored_errors(
                self.data.unpadded(weighted),
                self.data.unpadded(part.residuals(trajectory)),
                np.pad(inverse, (0, len(columns) - len(inverse))) * dz_dx * dz_dx[:, None],
                weight,
                initial,
            )
            return ColoredErrors(
                meat=of_all_values(found.meat),
                dof=found.dof,
                correlation_times=found.correlation_times * longest.step,
                duration=len(longest) * longest.step,
                is_long_enough=found.is_long_enough,
            )

        longest = max(self.data.stretches, key=len)
        by_output = not self.model.criterion.errors_are_white
        return Information(self, jacobian, self.numbers - initial, spread, math.nan, colored if by_output else None)

    def _jacobian(self, trajectory: Trajectory, weight: Array) -> tuple[Array, Array, Array]:
        """Return a triangular factor (p, p) of the Jacobian of the weighted residuals, JᵀJ, and WᵀJ (k, p, samples)."""
        linearization = self.linearize(trajectory, weight)
        sensitivity = self.condense(linearization, trajectory, np.zeros(self.states)).node_sensitivity.copy()
        del linearization  # of a long record, a tenth of what fits into memory
        placed = trajectory.detail.placed
        known = self.model.known_states
        if known.any():
            sensitivity[np.ix_(self.data.begins_record, known)] = placed.initial_slope[known] @ placed.slope

        s, length, k, n = self.data.segments, self.data.segment_length, len(self.outputs), self.states
        p = trajectory.z.size
        weighted = np.empty((s, length, k, p))
        triangle = np.zeros((0, p))
        white = np.zeros((p, p))
        for batch in self.segments.batches(s):
            _, J, _ = self.segments.sensitivities(trajectory.detail.states, placed.q, placed.data, batch)
            root = weight @ (J[..., :n] @ sensitivity[batch, None] + J[..., n:] @ placed.slope)
            rows = root.reshape(-1, p)
            triangle = np.asarray(np.linalg.qr(np.vstack([triangle, rows]), mode="r"))
            white += rows.T @ rows
            weighted[batch] = weight.T @ root
        return triangle, white, np.moveaxis(weighted.reshape(s * length, k, p), 0, -1)


class RecordProgram(Program):
    """A record transcribed: states as unknowns, weighted residuals, continuity and known initial states as equations.

    Its parameters are the square root of the inverse residual covariance (k, k), then the data (width, samples), both
    column by column.
    """

    def __init__(self, part: RecordPart, z: ca.MX) -> None:
        """Transcribe the record."""
        self._part = part
        q = part.model.locate(z)[0]
        weight = ca.MX.sym("W", len(part.outputs), len(part.outputs))
        data = ca.MX.sym("data", part.step.width, part.data.samples)
        self._transcribed = part.model.method.transcribe(part.step, part.data, q, data)
        residuals = self._transcribed.residuals
        self.unknowns = self._transcribed.unknowns
        self.parameters = ca.vertcat(ca.vec(weight), ca.vec(data))
        self.error = ca.vec(weight @ residuals)
        self.cost = ca.MX(0.0)
        self.equations = ca.vertcat(self._transcribed.equations, self._known_states(q))
        self._products = ca.Function("products", [z, self.unknowns, self.parameters], [residuals @ residuals.T])

    def _known_states(self, q: ca.MX) -> ca.MX:
        """Return known states at the first sample of the record less what they must be."""
        part = self._part
        count = int(part.data.begins_record.sum())
        rows = np.flatnonzero(part.model.known_states).tolist()
        if not rows:
            return ca.MX(0, 1)  # no rows of a single one would be taken as a row without columns
        wanted, _ = part.model.initial(q)
        return ca.vec(self._transcribed.initial[rows, :count] - ca.repmat(wanted[rows], 1, count))

    def initial_unknowns(self, trajectory: Trajectory) -> Array:
        """Return the unknowns for the states along a trajectory."""
        return self._transcribed.start(self._part.segments.in_order(trajectory.detail.states))

    def initial_parameters(self, z: Array, share: float) -> Array:
        """Return weights for residuals of a `share` of each signal's spread, and the data at z (p,)."""
        return self._joined(self._part.initial_weight(share), self._part.place(z).data)

    def outcome(self, z: Array, unknowns: Array, w: Array) -> tuple[float, Array, bool]:
        """Return the cost of the residuals, the weights and data that follow, and whether the data stayed."""
        covariance = self._part.covariance
        products = self._products(z, unknowns, w).full()
        following = self._joined(covariance.weight(products), self._part.place(z).data)
        size = len(self._part.outputs) ** 2
        return covariance.cost(products), following, np.array_equal(following[size:], w[size:])

    def _joined(self, weight: Array, data: Array) -> Array:
        return np.concatenate([weight.ravel(order="F"), self._part.segments.in_order(data).ravel(order="F")])


def _measured_rows(data: SampledData) -> Array:
    """Return measured outputs, zero where missing; one where they are present; and the step of every sample."""
    measured = data.measured
    return np.vstack([np.nan_to_num(measured), np.isfinite(measured), data.steps])


def _predicted_decrease(
    b: Linearization, step: Array, multiplier: Array, gaps: Array, continuity_variance: Array, q: int
) -> float:
    """Return the decrease of the merit that the quadratic model predicts for the step of the nodes alone."""
    curved = float((step * (b.node_hessian @ step[:, :, None])[:, :, 0]).sum())
    by_covariance = np.tensordot(b.cross_hessian[:, :, q:], step, ((0, 1), (0, 1)))
    change = float((b.node_gradient * step).sum()) + 0.5 * (curved - float(by_covariance @ by_covariance))
    if np.all(continuity_variance > 0):
        gaps_after = continuity_variance * multiplier
        change += 0.5 * float(((gaps_after**2 - gaps**2) / continuity_variance).sum())
    return max(-change, 0.0)


def compile_record(problem: Problem, expressions: Mapping[str, Any], z: ca.SX, method: Transcription) -> RecordPart:
    """Compile a record for the point z, of which `expressions` gives every parameter of the problem by outside name."""
    model = record_model(problem, expressions, z, method)
    data = sampled_data(
        model.record,
        model.system.inputs,
        model.outputs,
        lead=_longest_delay(problem, model.system),
        segment_length=1,
        complete=model.criterion.noise == "full",
    )
    looks = at_samples(data, max(data.segments // model.strategies.looks, 1))

    def known_initial(q: Array) -> Array:
        return model.initial(q)[0].full().ravel()

    substeps, segment_length = substeps_and_segment(
        problem, method, model.system, model.initial_states, looks, known_initial
    )
    data = replace(data, segment_length=segment_length)
    return RecordPart(model, data, substeps, compile_linearization=method.compile)


def record_model(problem: Problem, expressions: Mapping[str, Any], z: ca.SX, method: Transcription) -> RecordModel:
    """Compile what depends neither on the cut into segments nor on the substeps."""
    assert isinstance(problem.data, Record)
    assert isinstance(problem.criterion, TimeCriterion)
    system = dynamics(problem.model, delay_order(problem.delay))
    between = between_samples(problem.criterion.inputs, system.inputs, problem.data)
    system = system.later([one.late for one in between])
    outputs = problem.criterion.compared(problem.model, problem.data)

    q = ca.vertcat(ca.SX(0, 1), *problem.local_values(expressions).values())
    slope = ca.jacobian(q, z)
    active = [i for i in range(q.numel()) if slope[i, :].nnz()]
    delay = system.delay(q[: len(system.parameters)])
    locate = ca.Function("locate", [z], [q, ca.densify(slope[active, :]), ca.densify(delay)])

    known = problem.criterion.initial
    symbol = ca.SX.sym("q", q.numel())
    local = Names(dict(zip(problem.declared, ca.vertsplit(symbol), strict=True)), problem.model.label)
    states = [_called(f"initial[{name!r}]", known.get(name, math.nan), local) for name in system.states]
    initial = ca.vertcat(ca.SX(0, 1), *states)
    by_active = ca.densify(ca.jacobian(initial, symbol[active]))
    return RecordModel(
        problem=problem,
        record=problem.data,
        criterion=problem.criterion,
        method=method,
        system=system,
        between=between,
        outputs=outputs,
        parameters=tuple(problem.declared),
        outside_names=tuple(problem.outside(name) for name in problem.declared),
        gains=problem.criterion.gains(problem.model, outputs),
        active=np.array(active, dtype=int),
        locate=locate,
        initial=ca.Function("initial", [symbol], [initial, by_active]),
        known_states=np.array([name in known for name in system.states], dtype=bool),
        initial_states=InitialStates(system, outputs, method.strategies),
    )


def _called(what: str, value: Any, local: Names) -> Any:
    """Evaluate an initial state that may be a function of the parameters, naming it where it fails."""
    if not callable(value):
        return value
    try:
        return ca.SX(traced(what, value, local))
    except (AttributeError, KeyError, ArithmeticError) as error:
        raise ValueError(f"{what}: {error}") from error


def _longest_delay(problem: Problem, system: Dynamics) -> Array:
    """Return the longest delay of every input within the bounds (m,), s; what is unbounded counts with its start."""
    if not system.delayed:
        return np.zeros(len(system.inputs))
    values: dict[str, float] = {}
    for name, p in problem.parameters.items():
        high = p.bounds[1] if math.isfinite(p.bounds[1]) else max(p.box[1], p.start)
        values[name] = p.start if p.fixed or not math.isfinite(high) else high
    q = list(problem.local_values(values).values())[: len(system.parameters)]
    return np.maximum(system.delay(q).full().ravel(), 0.0)
