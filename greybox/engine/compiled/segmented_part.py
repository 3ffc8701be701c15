"""The base class of a record, and of a group of records, that is cut into segments.

Trajectories, costs and linearizations of its segments follow from `Segments`. Added here are the
covariance that a steady filter predicts, known initial states, and the continuity of the segments.
"""

import math
from abc import abstractmethod
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import without
from greybox.engine.compiled.condensing import condense, solve_continuity, state_sizes
from greybox.engine.compiled.part import ASSUMED_ERROR, Condensed, Part, Trajectory
from greybox.engine.compiled.record_model import RecordModel
from greybox.engine.compiled.residual_covariance import ResidualCovariance, diagonal
from greybox.engine.compiled.riccati import SteadyFilter
from greybox.engine.compiled.sampled_data import SampledData
from greybox.engine.compiled.segments import Course, Linearization, Segments
from greybox.modeling.cached_property import cached_property
from greybox.modeling.formulation.problem import Problem
from greybox.statistics.correlation_statistics import whiteness

# A jump of three standard deviations of a signal, in units of the assumed output error.
JUMP = 3.0 / ASSUMED_ERROR


@frozen
class Placed:
    """The parameters and data of records at one point z of the solver.

    Attributes
    ----------
    q : (declared,) array
        Values of all declared parameters; (declared, s) with a column for every segment if the
        records have parameters of their own.
    slope : (active, p) or (records, active, p) array
        Derivatives by z of the active parameters, which are the estimated ones of the model.
    data : (width, columns) array
        The data of all samples, with the inputs shifted by their delays.
    initial : (n,) or (records, n) array
        Known initial states; NaN where a state is unknown.
    initial_slope : (n, active) or (records, n, active) array
        Derivatives of the initial states by the active parameters.
    filter : SteadyFilter or None
        The filter of estimated process noise; its gain is in `q` and `slope`.
    """

    q: Array
    slope: Array
    data: Array
    initial: Array
    initial_slope: Array
    filter: SteadyFilter | None = None

    def along(self, states: Array) -> Course:
        """Return the arguments of functions of the segments along states (n, columns)."""
        return Course(states, self.q, self.data)


