"""What parts have in common whose cost is a function of the solver's variables alone."""

from abc import abstractmethod
from typing import Any

import numpy as np

from greybox.compiled.part import Condensed, Part, Trajectory
from greybox.files.arrays import Array

NO_NODES = np.zeros((0, 0))


class PartWithoutNodes(Part):
    """A part without states at nodes: nothing is condensed, no gap is closed, and its residuals need no weights."""

    def initial_trajectory(self, z: Array) -> Trajectory:
        """Return the point z, without nodes."""
        return self.trajectory(z, NO_NODES)

    def squared_cost(self, trajectory: Trajectory, weight: Array, smoothing: float) -> float:
        """Return the cost: no residual covariance is held."""
        return self.cost(trajectory, smoothing)

    def residual_weight(self, trajectory: Trajectory) -> Array:
        """Return nothing: the cost weighs the residuals."""
        return NO_NODES

    def initial_weight(self, share: float) -> Array:
        """Return nothing: the cost weighs the residuals."""
        return NO_NODES

    @abstractmethod
    def linearize(self, trajectory: Trajectory, weight: Array) -> tuple[Array, Array]:
        """Return gradient (p,) and a Hessian (p, p) without negative eigenvalues."""

    def continuity_variance(self, linearization: Any, spread: float) -> Array:
        """Return nothing: there are no states."""
        return np.zeros(0)

    def condense(
        self,
        linearization: Any,
        trajectory: Trajectory,
        continuity_variance: Array,
        damping: float = 0.0,
    ) -> Condensed:
        """Return the quadratic model: there is nothing to eliminate."""
        gradient, hessian = linearization
        nothing = np.zeros((0, 0, len(gradient)))
        return Condensed(hessian, gradient, NO_NODES, nothing, NO_NODES, nothing, NO_NODES, 0.0)

    def close_gaps(self, linearization: Any, trajectory: Trajectory) -> Array:
        """Return no nodes."""
        return NO_NODES

    def is_near_data(self, trajectory: Trajectory, factor: float) -> bool:
        """Return True: what is not simulated cannot diverge along the way."""
        return True
