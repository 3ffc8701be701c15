"""Records cut into segments: what one record and a group of them have in common.

The linearization of records beyond their segments: steady filters, known initial states.
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

# Three standard deviations of a signal, in assumed output errors.
JUMP = 3.0 / ASSUMED_ERROR


@frozen
class Placed:
    """The parameters and data of records at one point z of the solver.

    Attributes
    ----------
    q : (declared,) array
        Values of all declared parameters; (declared, s), for every segment, where the records have
        parameters of their own.
    slope : (active, p) or (records, active, p) array
        Derivatives of the estimated ones by z.
    data : (width, columns) array
        The data, with the inputs placed for these delays.
    initial, initial_slope : (n,) and (n, active) arrays, or with `records` before
        Known initial states and their derivatives by the active parameters; NaN where a state is
        unknown.
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
        """Return where functions of the segments are evaluated along states (n, columns)."""
        return Course(states, self.q, self.data)


class SegmentedPart(Part):
    """Records of one model, cut into segments, and the step from sample to sample.

    Attributes
    ----------
    model : RecordModel
        The model of the first of several records.
    data : SampledData
    step : SampleStep
    segments : Segments
    covariance : ResidualCovariance
    """

    has_states = has_nodes = is_likelihood = True
    _placed_data: tuple[Array, Array] | None = None
    _linearized: Any = None  # trajectory, weight and linearization

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
        # The states of delays, which come last, follow from the inputs alone.
        self.driven = len((model.system.undelayed or model.system).states)
        self.substeps = self.step.substeps
        self.samples = data.samples  # padding of segments included
        self.numbers = int(covariance.counts.sum())
        # The variances of a filter or of a prior are not estimated.
        is_estimated = not (model.driven or model.is_prior)
        self.few = covariance.few() if is_estimated else 0 * covariance.counts
        self.unknown_initial_states = int((~self.known_states[data.begins_stretch]).sum())

    def __getstate__(self) -> dict[str, Any]:
        """Leave the results for the last delays and the last trajectory, which are large."""
        return without(super().__getstate__(), ("_placed_data", "_linearized"))

    @property
    def problem(self) -> Problem:
        """The problem, where it was compiled."""
        return self.model.problem

    @property
    def noise_group(self) -> Any:
        """Equal for records of one model and the same compared outputs."""
        return id(self.model.steps)

    # --- placement

    @abstractmethod
    def place(self, z: Array) -> Placed:
        """Return the parameters and the data at z (p,)."""

    @abstractmethod
    def initial_nodes(self, q: Array, known: Array) -> Array:
        """Return nodes (s, n) from the data, for q and known initial states as in `Placed`."""

    def data_at(self, delays: Array) -> Array:
        """Return the data of all samples, (width, columns), inputs placed for these delays (m,).

        The same array as the last time, as long as no delay has passed a whole sample.
        """
        # The fraction of a delay enters through q; only its whole samples select other data.
        whole = self.data.whole_samples(delays)
        if self._placed_data is None or not np.array_equal(self._placed_data[0], whole):
            self._placed_data = (whole, self.segments.columns(self.data.rows(delays)))
        return self._placed_data[1]

    @cached_property
    def known_states(self) -> BoolArray:
        """Which states (s, n) are known at the beginning of a segment: stated ones, and delays."""
        known = np.zeros((self.segments.count, self.states), dtype=bool)
        begins = self.data.begins_stretch
        at_first = np.array([stretch.rows[0] == 0 for stretch in self.data.stretches])
        known[begins] = at_first[:, None] & self.model.known_states
        known[begins, self.driven :] = True
        return known

    @cached_property
    def delays_at_rest(self) -> Array:
        """Return the states (s, n) of delays that rest at the first input of a stretch, else 0."""
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
        """Return the trajectory at z (p,) from nodes (s, n), or `simulated` from the first ones.

        By default the nodes come from the data, see `record_model`.
        """
        placed = self.place(z)
        nodes = self.initial_nodes(placed.q, placed.initial) if nodes is None else nodes
        segments = self.segments
        at = (placed.q, placed.data)
        initial = placed.initial if placed.initial.ndim == 1 else placed.initial[segments.records]
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
        # The products of several records have an axis of records.
        products = products[0] if segments.number == 1 else products
        return Trajectory(z, nodes, ends, gaps, products, simulated, states, placed)

    def residuals(self, trajectory: Trajectory) -> Array:
        """Return the residuals (k, samples) in the order of the samples, zero if missing."""
        return self.segments.in_order(self.segments.residuals(trajectory.course))

    def simulated_outputs(self, trajectory: Trajectory) -> Array:
        """Return the outputs (k, samples) along a trajectory, in the order of the samples."""
        return self.segments.in_order(self.segments.outputs(trajectory.course))

    def explains_data(self, trajectory: Trajectory) -> bool:
        """Return whether all residuals are white; rows without a time have no order."""
        if not self.model.has_time:
            return False
        present = np.isfinite(self.data.measured)
        stretches = self.data.unpadded(np.where(present, self.residuals(trajectory), np.nan))
        tests = map(whiteness, zip(*stretches, strict=True))

        # One of a hundred records with white residuals is not recognized.
        return all(test.p_value > 0.01 / len(self.outputs) for test in tests)

    def signature(self, trajectory: Trajectory) -> Array:
        """Return up to some 500 samples of every simulated output, in units of its spread."""
        spread = np.atleast_2d(self.covariance.spread)[self.segments.records].T
        spread = np.repeat(spread, self.data.segment_length, axis=1)
        scaled = self.simulated_outputs(trajectory) / spread
        return scaled[:, :: max(scaled.shape[1] // 500, 1)].ravel()

    # --- cost

    def cost(self, trajectory: Trajectory, smoothing: float = 0.0) -> float:
        """Return the negative log-likelihood of the residuals along a trajectory."""
        return self.covariance_along(trajectory).cost(trajectory.products)

    def squared_cost(self, trajectory: Trajectory, weight: Array) -> float:
        """Return half the sum of squares of the residuals times `weight`."""
        return float(np.sum((weight @ trajectory.products) * weight)) / 2

    def covariance_along(self, trajectory: Trajectory) -> ResidualCovariance:
        """Return the residual covariance, or that of the steady filter."""
        steady = trajectory.detail.filter
        if steady is None:
            return self.covariance
        return replace(self.covariance, predicted=steady.covariance)

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return W (k, k), where WᵀW is the inverse residual covariance of a trajectory."""
        return self.covariance_along(trajectory).weight(trajectory.products)

    def initial_weight(self) -> Array:
        """Return W (k, k) for residuals of `ASSUMED_ERROR` of each signal's spread."""
        return diagonal(1 / (ASSUMED_ERROR * self.covariance.spread))

    # --- linearization

    def linearize(self, trajectory: Trajectory, weight: Array) -> Linearization:
        """Linearize along a trajectory, known initial states eliminated."""
        # Polishing ends with the linearization from which the standard errors follow.
        last, self._linearized = self._linearized, None
        if last and last[0] is trajectory and np.array_equal(last[1], weight):
            return last[2]
        del last  # for a long record, a sixth of the memory
        placed: Placed = trajectory.detail
        b = self.segments.linearize(trajectory.course, weight)
        if placed.filter is not None and np.array_equal(weight, self.residual_weight(trajectory)):
            # With weights other than the filter's own, the merit does not contain its covariance.
            count = self.compared_samples
            b = with_filter_covariance(b, placed.filter, weight, trajectory.products, count)

        records = self.segments.records
        b = without_known_states(b, self.known_states, placed.initial_slope, records)
        self._linearized = trajectory, weight, b
        return b

    @property
    def compared_samples(self) -> int:
        """Samples at which an output is compared."""
        return int(self.covariance.counts.max())

    def continuity_variance(self, linearization: Linearization) -> Array:
        """Return the variances (n,) of state jumps that move a segment's outputs by `JUMP`."""
        samples = self.data.segment_length * len(self.outputs)
        sizes = state_sizes(linearization.node_hessian, linearization.transition)
        variance = JUMP**2 * samples * sizes**2
        # With gaps, the states of a delay would be another input.
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
        """Eliminate the nodes, see `greybox.engine.compiled.condensing`."""
        variance = np.zeros(self.states) if continuity_variance is None else continuity_variance
        largest = None
        if weight is not None and self.unknown_initial_states:
            # The same jumps in units of the errors that the weight stands for.
            signals = (weight * self.covariance.spread[..., None, :]) ** 2
            size = signals.sum(axis=(-1, -2)).mean() / len(self.outputs)
            # Where transitions change by decades along a record, as in kinetics, their means would
            # hold initial states that the outputs show.
            begins = self.data.begins_stretch
            H, A = linearization.node_hessian[begins], linearization.transition[begins]
            first = linearization._replace(node_hessian=H, transition=A)
            variances = map(self.continuity_variance, (linearization, first))
            largest = ASSUMED_ERROR**2 * size * np.maximum(*variances)
        return condense(
            linearization, trajectory, variance, damping, self.data, self.segments, largest
        )

    def close_gaps(
        self, linearization: Linearization, trajectory: Trajectory, held: Array
    ) -> Array:
        """Return the nodes (s, n) that close the gaps with the least change of the outputs."""
        gaps = -trajectory.gaps[:, :, None]
        hessian, transition = linearization.node_hessian + held, linearization.transition
        x, _ = solve_continuity(hessian, transition, self.data.coupled, np.zeros_like(gaps), gaps)
        return trajectory.nodes + x[:, :, 0]


def with_filter_covariance(
    b: Linearization, steady: SteadyFilter, weight: Array, products: Array, count: int
) -> Linearization:
    """Add what the covariance of a steady filter contributes over `count` samples."""
    rows = filter_information(steady, weight, count, b.parameter_hessian.shape[1])
    # Zero where the residuals have the covariance that the filter predicts.
    excess = (np.eye(len(weight)) - weight @ products @ weight.T / count).ravel()
    return b._replace(
        parameter_hessian=b.parameter_hessian + rows.T @ rows,
        parameter_gradient=b.parameter_gradient + math.sqrt(count / 2) * rows.T @ excess,
    )


def filter_information(steady: SteadyFilter, weight: Array, count: int, active: int) -> Array:
    """Return J (k², active); JᵀJ is the information of the prediction errors' covariance S.

    The Fisher information on the parameters is n/2 tr(S⁻¹ dS S⁻¹ dS), beside that of the mean.
    """
    change = weight @ np.moveaxis(steady.covariance_slope, -1, 0) @ weight.T
    rows = math.sqrt(count / 2) * change.reshape(len(change), -1).T
    return np.pad(rows, ((0, 0), (0, active - len(change))))


def without_known_states(
    b: Linearization, known: BoolArray, initial_slope: Array, records: IntArray
) -> Linearization:
    """Return the linearization, changed in place: `known` states (s, n) follow the parameters.

    x = x' + (dx/dq) dq, with x' constant. `initial_slope` is dx/dq, (n, q) or one for every record.
    """
    for k in np.flatnonzero(known.any(axis=1)):
        record, is_known = records[k], known[k]
        slope = initial_slope if initial_slope.ndim == 2 else initial_slope[record]
        follow = np.where(is_known[:, None], slope, 0.0)
        mixed = follow.T @ b.cross_hessian[k]
        b.parameter_hessian[record] += mixed + mixed.T + follow.T @ b.node_hessian[k] @ follow
        b.parameter_gradient[record] += follow.T @ b.node_gradient[k]
        b.cross_hessian[k] += b.node_hessian[k] @ follow
        b.parameter_sensitivity[k] += b.transition[k] @ follow

        # The ridge of the elimination holds states that nothing moves.
        b.node_hessian[k, is_known, :] = 0
        b.node_hessian[k, :, is_known] = 0
        b.cross_hessian[k, is_known] = 0
        b.node_gradient[k, is_known] = 0
        b.transition[k, :, is_known] = 0

    return b