class SegmentedPart(Part):
    """Records of one model, cut into segments, with the step from sample to sample.

    Attributes
    ----------
    model : RecordModel
        The model of the record, or of the first one of a group.
    data : SampledData
    step : SampleStep
    segments : Segments
    covariance : ResidualCovariance
    """

    has_states = has_nodes = is_likelihood = True
    # The last result of `data_at`, and the whole samples of the delays for which it holds.
    _placed_data: tuple[Array, Array] | None = None
    # The last result of `linearize`: trajectory, weight and linearization.
    _linearized: Any = None

    def __init__(
        self,
        model: RecordModel,
        data: SampledData,
        segments: Segments,
        covariance: ResidualCovariance,
    ) -> None:
        """Store the arguments; name and weight are those of the model."""
        self.name = model.name
        self.weight = model.weight
        self.model = model
        self.data = data
        self.segments = segments
        self.step = segments.step
        self.covariance = covariance
        self.system = model.system
        self.outputs = model.outputs
        self.states = len(model.system.states)
        # Number of the states of the model itself. Those of delays come last and follow from the
        # inputs alone.
        self.driven = len((model.system.undelayed or model.system).states)
        self.substeps = self.step.substeps
        self.samples = data.samples  # padding of segments included
        self.numbers = int(covariance.counts.sum())
        # The variances of a filter or of a prior are not estimated.
        is_estimated = not (model.driven or model.is_prior)
        self.few = covariance.few() if is_estimated else 0 * covariance.counts
        self.unknown_initial_states = int((~self.known_states[data.begins_stretch]).sum())

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the results for the last delays and the last trajectory, which are large."""
        return without(super().__getstate__(), ("_placed_data", "_linearized"))

    @property
    def problem(self) -> Problem:
        """The problem; only in the process that has compiled it."""
        return self.model.problem

    @property
    def noise_group(self) -> Any:
        """A key that is equal for records of one model with the same compared outputs."""
        return id(self.model.steps)

    # --- placement

    @abstractmethod
    def place(self, z: Array) -> Placed:
        """Return the parameters and the data at z (p,)."""

    @abstractmethod
    def initial_nodes(self, q: Array, known: Array) -> Array:
        """Return nodes (s, n) from the data, for `q` and `initial` of `Placed`."""

    def data_at(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), with inputs shifted by delays (m,).

        Only whole samples shift the data, and the rest of a delay is a parameter in q. The array is
        that of the last call until a delay passes the next whole sample.
        """
        whole = self.data.whole_samples(delays)
        if self._placed_data is None or not np.array_equal(self._placed_data[0], whole):
            self._placed_data = (whole, self.segments.columns(self.data.rows(delays)))
        return self._placed_data[1]

    @cached_property
    def known_states(self) -> BoolArray:
        """Which states (s, n) are known at the beginning of a segment.

        Known are the states of delays at the beginning of every stretch, and at the beginning of a
        record also the initial states that the user states.
        """
        known = np.zeros((self.segments.count, self.states), dtype=bool)
        begins = self.data.begins_stretch
        at_first = np.array([stretch.rows[0] == 0 for stretch in self.data.stretches])
        known[begins] = at_first[:, None] & self.model.known_states
        known[begins, self.driven :] = True
        return known

    @cached_property
    def delays_at_rest(self) -> Array:
        """States (s, n) of delays whose input was constant before a stretch; zero elsewhere."""
        states = np.zeros((self.segments.count, self.states))
        if self.system.undelayed:
            first = np.array([stretch.inputs[:, 0] for stretch in self.data.stretches])
            delays = self.system.delay_rest(first.T).full().T
            states[self.data.begins_stretch, self.driven :] = delays
        return states

    # --- trajectories

    def trajectory(
        self, z: Array, nodes: Array | None = None, *, simulated: bool = False
    ) -> Trajectory:
        """Return the trajectory at z (p,) from nodes (s, n), the states where segments begin.

        By default the nodes come from the data, see `record_model`. If it is `simulated`, only the
        first node of each stretch is used, and the other nodes follow from the simulation.
        """
        placed = self.place(z)
        if nodes is None:
            nodes = self.initial_nodes(placed.q, placed.initial)
        segments = self.segments
        at = (placed.q, placed.data)
        initial = placed.initial
        if initial.ndim == 2:
            # From a row for every record to a row for every segment.
            initial = initial[segments.records]
        nodes = np.where(self.known_states, initial + self.delays_at_rest, nodes)
        gaps = np.zeros_like(nodes)
        if simulated:
            states, ends = segments.simulate_stretches(self.data.segment_counts, nodes, *at)
            nodes = states[:, : segments.count].T.copy()
        else:
            states, ends = segments.simulate(nodes, *at)
            gaps[:-1] = ends[:-1] - nodes[1:]
            # The last segment of a stretch has no next node.
            gaps[~self.data.coupled] = 0

        products = segments.products(segments.residuals(placed.along(states)))
        # Only the products of several records keep their axis of records.
        if segments.number == 1:
            products = products[0]
        return Trajectory(z, nodes, ends, gaps, products, simulated, states, placed)

    def residuals(self, trajectory: Trajectory) -> Array:
        """Return the residuals (k, samples) in the order of the samples, zero if missing."""
        return self.segments.in_order(self.segments.residuals(trajectory.course))

    def simulated_outputs(self, trajectory: Trajectory) -> Array:
        """Return the outputs (k, samples) along a trajectory, in the order of the samples."""
        return self.segments.in_order(self.segments.outputs(trajectory.course))

    def explains_data(self, trajectory: Trajectory) -> bool:
        """Return whether the residuals of all outputs are white.

        Rows without a time have no order in which residuals could be correlated.
        """
        if not self.model.has_time:
            return False
        present = np.isfinite(self.data.measured)
        stretches = self.data.unpadded(np.where(present, self.residuals(trajectory), np.nan))
        # Of a hundred records with white residuals, one is not recognized.
        level = 0.01 / len(self.outputs)
        return all(
            whiteness(output_stretches).p_value > level
            for output_stretches in zip(*stretches, strict=True)
        )

    def signature(self, trajectory: Trajectory) -> Array:
        """Return at most about 500 samples of every simulated output, in units of its spread.

        All outputs are in one vector.
        """
        spread = np.atleast_2d(self.covariance.spread)[self.segments.records].T
        spread = np.repeat(spread, self.data.segment_length, axis=1)
        scaled = self.simulated_outputs(trajectory) / spread
        every = max(scaled.shape[1] // 500, 1)
        return scaled[:, ::every].ravel()

    # --- cost

    def cost(self, trajectory: Trajectory, smoothing: float = 0.0) -> float:
        """Return the negative log-likelihood of the residuals along a trajectory."""
        return self.covariance_along(trajectory).cost(trajectory.products)

    def squared_cost(self, trajectory: Trajectory, weight: Array) -> float:
        """Return half the sum of squares of the residuals multiplied by `weight` (k, k)."""
        return float(np.sum((weight @ trajectory.products) * weight)) / 2

    def covariance_along(self, trajectory: Trajectory) -> ResidualCovariance:
        """Return the covariance of the residuals; that of the steady filter, if there is one."""
        steady = trajectory.detail.filter
        if steady is None:
            return self.covariance
        return replace(self.covariance, predicted=steady.covariance)

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return W (k, k), where WᵀW is the inverse residual covariance of a trajectory."""
        return self.covariance_along(trajectory).weight(trajectory.products)

    def initial_weight(self) -> Array:
        """Return W (k, k) for residuals of the size `ASSUMED_ERROR` times the signal's spread."""
        return diagonal(1 / (ASSUMED_ERROR * self.covariance.spread))

    # --- linearization

    def linearize(self, trajectory: Trajectory, weight: Array) -> Linearization:
        """Return the linearization along a trajectory, without known initial states.

        `weight` (k, k) multiplies the residuals.
        """
        # Polishing ends with a linearization that is also needed for the standard errors.
        if self._linearized is not None:
            last_trajectory, last_weight, last = self._linearized
            self._linearized = None
            if last_trajectory is trajectory and np.array_equal(last_weight, weight):
                return last
            # The old one is freed before a new one is made: of a long record, it takes a sixth of
            # the memory.
            del last_trajectory, last_weight, last

        placed: Placed = trajectory.detail
        linearization = self.segments.linearize(trajectory.course, weight)
        # With another weight, the merit does not contain the filter's covariance.
        if placed.filter is not None and np.array_equal(weight, self.residual_weight(trajectory)):
            linearization = with_filter_covariance(
                linearization, placed.filter, weight, trajectory.products, self.compared_samples
            )

        linearization = without_known_states(
            linearization, self.known_states, placed.initial_slope, self.segments.records
        )
        self._linearized = trajectory, weight, linearization
        return linearization

    @property
    def compared_samples(self) -> int:
        """Number of samples at which some output is compared."""
        return int(self.covariance.counts.max())

    def continuity_variance(self, linearization: Linearization) -> Array:
        """Return the variances (n,) of jumps of the states between segments.

        Jumps of this size move the outputs of a segment by `JUMP`.
        """
        samples = self.data.segment_length * len(self.outputs)
        sizes = state_sizes(linearization.node_hessian, linearization.transition)
        variance = JUMP**2 * samples * sizes**2
        # If the states of delays could jump, they would act as another input.
        variance[self.driven :] = 0
        return variance

    def condense(
        self,
        linearization: Linearization,
        trajectory: Trajectory,
        continuity_variance: Array | None = None,
        damping: float = 0.0,
        *,
        weight: Array | None = None,
    ) -> Condensed:
        """Eliminate the nodes, see `greybox.engine.compiled.condensing`.

        `continuity_variance` (n,) are the variances of jumps of the states between segments. With
        the `weight` (k, k) of the residuals, steps of unknown initial states are limited.
        """
        variance = np.zeros(self.states) if continuity_variance is None else continuity_variance
        largest = None
        if weight is not None and self.unknown_initial_states:
            # The same size of jumps, now in units of the errors that the weight expresses.
            signals = (weight * self.covariance.spread[..., None, :]) ** 2
            size = signals.sum(axis=(-1, -2)).mean() / len(self.outputs)
            # The variances follow from mean transitions. If transitions change by decades along a
            # record, as in kinetics, these means would hold initial states on which the outputs
            # inform well. The segments at the beginning are therefore considered alone as well.
            begins = self.data.begins_stretch
            first = linearization._replace(
                node_hessian=linearization.node_hessian[begins],
                transition=linearization.transition[begins],
            )
            jumps = np.maximum(
                self.continuity_variance(linearization), self.continuity_variance(first)
            )
            largest = ASSUMED_ERROR**2 * size * jumps
        return condense(
            linearization, trajectory, variance, damping, self.data, self.segments, largest
        )

    def close_gaps(
        self, linearization: Linearization, trajectory: Trajectory, held: Array
    ) -> Array:
        """Return the nodes (s, n) that close the gaps with the least change of the outputs.

        `held` is added to the Hessians (s, n, n) of the nodes.
        """
        gaps = -trajectory.gaps[:, :, None]
        step, _ = solve_continuity(
            linearization.node_hessian + held,
            linearization.transition,
            self.data.coupled,
            np.zeros_like(gaps),
            gaps,
        )
        return trajectory.nodes + step[:, :, 0]


def with_filter_covariance(
    b: Linearization, steady: SteadyFilter, weight: Array, products: Array, count: int
) -> Linearization:
    """Return a linearization with the information from the covariance of a steady filter.

    `products` (k, k) are the sums of products of the residuals over `count` samples.
    """
    rows = filter_information(steady, weight, count, b.parameter_hessian.shape[1])
    # Zero where the residuals have the covariance that the filter predicts.
    excess = (np.eye(len(weight)) - weight @ products @ weight.T / count).ravel()
    return b._replace(
        parameter_hessian=b.parameter_hessian + rows.T @ rows,
        parameter_gradient=b.parameter_gradient + math.sqrt(count / 2) * rows.T @ excess,
    )


def filter_information(steady: SteadyFilter, weight: Array, count: int, active: int) -> Array:
    """Return J (k², active), where JᵀJ is the information from the covariance S of the errors.

    Besides the information from the mean of the prediction errors, the Fisher information on the
    parameters contains n/2 tr(S⁻¹ dS S⁻¹ dS).
    """
    change = weight @ np.moveaxis(steady.covariance_slope, -1, 0) @ weight.T
    rows = math.sqrt(count / 2) * change.reshape(len(change), -1).T
    return np.pad(rows, ((0, 0), (0, active - len(change))))


def without_known_states(
    b: Linearization, known: BoolArray, initial_slope: Array, records: IntArray
) -> Linearization:
    """Return the linearization without the known states, which follow from the parameters.

    A known state is x₀ + (dx/dq) dq. The linearization is changed in place.

    Parameters
    ----------
    b : Linearization
    known : (s, n) array of bool
    initial_slope : (n, q) or (records, n, q) array
        dx/dq.
    records : (s,) array of int
        The record of every segment.
    """
    for k in np.flatnonzero(known.any(axis=1)):
        record, is_known = records[k], known[k]
        all_slopes = initial_slope if initial_slope.ndim == 2 else initial_slope[record]
        slope = np.where(is_known[:, None], all_slopes, 0.0)
        mixed = slope.T @ b.cross_hessian[k]
        b.parameter_hessian[record] += mixed + mixed.T + slope.T @ b.node_hessian[k] @ slope
        b.parameter_gradient[record] += slope.T @ b.node_gradient[k]
        b.cross_hessian[k] += b.node_hessian[k] @ slope
        b.parameter_sensitivity[k] += b.transition[k] @ slope

        # Without derivatives, the ridge of the elimination holds these states.
        b.node_hessian[k, is_known, :] = 0
        b.node_hessian[k, :, is_known] = 0
        b.cross_hessian[k, is_known] = 0
        b.node_gradient[k, is_known] = 0
        b.transition[k, :, is_known] = 0

    return b
