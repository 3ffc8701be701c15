"""The Gauss-Newton iteration: linearize, condense, step, line search, until it has converged.

A run that fails begins once more, at its start, with nodes that are simulated. At the limit of
iterations, a run counts if it has arrived.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.solve.gauss_newton.all_parts import AllParts, with_rounding
from greybox.engine.solve.gauss_newton.iterate import (
    CONVERGED,
    EXACT,
    LARGEST_DAMPING,
    STALLED,
    Iterate,
    Progress,
    Step,
    after_failure,
)
from greybox.engine.solve.gauss_newton.kinks import status_at_kink
from greybox.engine.solve.gauss_newton.line_search import line_search, merit_function
from greybox.engine.solve.gauss_newton.normal_equations import exact_step, gauss_newton_step
from greybox.engine.solve.gauss_newton.stability import (
    are_stable,
    best_gains,
    predictors,
    simulate_stable,
)
from greybox.engine.solve.interruption import reason_to_end
from greybox.engine.solve.runs import NOT_FINITE, TOO_COARSE
from greybox.engine.solve.stationarity import ROUNDING

SINGULAR = "singular"  # the nodes of a record are not determined
EXCEEDED = "iterations exceeded"

# Iterations between two looks at what noise hides, and at the limit of stable steps. With 50, 20
# unknown initial states take a third more time; on 29 hard problems neither time nor success
# change.
LOOKS = 10


@frozen
class End:
    """Where an iteration ended.

    Attributes
    ----------
    iterate : Iterate
    status : str
    iterations : int
    hessian : (p, p) array or None
        Hessian of the last step; None unless it has converged.
    """

    iterate: Iterate
    status: str
    iterations: int
    hessian: Array | None = None


def descend(
    parts: AllParts,
    iterate: Iterate,
    progress: Progress,
    iterations: int,
    *,
    states_only: bool = False,
) -> End:
    """Iterate from a start; with `states_only` the parameters are fixed.

    A run that fails begins once more at its start, with simulated nodes.
    """
    # Nodes begin at the data. Where states die away or jump, the noise in them may lead a run
    # astray: without a second attempt, no run from the true parameters of five of 25 stiff or large
    # models converges (a flame, the Oregonator). Of 156 runs of 29 hard problems, 72 % reach the
    # best minimum, 71 % if they begin near the data. In segments, gains would follow the data
    # beyond the stability limit.
    end = _attempted(parts, iterate, progress, iterations, states_only=states_only)
    if end.status in (STALLED, EXCEEDED) and parts.is_delay.any() and not states_only:
        end = _at_whole_samples(parts, end, iterations)
    if end.status not in (NOT_FINITE, SINGULAR, STALLED) or parts.is_gain.any():
        return end
    begin = parts.simulated(iterate.z)
    later = _attempted(parts, begin, EXACT, iterations - end.iterations, states_only=states_only)
    better = later if later.status.startswith(CONVERGED) else end
    return replace(better, iterations=end.iterations + later.iterations)


def _at_whole_samples(parts: AllParts, end: End, iterations: int) -> End:
    """Return the minimum where delays are whole samples, or else the end of a run that stalled.

    The cost may have a kink at whole samples of a delay. Steps that cross the kink are refused
    before the other unknowns are at their minimum: 5 of 30 fits of a lag with direct feedthrough,
    whose delay was one sample, ended at a false minimum from all starts. Therefore the other
    unknowns converge first, at fixed delays.
    """
    progress = replace(EXACT, held=parts.is_delay)
    converged = _attempted(parts, end.iterate, progress, iterations, states_only=False)
    # An iterate that is singular has no steps to either side.
    if converged.status != CONVERGED:
        return end
    status = status_at_kink(parts, converged.iterate, states_only=False)
    if not status.startswith(CONVERGED):
        return end
    return replace(converged, status=status, iterations=end.iterations + converged.iterations)


def _attempted(
    parts: AllParts, iterate: Iterate, progress: Progress, iterations: int, *, states_only: bool
) -> End:
    if not iterate.finite:
        return End(iterate, NOT_FINITE, 0)
    try:
        return _Attempt(parts, iterate, progress, states_only).end_after(iterations)
    except np.linalg.LinAlgError:
        return End(iterate, SINGULAR, 0)


@dataclass
class _Attempt:
    """A run that replaces its iterate by better ones.

    Attributes
    ----------
    parts : AllParts
    iterate : Iterate
    progress : Progress
    states_only : bool
        Whether the parameters are fixed.
    weights : list of array
        Weight of the residuals of every part.
    linearizations : list
        Linearization of every part at the iterate; empty after a step.
    last_look : float
        Merit at the last check whether the run still makes progress.
    """

    parts: AllParts
    iterate: Iterate
    progress: Progress
    states_only: bool
    weights: list[Array] = field(default_factory=list)
    linearizations: list[Any] = field(default_factory=list)
    last_look: float = np.inf

    def end_after(self, iterations: int) -> End:
        """Make at most this number of iterations, and return the end of the run."""
        for count in range(iterations):
            if end := self._advance(count):
                return end
        end = End(self.iterate, EXCEEDED, iterations)
        if self.progress.is_exact:
            return _arrived(self.parts, end, states_only=self.states_only)
        return end

    @property
    def nodes_alone(self) -> bool:
        """Whether the parameters are fixed in this iteration."""
        return self.states_only or self.progress.state_iterations > 0

    def _advance(self, count: int) -> End | None:
        """Make one iteration; return the end of the run if this is the last one."""
        if reason := self._reason_to_end(count):
            return End(self.iterate, reason, count)
        # As long as continuity is a penalty, nodes keep an unstable predictor near the data.
        if self.progress.is_exact:
            self.iterate = simulate_stable(self.parts, self.iterate)
        # After a step that failed, only the damping changes: the linearizations are still valid.
        if not self.linearizations:
            self._linearize()

        step = gauss_newton_step(
            self.parts,
            self.iterate,
            self.linearizations,
            self.progress,
            states_only=self.nodes_alone,
        )
        self.progress = self.progress.with_penalties(step)
        merit = merit_function(self.parts, self.weights, self.progress)
        start = merit(self.iterate)
        is_settled = self._is_settled(step, start)
        looks = self.progress.is_exact and not self.nodes_alone and (count + 1) % LOOKS == 0
        if end := self._minimum(step, is_settled=is_settled, looks=looks):
            return End(end, CONVERGED, count, step.hessian)
        rests = looks and self._rests(start)

        trial, length = line_search(self.parts, self.iterate, step, merit, start)
        # The remaining changes of the merit function are rounding.
        is_rounding = is_settled and step.distance <= 1e3 * self.parts.settings.tol
        if self._is_at_limit() or (trial is None and is_rounding):
            return End(self.iterate, CONVERGED, count, step.hessian)
        if self._tries_again(trial):
            return None
        if end := self._standstill(step, trial, count, rests=rests):
            return end
        self._accept(step, trial, start, 0.0 if trial is None else start - merit(trial), length)
        return None

    def _reason_to_end(self, count: int) -> str:
        """Return why the run has to end before it makes a step; empty if it need not."""
        # Runs would make tiny steps along the limit of stable integration, beyond which the minimum
        # may lie.
        looks = not (self.states_only or count % LOOKS)
        if looks and not self.parts.has_stable_steps(self.iterate):
            return TOO_COARSE
        return reason_to_end() or ""

    def _linearize(self) -> None:
        parts = self.parts
        if self.progress.is_exact:
            self.weights = parts.residual_weights(self.iterate)
        else:
            # As long as continuity is a penalty, errors have an assumed size.
            self.weights = [part.initial_weight() for part in parts.parts]
        self.linearizations = parts.linearize(self.iterate, self.weights)

        # The first linearization gives the variances of the gaps.
        if not self.progress.gap_variance:
            pairs = zip(parts.parts, self.linearizations, strict=True)
            variances = [part.continuity_variance(b) for part, b in pairs]
            self.progress = replace(self.progress, gap_variance=variances)

    def _is_settled(self, step: Step, merit: float) -> bool:
        """Return whether a step, also an undamped one, can gain only little."""
        progress = self.progress
        negligible = max(self.parts.settings.tol, ROUNDING * abs(merit))
        little = (1 + progress.damping) * step.decrease <= negligible
        if not (progress.is_exact and little and self.parts.is_continuous(self.iterate)):
            return False
        if not progress.damping:
            return True
        undamped = gauss_newton_step(
            self.parts,
            self.iterate,
            step.linearizations,
            replace(progress, damping=0.0),
            states_only=self.nodes_alone,
        )
        return undamped.decrease <= progress.undamped_decrease

    def _minimum(self, step: Step, *, is_settled: bool, looks: bool) -> Iterate | None:
        """Return the minimum if the run has arrived there."""
        if is_settled and step.distance <= self.parts.settings.tol:
            # The step is computed already: applying it saves polishing one step.
            return followed(self.parts, self.iterate, step) or self.iterate
        return _end_within_noise(self.parts, self.iterate, step, self.progress) if looks else None

    def _rests(self, merit: float) -> bool:
        """Return whether the merit has hardly fallen since the last check.

        Near a kink, as at a whole sample of a delay, alternating steps gain as little as rounding,
        and no step fails: 9 of 80 fits of a held input ended after 2100 iterations.
        """
        rests = self.last_look - merit <= 10 * ROUNDING * abs(merit)
        self.last_look = merit
        return rests

    def _is_at_limit(self) -> bool:
        """Return whether a damped run has arrived at the limit of stable predictors.

        Where poles meet, the limit has no tangent: runs would make thousands of tiny steps, for
        hundredths of the cost.
        """
        is_damped = self.progress.is_exact and self.progress.damping >= 1e3
        return is_damped and any(
            gain.is_at_limit(trajectory)
            for gain, trajectory in predictors(self.parts, self.iterate)
        )

    def _tries_again(self, trial: Iterate | None) -> bool:
        """Return whether the next iteration tries another step from here, and prepare it."""
        progress = self.progress
        if trial is None and progress.damping <= LARGEST_DAMPING:
            self.progress = replace(progress, damping=after_failure(progress.damping))
            return True
        # If heavy damping has not helped, delays at which the cost jumps block the steps. Holding
        # these delays halves the time where a held input reaches an output directly. Otherwise a
        # run whose minimum lies at a jump may take 2000 iterations, and the fit may choose another
        # minimum.
        is_blocked = self.parts.is_discontinuous.any() and not np.any(progress.held)
        if is_blocked and progress.is_exact and progress.damping >= 1e2:
            self.progress = replace(progress, held=self.parts.is_discontinuous, damping=0.0)
            return True
        return False

    def _standstill(
        self, step: Step, trial: Iterate | None, count: int, *, rests: bool
    ) -> End | None:
        """Return the end of a run that makes no progress, perhaps at a kink; None to continue."""
        progress = self.progress
        fails = progress.is_exact and (trial is None or progress.damping > LARGEST_DAMPING)
        if not (fails or rests):
            return None
        closed = self.parts.made_continuous(self.iterate, step)
        status = status_at_kink(self.parts, closed, states_only=self.nodes_alone)
        # A run that rests elsewhere continues.
        return End(closed, status, count) if fails or status != STALLED else None

    def _accept(
        self, step: Step, trial: Iterate | None, merit: float, gained: float, length: float
    ) -> None:
        """Continue from the trial; without a trial, continue in the next stage."""
        following = self.progress.after(step, merit, gained, length)
        becomes_exact = following.is_exact and not (self.progress.is_exact or self.states_only)
        self.progress = following
        self.iterate = trial or self.iterate
        # The linearizations of a long record take an eighth of the memory.
        self.linearizations = []
        if not becomes_exact:
            return

        # The exact stage begins with good gains and simulated stable predictors. Otherwise at most
        # one of 7 runs finds the predictors of the tilt plant.
        z = best_gains(self.parts, self.iterate, following.gap_variance)
        if z is not self.iterate.z:
            self.iterate = self.parts.at(z, self.iterate.nodes)


def _arrived(parts: AllParts, end: End, *, states_only: bool) -> End:
    """Return a continuous end of a run at the limit of iterations; it may have converged."""

    def step_from(iterate: Iterate) -> Step:
        weights = parts.residual_weights(iterate)
        linearizations = parts.linearize(iterate, weights)
        return gauss_newton_step(parts, iterate, linearizations, EXACT, states_only=states_only)

    closed = parts.made_continuous(end.iterate, step_from(end.iterate))
    if not (closed.finite and parts.is_continuous(closed)):
        return end
    step = step_from(closed)
    has_arrived = step.decrease <= EXACT.undamped_decrease
    status = CONVERGED if has_arrived else EXCEEDED
    return replace(end, iterate=closed, status=status, hessian=step.hessian)


def followed(parts: AllParts, iterate: Iterate, step: Step) -> Iterate | None:
    """Return the continuous, stable iterate after a whole step; None if it costs more."""
    end = parts.made_continuous(parts.moved(iterate, step, 1.0), step)
    costs_more = parts.cost(end) > with_rounding(parts.cost(iterate))
    if costs_more or not (parts.is_continuous(end) and are_stable(parts, end)):
        return None
    return end


def _end_within_noise(
    parts: AllParts, iterate: Iterate, step: Step, progress: Progress
) -> Iterate | None:
    """Return the iterate, made continuous, if further steps gain less than noise; else None.

    Where the data hardly determine some directions, short steps continue along them for thousands
    of iterations, for a hundredth of a unit of log-likelihood (the tanh chain is lost without
    this). On a plateau far from the data the steps are as short, but there the residuals are not
    noise. A decrease beyond a bound does not count.
    """
    # Steps along unobservable states leave gaps beyond rounding.
    closed = parts.made_continuous(iterate, step)
    explained = (part.explains_data(trajectory) for part, trajectory in parts.along(closed))
    if not (parts.is_continuous(closed) and all(explained)):
        return None
    # The gaps of the last linearization are closed, which changes its residuals.
    undamped = exact_step(parts, closed, replace(progress, damping=0.0))
    # A step that no bound stops decreases the cost by its `distance`, and continues to converge.
    stopped = undamped.decrease > 2 * undamped.distance
    # Noise moves the minimum by half a unit of log-likelihood per unknown on average. At a tenth of
    # a standard error from the minimum, a hundredth of this remains. The limit on `distance` is
    # half the square of a tenth.
    unknowns = len(closed.z) + sum(part.unknown_initial_states for part in parts.parts)
    is_noise = undamped.distance <= 5e-3 and undamped.decrease <= 0.01 * unknowns / 2
    return closed if stopped and is_noise else None
