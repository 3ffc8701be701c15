"""Where a Gauss-Newton iteration stands, what step it takes, and what it hands to the next."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.record_part import Path, Place, Reduced
from greybox.shooting import Blocks

Array = NDArray[np.float64]
TIGHTEN = 0.1  # the standard deviation by which continuity may be missed, from one stage to the next
SETTLED = 0.1  # relative: how well a step must keep its promise for the next stage to begin
POOR = 0.25  # share of a promised decrease below which full steps are too long
WELL = 0.01  # the same, for it to skip one
HELD = 1e-9  # slack of a limit that holds a step
PENALTY = 1e3  # on the amount by which constraints are missed, at least


@dataclass(frozen=True, eq=False)
class Point:
    """Where an iteration stands: point z, and place and path of every record."""

    z: Array
    places: tuple[Place, ...]
    paths: tuple[Path, ...]

    @property
    def finite(self) -> bool:
        """True when nothing diverged."""
        return all(path.finite for path in self.paths)


@dataclass(frozen=True, eq=False)
class Move:
    """One step: the systems it comes from, the change dz (p,) of the point, and the decrease of the merit it promises.

    `distance` is half its length squared, in standard errors where the cost is a likelihood; `penalty` is large enough
    on missed constraints for the step to decrease the merit.
    """

    blocks: Sequence[Blocks]
    reduced: Sequence[Reduced]
    dz: Array
    predicted: float
    distance: float
    penalty: float


@dataclass(eq=False)
class Progress:
    """What an iteration hands to the next: stage (-1: states alone), damping, multipliers, the last promise."""

    soft: list[Array]
    force: list[Array]
    stages: int
    stage: int = -1
    damping: float = 0.0
    penalty: float = PENALTY
    last: float = math.nan

    @property
    def exact(self) -> bool:
        """True when continuity is demanded."""
        return self.stage >= self.stages

    def advance(self, predicted: float, gained: float, length: float, done: bool) -> None:
        """Go to the next stage when a full step kept its promise, no step was found, or nothing is left to gain."""
        missed = abs(gained - predicted) / predicted if length == 1 and predicted > 0 else math.inf
        if done or length == 0 or missed <= SETTLED:
            self.stage += 2 if missed <= WELL and self.stage >= 0 else 1

    @property
    def softness(self) -> list[Array]:
        """The variances by which continuity may be missed now."""
        return [np.zeros_like(s) if self.exact else s * TIGHTEN ** (2 * max(self.stage, 0)) for s in self.soft]


def largest_force(reduced: Reduced, dz: Array) -> Array:
    """Return the largest multiplier of the continuity of every state, (n,), after a step dz (p,)."""
    return np.abs(reduced.force + reduced.force_follow @ (reduced.slope @ dz)).max(axis=0, initial=0.0)


def largest_multiplier(force: Array, normals: Array, slack: Array) -> float:
    """Return the largest multiplier of the limits that hold a step, whose sum times `normals` is `force` (p,)."""
    held = slack <= HELD
    if not held.any():
        return 0.0
    return float(np.abs(np.linalg.lstsq(normals[held].T, force)[0]).max())


def promised(blocks: Blocks, reduced: Reduced, gaps: Array, soft: Array) -> float:
    """Return the decrease that the move of the nodes alone promises."""
    x = reduced.step
    curved = float((x * (blocks.corner @ x[:, :, None])[:, :, 0]).sum())
    change = float((blocks.gradient * x).sum()) + 0.5 * curved
    if np.all(soft > 0):
        missed = soft * reduced.force
        change += 0.5 * float(((missed**2 - gaps**2) / soft).sum())
    return max(-change, 0.0)


def next_damping(damping: float, length: float, kept: float) -> float:
    """Return the damping after a step of which a share `length` was taken and a share `kept` of its promise held."""
    if length == 1.0 and kept < POOR:
        return max(10 * damping, 1e-2)
    if length == 1.0:
        return damping / 10 if damping > 1e-6 else 0.0
    return max(10 * damping, 1e-4) if length < 0.2 else damping
