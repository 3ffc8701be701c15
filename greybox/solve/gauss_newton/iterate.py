"""Where a Gauss-Newton iteration stands, what step it takes, and what it hands to the next."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.record_part import Path, Place, Reduced
from greybox.compiled.sensitivities import Blocks

Array = NDArray[np.float64]
PATIENCE = 3  # iterations for the states alone, at parameters that may be far off
TIGHTEN = 0.1  # the standard deviation by which continuity may be missed, from one stage to the next
LAST = 2e-4  # scale of that deviation below which continuity is demanded
SHORT = 0.05  # steps of less than this length are no progress
SETTLED = 0.1  # relative: how well a step must keep its promise for the next stage to begin
POOR = 0.25  # share of a promised decrease below which full steps are too long
WELL = 0.01  # the same, for it to skip one
HELD = 1e-9  # slack of a limit that holds a step
PENALTY = 1e3  # on the amount by which constraints are missed, at least


Origin = tuple[Array, list[Array]]  # z and the nodes of every record


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

    @property
    def origin(self) -> Origin:
        """What all else follows from."""
        return self.z, [path.nodes for path in self.paths]


@dataclass(frozen=True, eq=False)
class Move:
    """One step: the systems it comes from, the change dz (p,) of the point, and the decrease of the merit it promises.

    `distance` is half its length squared, in standard errors where the cost is a likelihood; `hessian` (p, p) is that
    of the cost without damping.
    """

    blocks: Sequence[Blocks]
    reduced: Sequence[Reduced]
    dz: Array
    predicted: float
    distance: float
    hessian: Array


@dataclass(eq=False)
class Progress:
    """What an iteration hands to the next.

    Attributes
    ----------
    soft : list of (n,) arrays
        Variances by which continuity may be missed, at `scale` one.
    force : list of (n,) arrays
        Largest multipliers of the continuity so far.
    near : bool
        True where continuity is demanded from the first step of the parameters.
    patience : int
        Iterations left for the states alone.
    scale : float
        Of the standard deviation by which continuity may be missed; zero is exact.
    penalty : float
        On missed constraints, large enough for steps to decrease the merit.
    start, loose : z and nodes, or None
        Where all began, and where continuity began to be demanded, as long as Newton steps close its gaps.
    held : bool
        True where parameters at which the cost jumps keep their values: it is least at the jump.
    least : float
        Scale below which continuity is demanded.
    """

    soft: list[Array] = field(default_factory=list)
    force: list[Array] = field(default_factory=list)
    near: bool = False
    patience: int = PATIENCE
    scale: float = 1.0
    start: Origin | None = None
    loose: Origin | None = None
    held: bool = False
    least: float = LAST
    damping: float = 0.0
    penalty: float = PENALTY
    last: float = math.nan

    def begin(self, point: Point, soft: list[Array]) -> None:
        """Take the first point and its variances."""
        self.start, self.soft, self.force = point.origin, soft, [np.zeros_like(s) for s in soft]

    def aimed(self, move: "Move") -> "Move":
        """Take over the multipliers of a move, which gaps must cost at least."""
        if self.exact:
            largest = [largest_force(r, move.dz) for r in move.reduced]
            self.force = [np.maximum(f, 1.2 * now) for f, now in zip(self.force, largest, strict=True)]
        return move

    @property
    def exact(self) -> bool:
        """True when continuity is demanded."""
        return self.scale == 0

    def hold(self) -> bool:
        """Hold the parameters whose jumps block the steps of all; False where they are held already."""
        if self.held or not self.exact:
            return False
        self.held, self.damping, self.last = True, 0.0, math.nan
        return True

    @property
    def softness(self) -> list[Array]:
        """The variances by which continuity may be missed now."""
        return [s * self.scale**2 for s in self.soft]

    def stepped(self, point: Point, predicted: float, gained: float, length: float, done: bool) -> None:
        """Go on to `point` after a step; tighten continuity where it kept its promise or nothing is left to gain."""
        missed = abs(gained - predicted) / predicted if length == 1 and predicted > 0 else math.inf
        ready = done or missed <= SETTLED
        if self.patience:
            self.patience = 0 if ready else self.patience - 1
            self.scale = 0.0 if self.near and not self.patience else self.scale
        elif ready:
            scale = self.scale * (TIGHTEN**2 if missed <= WELL else TIGHTEN)
            self.scale = scale if scale > self.least else 0.0
        if self.exact:
            self.loose = point.origin


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
    eased = np.tensordot(blocks.mixed[:, :, len(reduced.slope) :], x, ((0, 1), (0, 1)))
    change = float((blocks.gradient * x).sum()) + 0.5 * (curved - float(eased @ eased))
    if np.all(soft > 0):
        missed = soft * reduced.force
        change += 0.5 * float(((missed**2 - gaps**2) / soft).sum())
    return max(-change, 0.0)


def held_back(reduced: Reduced, dz: Array) -> float:
    """Return what damping adds to the cost at a step dz (p,) over what it adds at no step."""
    x = reduced.step + reduced.follow @ (reduced.slope @ dz)
    return 0.5 * float((reduced.held * (x**2 - reduced.step**2)).sum())


def next_damping(damping: float, length: float, kept: float) -> float:
    """Return the damping after a step of which a share `length` was taken and a share `kept` of its promise held."""
    if length == 1.0 and kept < POOR:
        return max(10 * damping, 1e-2)
    if length == 1.0:
        return damping / 10 if damping > 1e-6 else 0.0
    return max(10 * damping, 1e-4) if length < 0.2 else damping
