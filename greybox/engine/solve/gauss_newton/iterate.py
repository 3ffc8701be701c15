"""Where a Gauss-Newton iteration is, its step, and what one iteration hands to the next.

Gaps between segments are first a quadratic penalty gap²/2σ². The standard deviations σ let the
nodes follow the data, whatever the parameters. σ shrinks in stages, each begun when the quadratic
model predicts well or promises little, until continuity is an exact constraint. In the very first
stage the parameters are held, and the nodes move alone.

Levenberg-Marquardt damping follows the ratio of actual and predicted decrease. Sources: Marquardt
(1963), SIAM Journal on Applied Mathematics 11; Nocedal and Wright, Numerical Optimization, 2nd ed.,
section 10.3. Success does not depend on its numbers: `benchmarks/ablation.py` tried a tenth and ten
times each.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.part import Condensed, Trajectory

CONVERGED, STALLED = "converged", "stalled"

Nodes = Sequence[Array]
"""The nodes (s, n) of every part."""


@frozen
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


@frozen
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
    gradient, hessian : (p,) and (p, p) arrays
        Derivatives of the cost with respect to z, without damping.
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
    gradient: Array
    hessian: Array
    multipliers: Sequence[Array]
    constraint_penalty: float


FACTOR = 10.0  # by which the damping grows and falls
FIRST_DAMPING = (
    1e-2  # after a poor step or a failed line search, relative to the Hessian's diagonal
)
LARGEST_DAMPING = 1e6  # beyond which a run has stalled


def next_damping(damping: float, length: float, ratio: float, last_full: float) -> float:
    """Return the damping after a step that was shortened to a share `length`.

    `ratio` is the actual decrease of the merit function over the predicted one. `last_full` is the
    damping of the last full step: a step that was cut short is damped at least as much. With a
    fixed number in its place, one of two fits of Bennett5 is lost.
    """
    if length < 1.0:
        return max(FACTOR * damping, last_full) if length < 0.2 else damping
    if ratio < 0.25:
        return max(FACTOR * damping, FIRST_DAMPING)
    # With less damping, the step after one that overshoots would undo it.
    if ratio < 0.75:
        return damping
    # Damping below 1e-12 of the diagonal could hold back nothing but rounding.
    return damping / FACTOR if damping > 1e-12 else 0.0


def after_failure(damping: float) -> float:
    """Return the damping after a line search without any decrease: grown by two factors at once."""
    return max(FACTOR**2 * damping, FIRST_DAMPING)


# A stage ends when a decrease was predicted to within a tenth, or when a tenth of the merit
# function is all that a step still promises. Success hardly depends on it, time does: with a
# hundredth it is 1.5 times as long (`benchmarks/ablation.py`).
KEPT_PROMISE = 0.1


@frozen
class Progress:
    """What one iteration hands to the next.

    Attributes
    ----------
    stages : tuple of float
        Factors on the standard deviation of the gaps, in this stage and in those that remain. Zero
        is exact continuity.
    state_iterations : int
        Remaining iterations of the first stage, which moves the nodes alone.
    gap_variance : sequence of (n,) arrays
        Variances of the gaps at scale one; empty before the first linearization.
    multipliers : sequence of (n,) arrays
        Penalty on the gaps in the exact merit function; empty before the first exact step.
    constraint_penalty : float
        Penalty on violated constraints. It begins large: it only grows.
    damping : float
        Levenberg-Marquardt damping, relative to the diagonal of the Hessian.
    full_damping : float
        Damping of the last full step.
    undamped_decrease : float
        Predicted decrease of an undamped step below which a run counts as converged once damped
        steps have come to rest. The default is half the square of a thirtieth of a standard error.
    held : (p,) array, or False
        Delays that keep their values: the cost is least where it jumps, or has a kink.
    """

    stages: tuple[float, ...] = (0.0,)
    state_iterations: int = 0
    gap_variance: Sequence[Array] = ()
    multipliers: Sequence[Array] = ()
    constraint_penalty: float = 1e3
    damping: float = 0.0
    # The line search has already damped a shortened step: a hundredth of the first damping is
    # enough.
    full_damping: float = 1e-2 * FIRST_DAMPING
    undamped_decrease: float = 5e-4
    held: BoolArray | bool = False

    @property
    def is_exact(self) -> bool:
        """True when continuity is a constraint."""
        return self.stages[0] == 0

    @property
    def continuity_variance(self) -> list[Array]:
        """The variances of the gaps in this stage."""
        return [variance * self.stages[0] ** 2 for variance in self.gap_variance]

    def with_penalties(self, step: Step) -> "Progress":
        """Return the progress with the penalties that make the merit function exact for a step."""
        return replace(
            self, multipliers=step.multipliers, constraint_penalty=step.constraint_penalty
        )

    def after(self, step: Step, merit: float, gained: float, length: float) -> "Progress":
        """Return the progress after a share `length` of a step, which `gained` so much merit."""
        ratio = gained / step.decrease if step.decrease > 0 else 1.0
        is_full = length == 1
        full_damping = self.damping if is_full and self.damping else self.full_damping
        damping = next_damping(self.damping, length, ratio, full_damping)

        if self.is_exact:
            return replace(self, damping=damping, full_damping=full_damping)

        # A stage also ends without a step, or it would repeat the same failure.
        is_predicted = is_full and step.decrease > 0 and abs(ratio - 1) <= KEPT_PROMISE
        promises_little = step.decrease <= KEPT_PROMISE * abs(merit)
        # A stage that makes no step has nothing left to do.
        is_over = is_predicted or promises_little or not length or self.state_iterations == 1
        return replace(
            self,
            damping=damping if length else 0.0,
            full_damping=full_damping,
            stages=self.stages[1:] if is_over else self.stages,
            state_iterations=0 if is_over else max(self.state_iterations - 1, 0),
        )


EXACT = Progress()


def relaxed(*, predicts: bool = False) -> Progress:
    """Return the progress of an iteration that begins with nodes from the data.

    Predictors need only the first stage: innovations correct their states.
    """
    # Continuity is a penalty, whose weight grows until it is an exact constraint: 70 % of runs end
    # at the best minimum with it, 62 % without; Lorenz 6 of 6 instead of none.
    stages = (1.0, 0.0) if predicts else (1.0, 0.1, 0.01, 0.001, 0.0)
    # The nodes move alone first, at held parameters. Only with this stage is the minimum of the
    # overflow problem reached; elsewhere it wins as many runs as it loses.
    return Progress((1.0, *stages), 3)
