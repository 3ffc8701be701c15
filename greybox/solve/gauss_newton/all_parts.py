"""All parts of a problem along one iterate: trajectories, cost, and what a step makes of them."""

import math
from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np

from greybox.compiled.kalman_gain import kalman_gain
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_group import Groups
from greybox.compiled.response_part import SMOOTHING
from greybox.compiled.strategies import Strategies
from greybox.files.arrays import Array
from greybox.solve.constraints import Limits
from greybox.solve.gauss_newton.iterate import Iterate, Nodes, Step

# A second-order correction goes on as long as it halves the penalty of the gaps, and until what is
# left of it is a hundredth of the predicted decrease, which no decision of the line search depends
# on.
CLOSED = 0.01


class AllParts:
    """The parts of one problem, whose costs add, with the Kalman gains of those that have one, limits and settings.

    Records that can be evaluated together are one part here: `joined` and `nodes_by_part` are
    between the two.
    """

    def __init__(self, parts: tuple[Part, ...], limits: Limits, settings: Strategies) -> None:
        """Look for the gains."""
        self._groups = Groups(parts)
        self.parts = self._groups.parts
        self.weights = [part.weight for part in self.parts]
        self.gains = [kalman_gain(part) for part in self.parts]
        self.limits = limits
        self.settings = settings

    def within(self, limits: Limits) -> "AllParts":
        """Return the same parts with other limits."""
        other = copy(self)
        other.limits = limits
        return other

    # --- iterates

    def at(self, z: Array, nodes: Nodes, like: Iterate | None = None) -> Iterate:
        """Return the iterate at z with these nodes; simulated where the trajectories of `like` are."""
        simulated = [t.simulated for t in like.trajectories] if like else [False] * len(nodes)
        return self._at(z, nodes, simulated)

    def from_data(self, z: Array) -> Iterate:
        """Return the iterate at z whose nodes come from the data."""
        return Iterate(z, tuple(part.initial_trajectory(z) for part in self.parts))

    def joined(self, nodes: Nodes) -> Nodes:
        """Return the nodes as an iterate has them, given those of the parts of the problem."""
        return self._groups.joined(nodes)

    def nodes_by_part(self, iterate: Iterate) -> tuple[Array, ...]:
        """Return the nodes of the parts of the problem."""
        return tuple(self._groups.nodes_by_part(iterate.nodes))

    def split(self, iterate: Iterate) -> tuple[Trajectory, ...]:
        """Return the trajectories of the parts of the problem."""
        return tuple(self._groups.split(iterate.trajectories))

    def simulated(self, z: Array, nodes: Nodes) -> Iterate:
        """Return the iterate at z simulated from the first node of every stretch to its end."""
        return self._at(z, nodes, [True] * len(nodes))

    def _at(self, z: Array, nodes: Nodes, simulated: Sequence[bool]) -> Iterate:
        each = zip(self.parts, nodes, simulated, strict=True)
        return Iterate(
            z,
            tuple(part.trajectory(z, n, simulated=is_simulated) for part, n, is_simulated in each),
        )

    def stays_near_data(self, iterate: Iterate) -> bool:
        """Tell whether the outputs stay where the data are, which those of an unstable simulation do not."""
        factor = self.settings.lost_simulation
        return iterate.finite and all(
            part.is_near_data(trajectory, factor) for part, trajectory in self._pairs(iterate)
        )

    def explain_data(self, iterate: Iterate) -> bool:
        """Tell whether all residuals look like noise."""
        return all(part.explains_data(trajectory) for part, trajectory in self._pairs(iterate))

    def is_continuous(self, iterate: Iterate) -> bool:
        """Tell whether what gaps are left is rounding."""
        tolerance = self.settings.gap_rounding
        return all(
            np.all(
                np.abs(t.gaps).max(axis=0, initial=0.0)
                <= tolerance * np.abs(t.nodes).max(axis=0, initial=0.0)
            )
            for t in iterate.trajectories
        )

    def signature(self, iterate: Iterate) -> Array:
        """Return numbers by which runs are told apart, see `Part.signature`."""
        return np.concatenate(
            [part.signature(trajectory) for part, trajectory in self._pairs(iterate)]
        )

    # --- cost

    def cost(self, iterate: Iterate, smoothing: float = SMOOTHING) -> float:
        """Return the cost, infinite where anything diverges."""
        if not iterate.finite:
            return math.inf
        return float(sum(part.weight * part.cost(t, smoothing) for part, t in self._pairs(iterate)))

    def squared_cost(self, iterate: Iterate, residual_weights: Sequence[Array]) -> float:
        """Return the cost with given residual weights, half the sum of squares, of an iterate that is finite."""
        each = zip(self.parts, iterate.trajectories, residual_weights, strict=True)
        return float(
            sum(part.weight * part.squared_cost(t, weight, SMOOTHING) for part, t, weight in each)
        )

    def gap_cost(self, iterate: Iterate, multipliers: Sequence[Array]) -> float:
        """Return the l1 penalty of the gaps, with multipliers (n,) for every state."""
        each = zip(self.parts, iterate.trajectories, multipliers, strict=True)
        return sum(part.weight * float((np.abs(t.gaps) * m).sum()) for part, t, m in each)

    def squared_gap_cost(self, iterate: Iterate, variances: Sequence[Array]) -> float:
        """Return the quadratic penalty of the gaps, with variances (n,) for every state."""
        each = zip(self.parts, iterate.trajectories, variances, strict=True)
        return sum(
            part.weight * float((t.gaps**2 / variance).sum()) / 2 for part, t, variance in each
        )

    def residual_weights(self, iterate: Iterate) -> list[Array]:
        """Return square roots of the inverse covariances that the residuals show."""
        return [part.residual_weight(trajectory) for part, trajectory in self._pairs(iterate)]

    def initial_weights(self) -> list[Array]:
        """Return the weights that are assumed as long as continuity is a penalty."""
        return [part.initial_weight(self.settings.assumed_error) for part in self.parts]

    # --- linearization and steps

    def linearize(
        self, iterate: Iterate, weights: Sequence[Array], *, covariance_curvature: bool = False
    ) -> list[Any]:
        """Return the linearization of every part."""
        each = zip(self.parts, iterate.trajectories, weights, strict=True)
        return [
            part.linearize(t, w, covariance_curvature=covariance_curvature) for part, t, w in each
        ]

    def gap_variances(self, linearizations: Sequence[Any]) -> list[Array]:
        """Return the variances of gaps at the first stage, in which nodes may follow the data freely."""
        spread = self.settings.first_gap / self.settings.assumed_error
        each = zip(self.parts, linearizations, strict=True)
        return [part.continuity_variance(linearization, spread) for part, linearization in each]

    def moved(self, iterate: Iterate, step: Step, length: float) -> Iterate:
        """Return the iterate after a step, of which the share `length` is taken."""
        each = zip(step.condensed, iterate.trajectories, strict=True)
        nodes = [condensed.nodes_after(t.nodes, step.dz, length) for condensed, t in each]
        z = self.limits.after(iterate.z, length * step.dz) if step.dz.any() else iterate.z
        return self.at(z, nodes, iterate)

    def close_gaps(
        self, iterate: Iterate, step: Step, multipliers: Sequence[Array], length: float
    ) -> Iterate:
        """Return the iterate with the gaps closed that curvature has left, by the least changes of the outputs.

        They would cut every step short otherwise (Maratos effect; Nocedal and Wright, Numerical
        Optimization, 15.5).
        """
        enough = CLOSED * length * step.decrease
        cost = self.gap_cost(iterate, multipliers)
        for _ in range(self.settings.gap_closings):
            if not iterate.finite or cost <= enough:
                break
            each = zip(self.parts, step.linearizations, iterate.trajectories, strict=True)
            nodes = [part.close_gaps(linearization, t) for part, linearization, t in each]
            closer = self.at(iterate.z, nodes, iterate)
            now = self.gap_cost(closer, multipliers)
            if not closer.finite or now > 0.5 * cost:
                break
            iterate, cost = closer, now
        return iterate

    def _pairs(self, iterate: Iterate) -> Any:
        return zip(self.parts, iterate.trajectories, strict=True)
