"""The homotopy in the continuity constraint, and what else an iteration hands to the next.

Gaps between segments are first a quadratic penalty gap²/2σ², with standard deviations σ that let
the nodes follow the data whatever the parameters; σ shrinks in stages, each begun when the
quadratic model predicts well or has nothing left to gain, until continuity is an exact constraint.
For the first iterations the parameters are held and the nodes move alone.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from greybox.compiled.strategies import Strategies
from greybox.files.arrays import Array
from greybox.solve.gauss_newton.iterate import Iterate, Nodes, Step

# Multipliers and penalties exceed the largest multiplier so far by this factor: an l1 merit is
# exact when they are larger, and 1 would leave the sign of the directional derivative to rounding
# (Nocedal and Wright, section 18.3).
EXACTNESS = 1.2


# Half the square of a thirtieth of a standard error.
UNDAMPED_DECREASE = 5e-4


@dataclass(eq=False)
class Progress:
    """What an iteration hands to the next.

    Attributes
    ----------
    settings : Strategies
    near_solution : bool
        True where continuity is demanded from the first step of the parameters.
    gap_scale : float
        Of the standard deviation of gaps; zero where continuity is exact.
    last_scale : float
        Scale below which continuity becomes exact.
    state_iterations : int
        Iterations left that move the nodes alone.
    gap_variance : list of (n,) arrays
        Variances of gaps at scale one.
    multipliers : list of (n,) arrays
        Largest multipliers of continuity so far: the penalty on gaps in the exact merit.
    constraint_penalty : float
        On violated constraints.
    damping : float
        Levenberg-Marquardt damping, relative to the diagonal of the Hessian.
    full_damping : float
        That of the last step that was taken in full.
    undamped_decrease : float
        Decrease that an undamped step may still promise where damped steps have come to rest.
    last_decrease : float
        Predicted by the last full undamped step, or half its squared length where that is more; NaN
        without.
    delays_held : bool
        True where delays at which the cost jumps keep their values: the cost is least at the jump.
    hessian : (p, p) array or None
        Of the last step of the parameters, undamped.
    start, homotopy_end : z and nodes, or None
        Where the iteration began, and where continuity became exact, as long as Newton steps close
        the gaps.
    """

    settings: Strategies
    near_solution: bool = False
    gap_scale: float = 1.0
    last_scale: float = math.nan
    state_iterations: int = -1
    gap_variance: list[Array] = field(default_factory=list)
    multipliers: list[Array] = field(default_factory=list)
    constraint_penalty: float = math.nan
    damping: float = 0.0
    full_damping: float = math.nan
    undamped_decrease: float = UNDAMPED_DECREASE
    last_decrease: float = math.nan
    delays_held: bool = False
    hessian: Array | None = None
    start: tuple[Array, Nodes] | None = None
    homotopy_end: tuple[Array, Nodes] | None = None

    def __post_init__(self) -> None:
        """Take the settings."""
        settings = self.settings
        self.near_solution = self.near_solution or not settings.continuity_homotopy
        self.last_scale = settings.last_gap
        self.constraint_penalty = settings.constraint_penalty
        # A shortened step was damped by the line search already: a hundredth of the damping of a
        # poor one is enough.
        self.full_damping = 1e-2 * settings.first_damping
        if self.state_iterations < 0:
            self.state_iterations = settings.state_iterations
        if not settings.states_first:
            self.state_iterations = 0
        if not self.state_iterations and self.near_solution:
            self.gap_scale = 0.0

    @classmethod
    def exact(cls, settings: Strategies) -> "Progress":
        """Return the progress of an iteration that begins with a continuous trajectory."""
        return cls(settings, gap_scale=0.0, state_iterations=0)

    @property
    def is_exact(self) -> bool:
        """True when continuity is a constraint."""
        return self.gap_scale == 0

    @property
    def continuity_variance(self) -> list[Array]:
        """The variances of gaps now."""
        return [variance * self.gap_scale**2 for variance in self.gap_variance]

    def begin(self, iterate: Iterate, gap_variance: list[Array]) -> None:
        """Take the first iterate and its variances of gaps."""
        self.start = (iterate.z, iterate.nodes)
        self.gap_variance = gap_variance
        self.multipliers = [np.zeros_like(variance) for variance in gap_variance]

    def update_multipliers(self, step: Step) -> Step:
        """Raise the penalties on gaps above the multipliers of a step; returns the step."""
        if self.is_exact:
            now = [condensed.largest_multiplier(step.dz) for condensed in step.condensed]
            self.multipliers = [
                np.maximum(m, EXACTNESS * n) for m, n in zip(self.multipliers, now, strict=True)
            ]
        return step

    def hold_delays(self) -> bool:
        """Hold the discontinuous delays, whose jumps block all steps; False where they are held already."""
        if self.delays_held or not self.is_exact:
            return False
        self.delays_held = True
        self.damping = 0.0
        self.last_decrease = math.nan
        return True

    def advance(
        self, iterate: Iterate, step: Step, gained: float, length: float, *, done: bool
    ) -> None:
        """Go on to `iterate` after a share `length` of a step that `gained` so much of the merit.

        The next stage begins where the step decreased the merit as predicted, or where there is
        nothing left to gain.
        """
        settings = self.settings
        full = length == 1 and step.decrease > 0
        error = abs(gained - step.decrease) / step.decrease if full else math.inf
        ready = done or error <= settings.kept_promise
        if self.state_iterations:
            self.state_iterations = 0 if ready else self.state_iterations - 1
            if self.near_solution and not self.state_iterations:
                self.gap_scale = 0.0
        elif ready:
            skips = error <= settings.well_kept_promise and settings.skipped_stages
            scale = self.gap_scale * settings.gap_reduction ** (2 if skips else 1)
            self.gap_scale = scale if scale > self.last_scale else 0.0
        if self.is_exact:
            self.homotopy_end = (iterate.z, iterate.nodes)
