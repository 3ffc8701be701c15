"""A record with its model, compiled: nodes, trajectories, their linearization, and what they say of the parameters."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.condensing import forget_long_chain, solve_continuity
from greybox.compiled.initial_states import InitialStates, at_samples
from greybox.compiled.part import (
    TIME_BINS,
    ColoredErrors,
    Condensed,
    Information,
    Part,
    Program,
    Trajectory,
)
from greybox.compiled.record_information import colored_errors, independent_numbers
from greybox.compiled.residual_covariance import (
    ResidualCovariance,
    diagonal,
    followed_by_covariance,
    of_diagonal,
    reduced_hessian,
    require_independent,
    residual_covariance_of,
)
from greybox.compiled.riccati import NoiseModel, SteadyFilter, noise_model
from greybox.compiled.sample_step import SampleStep, sample_step
from greybox.compiled.sampled_data import SampledData, joined, sampled_data
from greybox.compiled.segments import Linearization, Segments
from greybox.compiled.step_size import drawn_parameters, substeps_and_segment
from greybox.compiled.strategies import Strategies
from greybox.compiled.transcription.method import Transcription
from greybox.data.intersample import Intersample
from greybox.data.record import Record
from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.formulation.input_assumptions import between_samples
from greybox.formulation.problem import Problem
from greybox.formulation.time_criteria import TimeCriterion
from greybox.modeling.integrators import Integrator
from greybox.modeling.model import Model, Names
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.pade_delay import delay_order
from greybox.modeling.realization import Dynamics, dynamics
from greybox.modeling.symbolic_reading import traced
from greybox.statistics.metrics import whiteness
from greybox.statistics.residual_spectrum import score_covariance

# Share of records whose white residuals are not taken as such.
WHITE = 0.01

# Share of the samples at which all outputs are measured, from which a filter may be taken as
# steady: gaps of a tenth leave it so nearly everywhere.
COMPLETE = 0.9

# Share of the Hessian of a known covariance that an estimated one leaves, at least.
LEAST_CURVATURE = 0.05

# Relative variance of a direction of initial states below which it counts as known.
DIRECTIONS = 1e-12

# Power of a response in its last quarter over that of the whole, beyond which it grows without end:
# of two integrators it is 2.3, of an unstable mode over three time constants 3.8.
GROWS = 2.5


@dataclass(frozen=True, eq=False)
class Placed:
    """The parameters of a record at one point z of the solver.

    Attributes
    ----------
    q : (declared,) array
        Values of all declared parameters; (declared, s), for every segment, where several records
        have their own.
    slope : (active, p) or (records, active, p) array
        Derivatives of the estimated ones by z.
    data : (width, columns) array
        The data, with the inputs placed for these delays.
    initial, initial_slope : (n,) and (n, active) arrays, with `records` before where they have their own
        Known initial states and their derivatives by the active parameters; NaN where a state is
        unknown.
    filter : SteadyFilter or None
        That of the process noise, where it is estimated; its gain is in `q` and `slope`.
    """

    q: Array
    slope: Array
    data: Array
    initial: Array
    initial_slope: Array
    filter: SteadyFilter | None = None


@dataclass(frozen=True, eq=False)
class Along:
    """What a trajectory of a record knows besides its nodes: where it is placed, and its states (n, columns)."""

    placed: Placed
    states: Array


@dataclass(frozen=True, eq=False)
class RecordModel:
    """What a record and its model are, whatever the cut into segments and the substeps.

    Problem, record and criterion stay where they were compiled when this is pickled: solvers need
    the rest alone.

    Attributes
    ----------
    system : Dynamics
        Its delays include by how much interpolated inputs come late.
    between : tuple of Intersample
        How each input runs between its samples.
    parameters, outside_names : tuple of str
        The declared parameters, by the model's names and the problem's; then the gains that follow
        from process noise.
    gains : tuple of (str, str)
        State and output of every entry of the Kalman gain that is estimated, or follows from
        process noise.
    driven : tuple of str
        States whose process noise is estimated.
    begin : (m,) array
        The start values of the model's parameters.
    active : (q,) array
        Places of the estimated parameters among the declared ones.
    has_time : bool
        Whether the record's samples follow one another in time.
    errors_are_white : bool
        Whether the criterion takes the errors for white, so that no correlation is looked for.
    is_prior : bool
        Whether the record stands for a-priori knowledge, and not for data.
    locate : casadi.Function
        (z) -> values of the declared parameters, derivatives of the active ones by z, delays.
    initial : casadi.Function
        (declared parameters) -> known initial states, and their derivatives by the active
        parameters.
    known_states : (n,) bool array
    steps : dict
        The samples compiled so far, by integrator and substeps; models that differ in their data
        alone share it.
    expressions : tuple of int
        Of every declared parameter a number for its expression of z, the same for the same one.
    """

    problem: Problem
    record: Record
    criterion: TimeCriterion
    has_time: bool
    errors_are_white: bool
    is_prior: bool
    method: Transcription
    system: Dynamics
    between: tuple[Intersample, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outside_names: tuple[str, ...]
    gains: tuple[tuple[str, str], ...]
    driven: tuple[str, ...]
    begin: Array
    active: IntArray
    locate: ca.Function
    initial: ca.Function
    known_states: BoolArray
    initial_states: InitialStates
    steps: dict[tuple[Integrator, int], SampleStep]
    expressions: tuple[int, ...]

    def __getstate__(self) -> dict[str, Any]:
        """Leave behind what may be of the user's classes."""
        left = ("problem", "record", "criterion")
        return {name: value for name, value in vars(self).items() if name not in left}

    @property
    def strategies(self) -> Strategies:
        """The settings of the solver."""
        return self.method.strategies

    @one_thread_at_a_time
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
            steps={},
        )

    def step(self, integrator: Integrator, substeps: int) -> SampleStep:
        """Compile one sample, or return it where that was done before."""
        key = (integrator, substeps)
        if key not in self.steps:
            held = tuple(between.held for between in self.between)
            self.steps[key] = sample_step(
                self.system,
                held,
                self.criterion,
                self.outputs,
                self.parameters,
                integrator,
                substeps,
            )
        return self.steps[key]


