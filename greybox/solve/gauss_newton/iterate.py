"""Where a Gauss-Newton iteration is, and the step that it takes from there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from greybox.compiled.part import Condensed, Trajectory
from greybox.files.arrays import Array

Nodes = Sequence[Array]
"""The nodes (s, n) of every part."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """The solver's variables z (p,), and the trajectory of every part."""

    z: Array
    trajectories: tuple[Trajectory, ...]

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return all(trajectory.finite for trajectory in self.trajectories)

    @property
    def nodes(self) -> list[Array]:
        """The nodes of every part. They and z determine everything else."""
        return [trajectory.nodes for trajectory in self.trajectories]


@dataclass(frozen=True, eq=False)
class Step:
    """A step from an iterate, with the quadratic model that it minimizes.

    Attributes
    ----------
    linearizations : sequence
        The linearization of every part.
    condensed : sequence of Condensed
        The same with the nodes eliminated.
    dz : (p,) array
        Change of the solver's variables.
    decrease : float
        Predicted decrease of the merit function.
    distance : float
        Half the squared length of the step: in standard errors, where the cost is a likelihood.
    hessian : (p, p) array
        Hessian of the cost by z, without damping.
    multipliers : sequence of (n,) arrays
        Penalty on the gaps of every state in the exact merit function; empty while continuity is
        relaxed.
    constraint_penalty : float
        Penalty on violated constraints.
    """

    linearizations: Sequence[Any]
    condensed: Sequence[Condensed]
    dz: Array
    decrease: float
    distance: float
    hessian: Array
    multipliers: Sequence[Array]
    constraint_penalty: float
