"""The cost of records and spectra at any points, with its first derivatives.

States are unknowns besides the parameters. They are either those of the smallest cost at every
point (profiled), or simulated from initial states that stay as they are.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Part, Trajectory
from greybox.engine.compiled.record_group import sharing
from greybox.engine.compiled.record_part import RecordPart
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.compiled.segmented_part import filter_information
from greybox.engine.compiled.segments import Linearization
from greybox.engine.compiled.transient_part import TransientPart
from greybox.engine.solve.gauss_newton.driver import DIVERGING, GaussNewton
from greybox.engine.solve.point_costs import PointCosts
from greybox.engine.solve.response_residuals import ResponseResiduals
from greybox.modeling.cached_property import cached_property

Nodes = Sequence[Array]


@frozen
class StatesAtPoint:
    """The trajectories of all parts at one point, and the cost; infinite where it has none."""

    trajectories: Sequence[Trajectory]
    cost: float


@frozen
class Slopes:
    """A part linearized at a point: how cost and nodes follow the solver's variables.

    Attributes
    ----------
    gradient, hessian : (p,) and (p, p) arrays
        Unweighted.
    by_nodes : (s, n, p) array
    """

    gradient: Array
    hessian: Array
    by_nodes: Array


class RecordCosts(PointCosts):
    """The cost of a problem whose parts have states. It remembers the last point.

    Attributes
    ----------
    solver : GaussNewton
    nodes : sequence of (s, n) arrays, or None
        States at the beginning of every segment with which a point begins.
    """

    is_exact = False

    def __init__(self, nlp: CompiledProblem, nodes: Nodes | None = None) -> None:
        """Take a compiled problem with states."""
        self.nlp = nlp
        self.nodes = nodes
        self._last: tuple[bytes, StatesAtPoint] | None = None

    @cached_property
    def solver(self) -> GaussNewton:
        """Return the solver of the states."""
        return GaussNewton(self.nlp)

    @abstractmethod
    def states(self, x: Array) -> StatesAtPoint:
        """Return the states at x (p,)."""

    @abstractmethod
    def slopes(self, part: Part, trajectory: Trajectory) -> Slopes:
        """Return the slopes of a part along a trajectory."""

    @property
    def is_least_squares(self) -> bool:
        """Whether all errors have given sizes."""
        return all(self._has_given_errors(part) for part in self.nlp.parts)

    @staticmethod
    def _has_given_errors(part: Part) -> bool:
        if isinstance(part, RecordPart):
            return part.covariance.known is not None and part.noise_model is None
        return isinstance(part, ResponsePart) and ResponseResiduals(part).is_least_squares

    @DIVERGING
    def at(self, x: Array) -> StatesAtPoint:
        """Return the states at x (p,), those of the last point without work."""
        # A solver asks for cost and gradient at one point after the other.
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.states(x)
        return self._last[1]

    def nodes_at(self, x: Array) -> Nodes | None:
        """Return the states at x (p,) at the beginning of every segment; None without a cost."""
        point = self.at(x)
        if not math.isfinite(point.cost):
            return None
        return tuple(trajectory.nodes for trajectory in point.trajectories)

    def costs(self, x: Array) -> Array:
        """Return the costs (r,) at x (r, p)."""
        return np.array([self.at(point).cost for point in x])

    def gradients(self, x: Array) -> Array:
        """Return the gradients (r, p) by z, at x (r, p)."""
        return np.array([self._quadratic(point)[0] for point in x])

    def hessians(self, x: Array) -> Array:
        """Return the Gauss-Newton Hessians (r, p, p) by z, at x (r, p)."""
        return np.array([self._quadratic(point)[1] for point in x])

    @DIVERGING
    def _quadratic(self, x: Array) -> tuple[Array, Array]:
        """Return the gradient (p,) and the Hessian (p, p) by z, at x (p,)."""
        point = self.at(x)
        p = len(x)
        if not math.isfinite(point.cost):
            return np.full(p, math.nan), np.full((p, p), math.nan)

        gradient, hessian = np.zeros(p), np.zeros((p, p))
        for part, trajectory in zip(self.nlp.parts, point.trajectories, strict=True):
            slopes = self.slopes(part, trajectory)
            gradient += part.weight * slopes.gradient
            hessian += part.weight * slopes.hessian
        return gradient, hessian

    # --- residuals

    def residuals(self, x: Array) -> Array:
        """Return the residuals (m,) at x (p,)."""
        return np.concatenate([errors for errors, _ in self._rows(x)])

    def jacobian(self, x: Array) -> Array:
        """Return the Jacobian (m, p) at x (p,), by the parameters."""
        return np.vstack([rows for _, rows in self._rows(x)])

    @DIVERGING
    def _rows(self, x: Array) -> list[tuple[Array, Array]]:
        """Return the residuals (m,) of every part at x (p,), with their derivatives (m, p) by x."""
        point = self.at(x)
        if not math.isfinite(point.cost):
            raise ValueError(f"there are no residuals at {x}: the model diverges there.")
        values = self.nlp.all_values(x)
        by_x = self.nlp.scaling.slope(x)
        result = []
        for part, trajectory in zip(self.nlp.parts, point.trajectories, strict=True):
            if isinstance(part, ResponsePart):
                response = ResponseResiduals(part)
                result.append((response.at(values), response.jacobian(values, len(x))))
                continue
            if isinstance(part, RecordPart):
                by_nodes = self.slopes(part, trajectory).by_nodes
                errors, rows = record_rows(part, trajectory, by_nodes)
            else:
                assert isinstance(part, TransientPart)
                errors, rows = part.rows(trajectory)
            size = math.sqrt(part.weight)
            result.append((size * errors, size * rows * by_x))
        return result


class ProfiledCosts(RecordCosts):
    """The cost with the states that make it smallest."""

    def states(self, x: Array) -> StatesAtPoint:
        """Return the best states at x (p,)."""
        # From good nodes a few steps suffice; where they lead nowhere, those of the data may not.
        profile = self.solver.profile_near(x, self.nodes) if self.nodes else None
        if profile is None or not profile.converged:
            profile = self.solver.profile(x)
        cost = profile.cost if profile.converged else math.inf
        return StatesAtPoint(profile.trajectories, cost)

    def slopes(self, part: Part, trajectory: Trajectory) -> Slopes:
        """Return the slopes where the nodes follow the parameters as the best ones do."""
        weight = part.residual_weight(trajectory)
        condensed = part.condense(part.linearize(trajectory, weight), trajectory, weight=weight)
        return Slopes(condensed.gradient, condensed.hessian, condensed.node_sensitivity)


class SimulatedCosts(RecordCosts):
    """The cost of one simulation from the first node of every stretch."""

    def states(self, x: Array) -> StatesAtPoint:
        """Return the simulated states at x (p,)."""
        z = self.nlp.scaling.to_solver(x)
        parts = self.nlp.parts
        nodes: Any = self.nodes or [None] * len(parts)
        run = [
            part.trajectory(z, own, simulated=True) for part, own in zip(parts, nodes, strict=True)
        ]
        run = sharing(parts, run)
        cost = math.inf
        if all(trajectory.finite for trajectory in run):
            cost = sum(part.weight * part.cost(t, 0.0) for part, t in zip(parts, run, strict=True))
        return StatesAtPoint(run, cost if math.isfinite(cost) else math.inf)

    def slopes(self, part: Part, trajectory: Trajectory) -> Slopes:
        """Return the slopes where the nodes follow from fixed or known initial states."""
        weight = part.residual_weight(trajectory)
        b = part.linearize(trajectory, weight)
        if not isinstance(part, RecordPart):
            gradient, hessian = b
            return Slopes(gradient, hessian, np.zeros((0, 0, len(gradient))))
        return simulated_slopes(part, trajectory, b)


def simulated_slopes(part: RecordPart, trajectory: Trajectory, b: Linearization) -> Slopes:
    """Return the slopes of a record whose nodes follow one another from the first."""
    by_q = trajectory.detail.slope
    following = b.parameter_sensitivity @ by_q
    by_nodes = np.zeros_like(following)
    for k in np.flatnonzero(part.data.coupled):
        by_nodes[k + 1] = b.transition[k] @ by_nodes[k] + following[k]

    cross = b.cross_hessian @ by_q
    mixed = np.einsum("snp,snq->pq", by_nodes, cross)
    own = np.einsum("snp,snm,smq->pq", by_nodes, b.node_hessian, by_nodes, optimize=True)
    gradient = by_q.T @ b.parameter_gradient[0]
    gradient += np.einsum("snp,sn->p", by_nodes, b.node_gradient)
    hessian = by_q.T @ b.parameter_hessian[0] @ by_q + mixed + mixed.T + own
    return Slopes(gradient, hessian, by_nodes)


def record_rows(part: RecordPart, trajectory: Trajectory, by_nodes: Array) -> tuple[Array, Array]:
    """Return the residuals (m,) in standard deviations, with their derivatives (m, p) by z.

    The nodes follow z by `by_nodes` (s, n, p). The noise is that of the trajectory. With process
    noise, further rows are what the covariance of the prediction errors contributes.
    """
    segments, placed = part.segments, trajectory.detail
    weight = part.residual_weight(trajectory)
    by_nodes = np.where(
        part.known_states[:, :, None], placed.initial_slope @ placed.slope, by_nodes
    )
    n = part.states
    errors, rows = [], []
    for batch in segments.batches():
        _, J = segments.sensitivities(trajectory.course, batch, weight)
        by_z = J[..., :n] @ by_nodes[batch] + J[..., n:-1] @ placed.slope
        errors.append(J[..., -1].ravel())
        rows.append(by_z.reshape(-1, by_z.shape[-1]))
    # Residuals of missing samples are zeros, which nobody asked for.
    present = np.isfinite(segments.by_segment(segments.columns(part.data.measured))).ravel()
    error, by_z = np.concatenate(errors)[present], np.vstack(rows)[present]
    if placed.filter is None:
        return error, by_z

    count = part.compared_samples
    information = filter_information(placed.filter, weight, count, len(part.model.active))
    excess = (np.eye(len(weight)) - weight @ trajectory.products @ weight.T / count).ravel()
    return (
        np.concatenate([error, math.sqrt(count / 2) * excess]),
        np.vstack([by_z, information @ placed.slope]),
    )