class RecordPart(Part):
    """One record of a problem: a model, the data cut into segments, and the step from sample to sample."""

    def __init__(
        self,
        model: RecordModel,
        data: SampledData,
        substeps: int,
        *,
        step: SampleStep | None = None,
        segments: Segments | None = None,
        covariance: ResidualCovariance | None = None,
        like: "RecordPart | None" = None,
    ) -> None:
        """Build the functions; what is given serves: a `step` of these substeps, `segments` of this step.

        A part that is made of another is `like` it in name and weight.
        """
        if like is None:
            super().__init__(model.problem)
        else:
            self.take_after(like)
        self.model = model
        self.data = data
        self._substeps = substeps
        self.step = step or model.step(model.method.scheme, substeps)
        self.segments = segments or Segments(
            self.step, data.segments, data.segment_length, model.active
        )
        self._placed_data: tuple[Array, Array] | None = None
        self.covariance = covariance or residual_covariance_of(
            model.criterion, model.outputs, data.measured
        )
        self.system: Dynamics = model.system
        self.outputs = model.outputs
        self.states = len(model.system.states)

    @cached_property
    def _measured(self) -> Array:
        """What was measured at every sample, and its step, as columns."""
        return self.segments.columns(_measured_rows(self.data))

    @cached_property
    def at_nodes(self) -> tuple[Array, Array]:
        """Measured outputs and inputs at the nodes."""
        return at_samples(self.data, self.data.segment_length)

    def excerpt(self, samples: int) -> "RecordPart":
        """Return the part on excerpts, evenly over the record, of about so many samples in all."""
        data = self.data.excerpts(samples)
        covariance = self.covariance.along(
            data.measured
        )  # the criterion stays behind when a part is sent to a worker
        return RecordPart(
            self.model, data, self.substeps, step=self.step, covariance=covariance, like=self
        )

    def with_outputs(self, outputs: Sequence[Array]) -> "RecordPart":
        """Return the part with other measured outputs (k, n) of every stretch, NaN where there are none."""
        part = copy(self)
        each = zip(self.data.stretches, outputs, strict=True)
        part.data = replace(
            self.data, stretches=tuple(replace(stretch, outputs=values) for stretch, values in each)
        )
        counts = np.isfinite(part.data.measured).sum(axis=1)
        part.covariance = replace(self.covariance, counts=counts)
        part._placed_data = None
        for made in ("_measured", "at_nodes", "noise_model"):
            vars(part).pop(made, None)
        return part

    def with_weight(self, factor: float) -> "RecordPart":
        """Return the part with its cost counted so many times."""
        part = copy(self)
        part.weight = factor * self.weight
        return part

    def with_inputs(self, between: tuple[Intersample, ...]) -> "RecordPart":
        """Return the part with inputs that run otherwise between their samples."""
        model = self.model.with_inputs(between)
        return RecordPart(model, self.data, self.substeps, covariance=self.covariance, like=self)

    @one_thread_at_a_time
    def refined(self, factor: int) -> "RecordPart":
        """Return the part with `factor` times the substeps."""
        return RecordPart(
            self.model,
            self.data,
            factor * self.substeps,
            covariance=self.covariance,
            like=self,
        )

    # --- facts

    @property
    def has_nodes(self) -> bool:
        """The states at the beginning of segments."""
        return True

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
    def is_static(self) -> bool:
        """True when outputs depend on the inputs of the same sample alone: neither states nor delays."""
        return not self.states and not self.system.delayed

    @property
    def gains(self) -> tuple[tuple[str, str], ...]:
        """State and output of every estimated entry of the Kalman gain."""
        return self.model.gains

    @cached_property
    @one_thread_at_a_time
    def discontinuous_delays(self) -> Mapping[str, tuple[str, str]]:
        """Delays at whose whole samples the cost jumps: a held input reaches an output directly."""
        system = self.system
        result: dict[str, tuple[str, str]] = {}
        held = [between.held for between in self.model.between]
        if not any(held) or not system.delayed:
            return result
        x, u, p = (
            ca.SX.sym("v", len(v)) for v in (system.states, system.inputs, system.parameters)
        )
        feedthrough = ca.jacobian(system.output(x, u, p), u)
        delay = system.delay(p)
        for i, j in itertools.product(range(u.numel()), range(p.numel())):
            reached = [
                n
                for k, n in enumerate(system.outputs)
                if feedthrough.has_nz(k, i) and n in self.outputs
            ]
            if held[i] and reached and ca.depends_on(delay[i], p[j]):
                name = self.model.outside_names[self.model.parameters.index(system.parameters[j])]
                result[name] = (system.inputs[i], reached[0])
        return result

    @property
    def description(self) -> str:
        """The method, with the segments and steps that were chosen."""
        return self.model.method.described(self.data.segment_length, self.substeps)

    # --- trajectories

    def place(self, z: Array) -> Placed:
        """Return the parameters and the data at z (p,)."""
        q, slope, delay = (value.full() for value in self.model.locate(z))
        initial, initial_slope = (value.full() for value in self.model.initial(q))
        q, steady = q.ravel(), None
        if self.noise_model is not None:
            steady = self.noise_model.at(q)
            count = len(self.gains)
            own = len(slope) - count
            q[len(q) - count :] = steady.gain.ravel()
            slope[own:] = steady.gain_slope.reshape(count, own) @ slope[:own]
        return Placed(
            q, slope, self._data_at(delay.ravel()), initial.ravel(), initial_slope, steady
        )

    @cached_property
    def noise_model(self) -> NoiseModel | None:
        """What gains follow from, about the means of the record; None where they do not follow from process noise."""
        model = self.model
        if not model.driven:
            return None
        counts = [np.isfinite(stretch.outputs).all(axis=0).sum() for stretch in self.data.stretches]
        if sum(counts) < COMPLETE * sum(
            len(stretch) - stretch.masked for stretch in self.data.stretches
        ):
            raise ValueError(
                f"{self.name!r} has all of {', '.join(self.outputs)} at too few samples for process_noise, "
                "whose filter is steady: resample the outputs to one rate, or leave process_noise out."
            )
        nodes = model.initial_states.at(*self.at_nodes, model.begin, np.full(self.states, np.nan))
        data = np.vstack(
            [
                *self.data.delayed_inputs(np.zeros(len(self.system.inputs))),
                _measured_rows(self.data),
            ]
        )
        reference = nodes.mean(axis=1), data.mean(axis=1)
        step = max(self.data.stretches, key=len).step
        return noise_model(
            self.step, step, reference, model.parameters, model.active, model.driven, self.outputs
        )

    def _data_at(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), inputs placed for these delays (m,).

        The same array as the last time, as long as no delay has passed a whole sample.
        """
        steps = np.array([stretch.step for stretch in self.data.stretches])
        whole = np.floor(self.data.by_stretch(delays) / steps[:, None] + 1e-9)
        if self._placed_data is None or not np.array_equal(self._placed_data[0], whole):
            inputs = self.segments.columns(np.vstack(self.data.delayed_inputs(delays)))
            self._placed_data = (whole, np.vstack([inputs, self._measured]))
        return self._placed_data[1]

    def initial_trajectory(self, z: Array) -> Trajectory:
        """Return the trajectory at z (p,) with nodes from the data, see `greybox.compiled.initial_states`."""
        placed = self.place(z)
        return self._trajectory(z, self.nodes_from_data(placed.q, placed.initial), placed)

    def nodes_from_data(self, q: Array, known: Array) -> Array:
        """Return nodes (s, n) from the data, at the declared parameters and the known initial states (n,), else NaN."""
        return self.model.initial_states.at(
            *self.at_nodes, q[: len(self.system.parameters)], known
        ).T

    def trajectory(self, z: Array, nodes: Array, *, simulated: bool = False) -> Trajectory:
        """Return the trajectory at z (p,) from nodes (s, n); `simulated` from the first one of every stretch alone."""
        placed = self.place(z)
        return (
            self._simulated(z, nodes, placed) if simulated else self._trajectory(z, nodes, placed)
        )

    def _trajectory(self, z: Array, nodes: Array, placed: Placed) -> Trajectory:
        nodes = self._with_known_states(nodes, placed)
        states, ends = self.segments.simulate(nodes, placed.q, placed.data)
        gaps = np.zeros_like(ends)
        gaps[:-1] = ends[:-1] - nodes[1:]
        gaps[~self.data.coupled] = 0
        residuals = self.segments.residuals(states, placed.q, placed.data)
        products = self._products(self.segments.products(residuals))
        return Trajectory(
            z, nodes, ends, gaps, products, simulated=False, detail=Along(placed, states)
        )

    def _simulated(self, z: Array, nodes: Array, placed: Placed) -> Trajectory:
        nodes = self._with_known_states(nodes, placed)
        nodes, states, ends, products = self.segments.simulate_stretches(
            self.data.segment_counts, nodes, placed.q, placed.data
        )
        gaps = np.zeros_like(ends)
        products = self._products(products)
        return Trajectory(
            z, nodes, ends, gaps, products, simulated=True, detail=Along(placed, states)
        )

    def _products(self, of_records: Array) -> Array:
        """Return the products of the residuals as a trajectory has them, given those of every record (r, k, k)."""
        return of_records[0]

    def _with_known_states(self, nodes: Array, placed: Placed) -> Array:
        """Return the nodes with the known initial states in them."""
        known = self.model.known_states
        if not known.any():
            return nodes
        nodes, begin = nodes.copy(), self.data.begins_record
        initial = (
            placed.initial
            if placed.initial.ndim == 1
            else placed.initial[self.segments.records[begin]]
        )
        nodes[np.ix_(begin, known)] = initial[..., known]
        return nodes

    def residuals(self, trajectory: Trajectory) -> Array:
        """Return measured less simulated outputs (k, samples) in the order of the samples, zero where missing."""
        along = trajectory.detail
        return self.segments.in_order(
            self.segments.residuals(along.states, along.placed.q, along.placed.data)
        )

    def simulated_outputs(self, trajectory: Trajectory) -> Array:
        """Return the outputs (k, samples) along a trajectory, in the order of the samples."""
        along = trajectory.detail
        return self.segments.in_order(
            self.segments.outputs(along.states, along.placed.q, along.placed.data)
        )

    def is_near_data(self, trajectory: Trajectory, factor: float) -> bool:
        """Tell whether the rms of the residuals of every output is below `factor` times the spread of its signal."""
        limit = self.covariance.counts * (factor * self.covariance.spread) ** 2
        return bool(np.all(of_diagonal(trajectory.products) <= limit))

    def explains_data(self, trajectory: Trajectory) -> bool:
        """Tell whether the residuals of every output are white; rows without a time have no order to tell it by."""
        if not self.model.has_time:
            return False
        stretches = [
            np.where(np.isfinite(stretch.outputs), residuals, np.nan)
            for stretch, residuals in zip(
                self.data.stretches, self.data.unpadded(self.residuals(trajectory)), strict=True
            )
        ]
        tests = (whiteness([rows[k] for rows in stretches]) for k in range(len(self.outputs)))
        return all(test.p_value > WHITE / len(self.outputs) for test in tests)

    def signature(self, trajectory: Trajectory) -> Array:
        """Return up to some 500 simulated samples of every output, in units of the measured signal's spread."""
        along = trajectory.detail
        columns = slice(None, None, max(along.placed.data.shape[1] // 500, 1))
        outputs = self.segments.outputs(
            along.states[:, columns], along.placed.q, along.placed.data[:, columns]
        )
        return (outputs / self.covariance.spread[:, None]).ravel()

    # --- cost

    def cost(self, trajectory: Trajectory, smoothing: float = 0.0) -> float:
        """Return the negative log-likelihood of the residuals along a trajectory."""
        return self.covariance_along(trajectory).cost(trajectory.products)

    def covariance_along(self, trajectory: Trajectory) -> ResidualCovariance:
        """Return how residuals become a cost: by the covariance of the steady filter along a trajectory, if any."""
        steady = trajectory.detail.placed.filter
        return (
            self.covariance
            if steady is None
            else replace(self.covariance, predicted=steady.covariance)
        )

    def squared_cost(self, trajectory: Trajectory, weight: Array, smoothing: float) -> float:
        """Return half the sum of squares of the residuals times `weight`."""
        return float(np.sum((weight @ trajectory.products) * weight)) / 2

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return W (k, k) with WᵀW the inverse of the residual covariance along a trajectory."""
        return self.covariance_along(trajectory).weight(trajectory.products)

    def initial_weight(self, share: float) -> Array:
        """Return W (k, k) for residuals of a `share` of each signal's spread."""
        return diagonal(1 / (share * self.covariance.spread))

    # --- linearization

    def linearize(
        self, trajectory: Trajectory, weight: Array, *, covariance_curvature: bool = False
    ) -> Linearization:
        """Linearize along a trajectory, known initial states eliminated."""
        placed = trajectory.detail.placed
        follows = covariance_curvature and self.covariance.known is None and len(self.outputs) > 1
        moments = follows and placed.filter is None
        result = self.segments.linearize(
            trajectory.detail.states, placed.q, weight, placed.data, moments=moments
        )
        if result.moments is not None:
            result = self._with_covariance(result)
        if placed.filter is not None and np.array_equal(weight, self.residual_weight(trajectory)):
            rows = self._covariance_rows(placed.filter, weight)
            excess = (
                np.eye(len(weight)) - weight @ trajectory.products @ weight.T / self._count
            ).ravel()
            result = replace(
                result,
                parameter_hessian=result.parameter_hessian + rows.T @ rows,
                parameter_gradient=result.parameter_gradient
                + math.sqrt(self._count / 2) * rows.T @ excess,
            )
        return (
            self._without_known_states(result, placed) if self.model.known_states.any() else result
        )

    @property
    def _count(self) -> int:
        """Samples that are compared."""
        return int(self.covariance.counts.max())

    def _covariance_rows(self, steady: SteadyFilter, weight: Array) -> Array:
        """Return J (k², active) with JᵀJ what the covariance of the prediction errors tells of the parameters.

        Their Fisher information is n/2 tr(S⁻¹ dS S⁻¹ dS), beside that of the mean.
        """
        change = weight @ np.moveaxis(steady.covariance_slope, -1, 0) @ weight.T
        rows = math.sqrt(self._count / 2) * change.reshape(len(change), -1).T
        return np.pad(rows, ((0, 0), (0, len(self.model.active) - len(change))))

    def _with_covariance(self, b: Linearization) -> Linearization:
        """Let the covariance follow: variables t join the parameters, of cost t²/2 - t · uᵀx, at best -(uᵀx)²/2."""
        assert b.moments is not None
        of_nodes = self.covariance.of(self.segments.records).curvature_of_covariance(b.moments[0])
        of_parameters = self.covariance.curvature_of_covariance(b.moments[1])
        r = of_parameters.shape[2]
        own = np.broadcast_to(np.eye(r), (len(of_parameters), r, r))
        hessian = np.block(
            [[b.parameter_hessian, -of_parameters], [-of_parameters.transpose(0, 2, 1), own]]
        )
        without = np.zeros((*b.parameter_sensitivity.shape[:2], r))
        return replace(
            b,
            parameter_sensitivity=np.concatenate([b.parameter_sensitivity, without], axis=2),
            cross_hessian=np.concatenate([b.cross_hessian, -of_nodes], axis=2),
            parameter_hessian=hessian,
            parameter_gradient=np.pad(b.parameter_gradient, ((0, 0), (0, r))),
        )

    def _without_known_states(self, b: Linearization, placed: Placed) -> Linearization:
        """Let known initial states follow the parameters: x = x' + (dx/dq) dq, of which x' does not move."""
        known = self.model.known_states
        slopes = np.where(known[:, None], placed.initial_slope, 0.0).reshape(
            -1, *placed.initial_slope.shape[-2:]
        )
        slopes = np.pad(slopes, ((0, 0), (0, 0), (0, b.cross_hessian.shape[2] - slopes.shape[2])))
        node_hessian = b.node_hessian.copy()
        cross_hessian = b.cross_hessian.copy()
        node_gradient = b.node_gradient.copy()
        transition = b.transition.copy()
        sensitivity = b.parameter_sensitivity.copy()
        hessian = b.parameter_hessian.copy()
        gradient = b.parameter_gradient.copy()
        for k in np.flatnonzero(self.data.begins_record):
            record = self.segments.records[k]
            follow = slopes[record if len(slopes) > 1 else 0]
            mixed = follow.T @ cross_hessian[k]
            hessian[record] += mixed + mixed.T + follow.T @ node_hessian[k] @ follow
            gradient[record] += follow.T @ node_gradient[k]
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
        curvature = np.nan_to_num(
            np.mean(linearization.node_hessian.diagonal(axis1=1, axis2=2), axis=0)
        )
        signal = spread**2 * self.data.segment_length * len(self.outputs)
        # A state that no output shows has no such scale: any will do.
        return np.where(curvature > 1e-200, signal / np.maximum(curvature, 1e-200), 1.0)

    # --- condensing

    def condense(
        self,
        linearization: Linearization,
        trajectory: Trajectory,
        continuity_variance: Array,
        damping: float = 0.0,
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
            b = replace(
                b, node_hessian=b.node_hessian + node_damping[:, :, None] * np.eye(self.states)
            )

        stationarity = -np.concatenate([b.node_gradient[:, :, None], b.cross_hessian], axis=2)
        continuity = -np.concatenate([gaps[:, :, None], b.parameter_sensitivity], axis=2)
        x, multiplier = self._solve_continuity(b, stationarity, continuity, continuity_variance)
        linked = np.where(self.data.coupled[:, None, None], b.parameter_sensitivity, 0.0)
        q = slope.shape[-2]
        hessian, gradient = b.parameter_hessian.copy(), b.parameter_gradient.copy()
        for record, rows in enumerate(self._rows_of_records):
            change = np.tensordot(b.cross_hessian[rows], x[rows], ((0, 1), (0, 1)))
            change += np.tensordot(linked[rows], multiplier[rows], ((0, 1), (0, 1)))
            hessian[record] += change[:, 1:]
            gradient[record] += change[:, 0]
        if gradient.shape[1] > q:  # the variables of the covariance, see `_with_covariance`
            hessian, gradient, x, multiplier = self._with_covariance_reduced(
                hessian, gradient, x, multiplier, q
            )

        node_step, by_active, multiplier_by_active = x[:, :, 0], x[:, :, 1:], multiplier[:, :, 1:]
        hessian = (hessian + hessian.transpose(0, 2, 1)) / 2
        if slope.ndim == 2:
            hessian, gradient = (
                slope.T @ hessian.sum(axis=0) @ slope,
                slope.T @ gradient.sum(axis=0),
            )
            node_sensitivity, multiplier_sensitivity = (
                by_active @ slope,
                multiplier_by_active @ slope,
            )
        else:
            by_z = slope.reshape(-1, slope.shape[2])
            hessian, gradient = (
                by_z.T @ (hessian @ slope).reshape(by_z.shape),
                by_z.T @ gradient.ravel(),
            )
            each = list(zip(self._rows_of_records, slope, strict=True))
            node_sensitivity = np.concatenate([by_active[rows] @ own for rows, own in each])
            multiplier_sensitivity = np.concatenate(
                [multiplier_by_active[rows] @ own for rows, own in each]
            )
        return Condensed(
            hessian=hessian,
            gradient=gradient,
            node_step=node_step,
            node_sensitivity=node_sensitivity,
            multiplier=multiplier[:, :, 0],
            multiplier_sensitivity=multiplier_sensitivity,
            damping=node_damping,
            decrease=self._predicted_decrease(
                linearization, node_step, multiplier[:, :, 0], gaps, continuity_variance, q
            ),
        )

    @cached_property
    def _rows_of_records(self) -> list[slice]:
        """The segments of every record."""
        ends = np.cumsum(
            np.bincount(self.segments.records, minlength=self.segments.number)
        ).tolist()
        return [slice(first, end) for first, end in itertools.pairwise([0, *ends])]

    def _with_covariance_reduced(
        self, hessian: Array, gradient: Array, x: Array, multiplier: Array, q: int
    ) -> tuple[Array, Array, Array, Array]:
        """Eliminate the variables of the covariance of every record, those after the first q."""
        least = LEAST_CURVATURE
        hessians, gradients = np.empty((len(hessian), q, q)), np.empty((len(gradient), q))
        nodes, multipliers = x[:, :, : 1 + q].copy(), multiplier[:, :, : 1 + q].copy()
        for record, rows in enumerate(self._rows_of_records):
            H, g = hessian[record], gradient[record]
            right = np.concatenate([g[q:, None], H[q:, :q]], axis=1)
            follows = followed_by_covariance(H[q:, q:], right, least)
            gradients[record] = g[:q] + H[:q, q:] @ follows[:, 0]
            hessians[record] = reduced_hessian(H[:q, :q], -H[:q, q:] @ follows[:, 1:], least)
            nodes[rows] += x[rows, :, 1 + q :] @ follows
            multipliers[rows] += multiplier[rows, :, 1 + q :] @ follows
        return hessians, gradients, nodes, multipliers

    def _predicted_decrease(
        self,
        b: Linearization,
        step: Array,
        multiplier: Array,
        gaps: Array,
        continuity_variance: Array,
        q: int,
    ) -> float:
        """Return the decrease of the merit that the quadratic model predicts for the step of the nodes alone."""
        curved = float((step * (b.node_hessian @ step[:, :, None])[:, :, 0]).sum())
        by_covariance = self.segments.by_record(
            (b.cross_hessian[:, :, q:] * step[:, :, None]).sum(axis=1)
        )
        change = float((b.node_gradient * step).sum()) + 0.5 * (
            curved - float((by_covariance**2).sum())
        )
        if np.all(continuity_variance > 0):
            gaps_after = continuity_variance * multiplier
            change += 0.5 * float(((gaps_after**2 - gaps**2) / continuity_variance).sum())
        return max(-change, 0.0)

    def _node_curvature(self, b: Linearization, continuity_variance: Array) -> Array:
        """Return the second derivatives of outputs and continuity penalty by every node state that is free, (s, n).

        Where continuity is exact these are the first ones of every stretch.
        """
        coupled = self.data.coupled
        if not np.all(continuity_variance > 0):
            return np.where(
                self.data.begins_stretch[:, None], b.node_hessian.diagonal(axis1=1, axis2=2), 0.0
            )
        penalty = np.where(
            coupled[:, None], (b.transition**2 / continuity_variance[:, None]).sum(axis=1), 0.0
        )
        penalty[1:] += np.where(coupled[:-1, None], 1 / continuity_variance, 0.0)
        return b.node_hessian.diagonal(axis1=1, axis2=2) + penalty

    def close_gaps(self, linearization: Linearization, trajectory: Trajectory) -> Array:
        """Return the nodes (s, n) that close the gaps with the least change of the outputs."""
        columns = (
            1 + linearization.cross_hessian.shape[2]
        )  # as in `condense`, whose factorization then serves
        stationarity = np.zeros((*trajectory.gaps.shape, columns))
        continuity = np.zeros_like(stationarity)
        continuity[:, :, 0] = -trajectory.gaps
        exact = np.zeros(self.states)
        return (
            trajectory.nodes
            + self._solve_continuity(linearization, stationarity, continuity, exact)[0][:, :, 0]
        )

    def _solve_continuity(
        self, b: Linearization, stationarity: Array, continuity: Array, variance: Array
    ) -> tuple[Array, Array]:
        """Solve in units in which the curvature is one: nodes and multipliers are then of one size."""
        curvature = np.mean(b.node_hessian.diagonal(axis1=1, axis2=2), axis=0)
        visible = (
            curvature > 1e-30 * curvature.max(initial=0.0) + 1e-300
        )  # above what rounding makes of zero
        unit = 1 / np.sqrt(np.where(visible, curvature, 1.0))
        column = unit[:, None]
        x, multiplier = solve_continuity(
            b.node_hessian * unit * column + 1e-10 * np.eye(self.states),
            b.transition * unit / column,
            self.data.coupled,
            stationarity * column,
            continuity / column,
            variance / unit**2,
        )
        return x * column, multiplier / column

    # --- for IPOPT and for the covariance of the estimate

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

        For errors with the autocorrelation of the residuals, or white ones where the criterion
        takes them so.
        """
        assert trajectory is not None
        columns = tuple(range(trajectory.z.size))
        part: RecordPart = self
        if uncertain:
            # Constants with a covariance of their own join the unknowns, all of them without
            # scaling.
            columns = (*columns, *uncertain)
            point = ca.SX.sym("x", len(columns))
            named: dict[str, Any] = dict(zip(names, values.tolist(), strict=True))
            named |= {names[column]: point[i] for i, column in enumerate(columns)}
            q = ca.vertcat(ca.SX(0, 1), *self.problem.local_values(named).values())
            part = RecordPart(
                record_model(self.problem, q, point, self.model.method), self.data, self.substeps
            )
            trajectory = part.trajectory(
                values[list(columns)], trajectory.nodes, simulated=trajectory.simulated
            )
            dz_dx = np.ones(len(columns))

        weight = part.residual_weight(trajectory)
        told = part._jacobian(trajectory, weight)
        white, weighted = told.white, told.weighted
        score = white
        is_prior = self.model.is_prior
        if (
            part.covariance.known is not None and not is_prior
        ):  # what was given is not what the residuals show
            variance = np.diag(trajectory.products) / np.maximum(part.covariance.counts, 1)
            score = sum(
                (v * J @ J.T for v, J in zip(variance, weighted, strict=True)), np.zeros_like(white)
            )
        initial = self.unknown_initial_states
        independent = independent_numbers(self.numbers, initial, len(white), 1.0)

        def of_all_values(matrix: Array) -> Array:
            result = np.zeros((len(values), len(values)))
            result[np.ix_(columns, columns)] = matrix * dz_dx * dz_dx[:, None]
            return result

        def of_all_columns(matrix: Array) -> Array:
            result = np.zeros((*matrix.shape[:-1], len(values)))
            result[..., columns] = matrix * dz_dx
            return result

        def in_columns(directions: Array) -> Array:
            return (
                np.pad(directions, ((0, len(columns) - len(directions)), (0, 0))) * dz_dx[:, None]
            )

        def scaled(covariance: Array) -> Array:
            return covariance[np.ix_(columns, columns)] * dz_dx * dz_dx[:, None]

        meat = of_all_values(score * independent / (independent - initial))

        def spread(correction: float) -> tuple[float, Array]:
            return 1.0, meat * (1.0 if is_prior else correction**2)

        def colored(root: Array) -> ColoredErrors:
            directions = in_columns(root)
            return colored_errors(
                [directions.T @ J for J in self.data.unpadded(weighted)],
                self.data.unpadded(part.residuals(trajectory)),
                np.eye(root.shape[1]),
                weight,
                initial,
                max(self.data.stretches, key=len).step,
                initial=self.data.unpadded(told.by_initial),
                shocks=told.shocks,
            )

        noise = np.asarray(np.linalg.inv(weight.T @ weight), dtype=float)
        by_output = self.model.has_time and not self.model.errors_are_white
        return Information(
            self,
            of_all_columns(told.triangle),
            self.numbers - initial,
            spread,
            relative_noise=math.nan,
            reach=np.abs(of_all_columns(told.reach)),
            initial={name: of_all_columns(rows) for name, rows in told.initial.items()},
            colored=colored if by_output else None,
            told=lambda directions: self._told(weighted, noise, in_columns(directions)),
            output_errors=lambda covariance, colored: self._output_errors(
                told, noise, scaled(covariance), colored
            ),
        )

    def _told(self, weighted: Array, noise: Array, directions: Array) -> Array:
        """Return what every output tells in every part of the record of directions (columns, q), see `Information`."""
        found = np.zeros((directions.shape[1], len(self.outputs), TIME_BINS))
        rows = len(self.model.record)
        for stretch, J in zip(self.data.stretches, self.data.unpadded(weighted), strict=True):
            place = np.arange(rows)[stretch.rows] * TIME_BINS // rows
            begins = np.flatnonzero(np.diff(place, prepend=-1))
            for total, direction in zip(
                found, directions.T, strict=True
            ):  # all at once would fill the memory
                along = np.tensordot(J, direction, (1, 0))
                total[:, place[begins]] += np.add.reduceat(along * (noise @ along), begins, axis=-1)
        return found.reshape(len(found), -1)

    def _output_errors(
        self, told: "_Sensitivity", noise: Array, covariance: Array, colored: ColoredErrors | None
    ) -> Array:
        """Return the standard errors (k, rows) of the outputs at this covariance of the columns of the Jacobian.

        `colored` are the errors where their correlation in time counts.
        """
        variance = _variances(told.weighted, noise, covariance)
        m = told.by_initial.shape[1]
        if m:
            meat = np.eye(m)
            if colored is not None:
                # Of directions of unit variance, the mean over the stretches that have them: known
                # states take some.
                pieces = self.data.unpadded(told.by_initial)
                scale = 1 / np.sqrt(
                    np.maximum(sum(piece.any(axis=(0, 2)).astype(int) for piece in pieces), 1)
                )
                meat = score_covariance(pieces, colored.spectrum) * scale * scale[:, None]
            variance += _variances(told.by_initial, noise, meat)

        error = np.full((len(self.outputs), len(self.model.record)), np.nan)
        values = self.data.unpadded(np.sqrt(np.maximum(variance, 0)))
        for stretch, each in zip(self.data.stretches, values, strict=True):
            error[:, stretch.rows] = np.where(np.isfinite(stretch.outputs), each, np.nan)
        return error

    def _jacobian(self, trajectory: Trajectory, weight: Array) -> "_Sensitivity":
        """Return how the residuals times `weight` follow the parameters, the initial states fitted along."""
        linearization = self.linearize(trajectory, weight)
        sensitivity = self.condense(
            linearization, trajectory, np.zeros(self.states)
        ).node_sensitivity.copy()
        initial_directions = self._initial_directions(linearization)
        noticed = np.sqrt(
            np.maximum(linearization.node_hessian.diagonal(axis1=1, axis2=2), 0.0).sum(axis=0)
        )
        del linearization  # of a long record, a tenth of what fits into memory
        forget_long_chain(self.data.segments)
        placed = trajectory.detail.placed
        known = self.model.known_states
        if known.any():
            sensitivity[np.ix_(self.data.begins_record, known)] = (
                placed.initial_slope[known] @ placed.slope
            )

        s, length, k, n = (
            self.data.segments,
            self.data.segment_length,
            len(self.outputs),
            self.states,
        )
        m = initial_directions.shape[2]
        by_initial = np.empty((k, m, s, length))
        p = trajectory.z.size
        weighted = np.empty((k, p, s, length))
        triangle = np.zeros((0, p))
        white = np.zeros((p, p))
        squares = np.zeros(p)
        for batch in self.segments.batches(s):
            _, J, _ = self.segments.sensitivities(
                trajectory.detail.states, placed.q, placed.data, batch
            )
            J = (weight @ J.reshape(length, k, -1)).reshape(J.shape)
            by_states = np.einsum("lknc,cnp->lkpc", J[:, :, :n], sensitivity[batch])
            by_parameters = placed.slope.T @ J[:, :, n:]
            squares += np.einsum("lkpc,lkpc->p", by_states, by_states)
            squares += np.einsum("lkpc,lkpc->p", by_parameters, by_parameters)
            root = by_states + by_parameters
            rows = np.moveaxis(root, 2, 0).reshape(p, -1)
            triangle = np.asarray(np.linalg.qr(np.vstack([triangle, rows.T]), mode="r"))
            white += rows @ rows.T
            weighted[:, :, batch] = np.einsum("ka,kpcl->apcl", weight, root.transpose(1, 2, 3, 0))
            directions = np.einsum("lknc,cnm->kmcl", J[:, :, :n], initial_directions[batch])
            by_initial[:, :, batch] = np.einsum("ka,kmcl->amcl", weight, directions)
        if placed.filter is not None:
            rows = self._covariance_rows(placed.filter, weight) @ placed.slope
            squares += (rows**2).sum(axis=0)
            triangle = np.asarray(np.linalg.qr(np.vstack([triangle, rows]), mode="r"))
            white += rows.T @ rows
        first = sensitivity[self.data.begins_stretch] * noticed[:, None]
        of_initial = by_initial.reshape(k, m, s * length)
        return _Sensitivity(
            triangle=triangle,
            white=white,
            weighted=weighted.reshape(k, p, s * length),
            by_initial=of_initial,
            shocks=partial(self._shocks, initial_directions, of_initial, weight),
            reach=np.sqrt(squares),
            initial={
                name: first[:, i] for i, name in enumerate(self.system.states) if not known[i]
            },
        )

    def _initial_directions(self, b: Linearization) -> Array:
        """Return how the nodes (s, n, m) move in the m directions of the initial states of every stretch.

        The directions are those of unit variance, for white errors and known parameters. The
        covariance K⁻¹ of the nodes of a stretch has the rank of its initial states, so that a few
        columns X = K⁻¹ R say all of it: it is X (Rᵀ X)⁻¹ Xᵀ. That holds for unstable models too,
        whose nodes do not follow from the first one.
        """
        s, n = self.data.segments, self.states
        if not n:
            return np.zeros((s, 0, 0))
        R = np.random.default_rng(0).normal(size=(s, n, n))
        R[np.ix_(self.data.begins_record, self.model.known_states)] = 0
        columns = 1 + b.cross_hessian.shape[2]  # as in `condense`, whose factorization then serves
        each = np.split(np.pad(R, ((0, 0), (0, 0), (0, -n % columns))), -(-n // columns), axis=2)
        exact = np.zeros(n)
        X = np.concatenate(
            [self._solve_continuity(b, own, np.zeros_like(own), exact)[0] for own in each], axis=2
        )
        X = X[:, :, :n]
        X[np.ix_(self.data.begins_record, self.model.known_states)] = 0
        result = np.zeros_like(X)
        starts = np.flatnonzero(self.data.begins_stretch)
        for rows in np.split(np.arange(s), starts[1:]):
            values, vectors = np.linalg.eigh(np.einsum("snm,snl->ml", R[rows], X[rows]))
            kept = values > DIRECTIONS * values[-1]
            result[rows, :, : kept.sum()] = X[rows] @ (vectors[:, kept] / np.sqrt(values[kept]))
        return result

    def _shocks(self, directions: Array, by_initial: Array, weight: Array) -> Array:
        """Return how the residuals of the longest stretch follow (k, n, samples) after unit jumps of the states.

        From the `directions` (s, n, m) of the initial states and what follows from these, WᵀW dy
        (k, m, samples). States whose jumps no output shows are left out, and those after which the
        outputs grow without end: then process noise has no spectrum.
        """
        longest = int(np.argmax([len(stretch) for stretch in self.data.stretches]))
        begins = directions[np.flatnonzero(self.data.begins_stretch)[longest]]
        scale = np.abs(begins).max(axis=1, initial=0.0)
        begins, scale = begins[scale > 0], scale[scale > 0, None]
        moved = np.linalg.pinv(begins / scale) / scale.T
        noise = np.linalg.inv(weight.T @ weight)
        shocks = np.tensordot(noise, self.data.unpadded(by_initial)[longest], 1)
        shocks = np.einsum("kmt,mn->knt", shocks, moved)

        samples = np.arange(shocks.shape[2])
        for response, measured in zip(shocks, self.data.stretches[longest].outputs, strict=True):
            there = np.isfinite(measured)
            for row in (
                response if there.any() and not there.all() else ()
            ):  # what is missing has no sensitivity
                row[:] = np.interp(samples, samples[there], row[there])
        power = (shocks**2).sum(axis=0)
        last = power[:, 3 * len(samples) // 4 :].mean(axis=1)
        return shocks[:, last < GROWS * power.mean(axis=1)]


@dataclass(frozen=True, eq=False)
class _Sensitivity:
    """How the weighted residuals of a record follow p parameters, the initial states fitted along.

    Attributes
    ----------
    triangle, white : (p, p) arrays
        A triangular factor of the Jacobian J, and JᵀJ.
    weighted : (k, p, samples) array
        WᵀJ.
    by_initial : (k, m, samples) array
        The same by m directions of unit variance of the initial states of every stretch, at known
        parameters.
    shocks : function
        How the residuals of the longest stretch follow after unit jumps of s states.
    reach : (p,) array
        Lengths of the columns of J if what states and parameters contribute to it could not cancel.
    initial : mapping of state to (stretches, p) array
        How the unknown initial states follow, in changes that the data notice.
    """

    triangle: Array
    white: Array
    weighted: Array
    by_initial: Array
    shocks: Callable[[], Array]
    reach: Array
    initial: Mapping[str, Array]


class RecordProgram(Program):
    """A record transcribed: states as unknowns, weighted residuals, continuity and known initial states as equations.

    Its parameters are the square root of the inverse residual covariance (k, k), then the data
    (width, samples), both column by column.
    """

    def __init__(self, part: RecordPart, z: ca.MX) -> None:
        """Transcribe the record."""
        self._part = part
        if part.model.driven:
            raise ValueError(
                f"{part.problem.name!r} has process_noise, whose gains {part.model.method.label} does not follow: "
                "use MultipleShooting()."
            )
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
        self._products = ca.Function(
            "products", [z, self.unknowns, self.parameters], [residuals @ residuals.T]
        )

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
        return np.concatenate(
            [weight.ravel(order="F"), self._part.segments.in_order(data).ravel(order="F")]
        )


def _variances(weighted: Array, noise: Array, covariance: Array) -> Array:
    """Return the variances (k, samples) of the outputs by a covariance (p, p), for WᵀJ (k, p, samples)."""
    found = np.empty((len(noise), weighted.shape[2]))
    for variance, row in zip(found, noise, strict=True):
        J = np.tensordot(row, weighted, 1)
        variance[:] = np.einsum("pt,pt->t", covariance @ J, J)
    return found


def _measured_rows(data: SampledData) -> Array:
    """Return measured outputs, zero where missing; one where they are present; and the step of every sample."""
    measured = data.measured
    return np.vstack([np.nan_to_num(measured), np.isfinite(measured), data.steps])


def compile_records(
    problems: Sequence[Problem], expressions: Mapping[str, Any], z: ca.SX, method: Transcription
) -> list[RecordPart]:
    """Compile records for the point z, of which `expressions` gives every parameter of a problem by outside name.

    Records of one model have one compiled sample, and one choice of substeps and segments where
    they are sampled alike.
    """
    models: list[RecordModel] = []
    local = [
        ca.vertcat(ca.SX(0, 1), *problem.local_values(expressions).values()) for problem in problems
    ]
    for problem, q in zip(problems, local, strict=True):
        models.append(record_model(problem, q, z, method, models))
    numbers: dict[int, int] = {}  # small ones: the same in every process, as hashes are not
    models = [
        replace(
            model, expressions=tuple(numbers.setdefault(e, len(numbers)) for e in model.expressions)
        )
        for model in models
    ]
    data = [
        sampled_data(
            model.record,
            model.system.inputs,
            model.outputs,
            lead=_longest_delay(model.problem, model.system),
            segment_length=1,
            complete=model.criterion.noise == "full" or bool(model.driven),
            static=model.problem.model.is_static,
        )
        for model in models
    ]
    for model, each in zip(models, data, strict=True):
        if model.criterion.noise == "full":
            require_independent(model.outputs, each.measured)
    lots: dict[Any, list[int]] = {}
    drawn = [drawn_parameters(problem) for problem in problems]
    for k, (model, points) in enumerate(zip(models, drawn, strict=True)):
        # Steps of a log are known to a thousandth, see `sampled_data`.
        lots.setdefault((id(model.steps), f"{model.record.step:.3g}", points.tobytes()), []).append(
            k
        )
    parts: dict[int, RecordPart] = {}
    for lot in lots.values():
        model, every = models[lot[0]], joined([data[k] for k in lot])
        looks = at_samples(every, max(every.segments // 100, 1), spread=True)

        def known_initial(q: Array, model: RecordModel = model) -> Array:
            return model.initial(np.pad(q, (0, len(model.parameters) - len(q))))[0].full().ravel()

        substeps, segment_length = substeps_and_segment(
            model.problem,
            drawn[lot[0]],
            method,
            model.system,
            model.initial_states,
            looks,
            known_initial,
        )
        for k in lot:
            cut = replace(data[k], segment_length=segment_length)
            parts[k] = RecordPart(models[k], cut, substeps)
    return [parts[k] for k in range(len(models))]


def record_model(
    problem: Problem, q: ca.SX, z: ca.SX, method: Transcription, others: Sequence[RecordModel] = ()
) -> RecordModel:
    """Compile what depends neither on the cut into segments nor on the substeps; `q` are the declared parameters at z.

    What is the same as in one of the `others`, of the same z, is shared with it.
    """
    assert isinstance(problem.data, Record)
    q = ca.vertcat(q, ca.SX.zeros(len(_parameters(problem)) - q.numel()))
    expressions = tuple(q[i].element_hash() for i in range(q.numel()))
    kin = next((other for other in others if _is_of_one_kind(problem, other)), None)
    twins = (
        other
        for other in others
        if kin and other.steps is kin.steps and other.expressions == expressions
    )
    twin = next(twins, None)
    if twin is not None:
        return replace(
            twin,
            problem=problem,
            record=problem.data,
            has_time=problem.data.has_time,
            outside_names=_outside_names(problem),
        )
    if kin is None:
        kin = _first_of_its_kind(problem, method)

    slope = ca.jacobian(q, z)
    following = range(len(problem.declared), q.numel())
    active = [i for i in range(q.numel()) if slope[i, :].nnz() or i in following]
    delay = kin.system.delay(q[: len(kin.system.parameters)])
    symbol = ca.SX.sym("q", q.numel())
    initial = kin.initial.call([symbol])[0]
    by_active = ca.densify(ca.jacobian(initial, symbol[active]))
    begin = problem.local_values({name: p.start for name, p in problem.parameters.items()})
    return replace(
        kin,
        problem=problem,
        begin=np.array([*begin.values()], dtype=float)[: len(kin.system.parameters)],
        record=problem.data,
        has_time=problem.data.has_time,
        outside_names=_outside_names(problem),
        active=np.array(active, dtype=int),
        locate=ca.Function("locate", [z], [q, ca.densify(slope[active, :]), ca.densify(delay)]),
        initial=ca.Function("initial", [symbol], [initial, by_active]),
        expressions=expressions,
    )


def _first_of_its_kind(problem: Problem, method: Transcription) -> RecordModel:
    """Compile what records of one kind share; what depends on z is left empty."""
    assert isinstance(problem.data, Record)
    assert isinstance(problem.criterion, TimeCriterion)
    criterion, known = problem.criterion, problem.criterion.initial
    system = dynamics(problem.model, delay_order(problem.delay))
    between = between_samples(criterion.inputs, system.inputs, problem.data)
    system = system.later([one.late for one in between])
    outputs = criterion.compared(problem.model, problem.data)
    parameters = _parameters(problem)
    symbol = ca.SX.sym("q", len(parameters))
    local = Names(
        dict(zip(problem.declared, ca.vertsplit(symbol), strict=False)), problem.model.label
    )
    states = [
        _called(f"initial[{name!r}]", known.get(name, math.nan), local) for name in system.states
    ]
    return RecordModel(
        problem=problem,
        record=problem.data,
        criterion=criterion,
        has_time=problem.data.has_time,
        errors_are_white=criterion.errors_are_white,
        is_prior=criterion.is_prior,
        method=method,
        system=system,
        between=between,
        outputs=outputs,
        parameters=parameters,
        outside_names=(),
        gains=criterion.gains(problem.model, outputs),
        driven=criterion.driven(),
        begin=np.zeros(0),
        active=np.zeros(0, dtype=int),
        locate=ca.Function(),
        initial=ca.Function("initial", [symbol], [ca.vertcat(ca.SX(0, 1), *states)]),
        known_states=np.array([name in known for name in system.states], dtype=bool),
        initial_states=InitialStates(
            system, outputs, scanned=method.strategies.scanned_initial_states
        ),
        steps={},
        expressions=(),
    )


def _is_of_one_kind(problem: Problem, other: RecordModel) -> bool:
    """Tell whether a record has the equations, the criterion, the outputs and the kind of inputs of another."""
    if problem.delay != other.problem.delay or not _is_same_model(
        problem.model, other.problem.model
    ):
        return False
    if not (problem.criterion is other.criterion or problem.criterion == other.criterion):
        return False
    assert isinstance(problem.data, Record)
    assert isinstance(problem.criterion, TimeCriterion)
    between = between_samples(problem.criterion.inputs, other.system.inputs, problem.data)
    compared = problem.criterion.compared(problem.model, problem.data)
    return (
        _parameters(problem) == other.parameters
        and compared == other.outputs
        and between == other.between
    )


def _is_same_model(a: Model, b: Model) -> bool:
    """Tell whether two models have one class and, where their arguments may differ, the same equations."""
    if a is b or type(a) is not type(b):
        return a is b
    plain = {"arguments": ((), {})}
    if vars(a) == plain == vars(b):
        return True
    first, second = (dynamics(model) for model in (a, b))
    same = (first.states, first.inputs, first.outputs) == (
        second.states,
        second.inputs,
        second.outputs,
    )
    functions = ("derivative", "output", "delay")
    return same and all(
        getattr(first, f).serialize() == getattr(second, f).serialize() for f in functions
    )


def _parameters(problem: Problem) -> tuple[str, ...]:
    """Return the names of the parameters of a sample: those declared, and gains that follow from process noise."""
    assert isinstance(problem.data, Record)
    assert isinstance(problem.criterion, TimeCriterion)
    if not problem.criterion.driven():
        return tuple(problem.declared)
    outputs = problem.criterion.compared(problem.model, problem.data)
    gains = problem.criterion.gains(problem.model, outputs)
    return (*problem.declared, *(f"K_{state}_{output}" for state, output in gains))


def _outside_names(problem: Problem) -> tuple[str, ...]:
    return tuple(
        problem.outside(name) if name in problem.declared else name for name in _parameters(problem)
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
