"""Where a Gauss-Newton iteration stands, and the step that it takes from there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from greybox.compiled.part import Condensed, Trajectory
from greybox.files.arrays import Array

Nodes = Sequence[Array]
"""The nodes (s, n) of every part."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """Where an iteration stands: the solver's variables z (p,), and the trajectory of every part."""

    z: Array
    trajectories: tuple[Trajectory, ...]

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return all(trajectory.finite for trajectory in self.trajectories)

    @property
    def nodes(self) -> list[Array]:
        """The nodes of every part: with z, all else follows from them."""
        return [trajectory.nodes for trajectory in self.trajectories]


@dataclass(frozen=True, eq=False)
class Step:
    """A step from an iterate, with the quadratic model that it comes from.

    Attributes
    ----------
    linearizations : sequence
        Of every part.
    condensed : sequence of Condensed
        The same with the nodes eliminated.
    dz : (p,) array
        The change of the solver's variables.
    decrease : float
        Of the merit, as predicted.
    distance : float
        Half the squared length of the step: in standard errors, where the cost is a likelihood.
    """

    linearizations: Sequence[Any]
    condensed: Sequence[Condensed]
    dz: Array
    decrease: float
    distance: float
