"""The Gauss-Newton iteration: linearize, condense, step, line search, until it has converged.

A run that fails begins once more, at its start, with nodes that are simulated. At the limit of
iterations, a run counts if it has arrived.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from greybox.files.arrays import Array
from greybox.files.frozen_values import frozen
from greybox.solve.gauss_newton.all_parts import AllParts, with_rounding
from greybox.solve.gauss_newton.iterate import (
    CONVERGED,
    EXACT,
    LARGEST_DAMPING,
    STALLED,
    Iterate,
    Progress,
    Step,
    after_failure,
)
from greybox.solve.gauss_newton.kinks import status_at_kink
from greybox.solve.gauss_newton.line_search import line_search, merit_function
from greybox.solve.gauss_newton.normal_equations import exact_step, gauss_newton_step
from greybox.solve.gauss_newton.stability import are_stable, best_gains, predictors, simulate_stable
from greybox.solve.interruption import reason_to_end
from greybox.solve.runs import NOT_FINITE, TOO_COARSE
from greybox.solve.stationarity import ROUNDING

SINGULAR = "singular"  # the nodes of a record are not determined
EXCEEDED = "iterations exceeded"


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
    """Iterate from a start; with `states_only` the parameters are held.

    A run that fails begins there once more, with nodes that are simulated.
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
    """Return the end of a run that creeps or stalls, or the minimum at whole samples of delays.

    There the cost may have a kink. Steps that cross it are refused before the other unknowns are at
    their minimum: 5 of 30 fits of a lag with direct feedthrough, whose delay was one sample, ended
    at a false minimum from all starts. Therefore all but the delays settle first.
    """
    progress = replace(EXACT, held=parts.is_delay)
    rest = _attempted(parts, end.iterate, progress, iterations, states_only=False)
    # An iterate that is singular has no steps to either side.
    if rest.status != CONVERGED:
        return end
    status = status_at_kink(parts, rest.iterate, states_only=False)
    if not status.startswith(CONVERGED):
        return end
    return replace(rest, status=status, iterations=end.iterations + rest.iterations)


def _attempted(parts: AllParts, iterate: Iterate, *options: Any, states_only: bool) -> End:
    if not iterate.finite:
        return End(iterate, NOT_FINITE, 0)
    try:
        return _iterated(parts, iterate, *options, states_only=states_only)
    except np.linalg.LinAlgError:
        return End(iterate, SINGULAR, 0)


def _iterated(
    parts: AllParts, iterate: Iterate, progress: Progress, iterations: int, *, states_only: bool
) -> End:
    weights = list[Array]()
    linearizations = list[Any]()
    last_look = np.inf
    for count in range(iterations):
        # Runs would creep along the limit of stable steps, beyond which the minimum may lie.
        is_stable = states_only or count % 10 or parts.has_stable_steps(iterate)
        if reason := reason_to_end() if is_stable else TOO_COARSE:
            return End(iterate, reason, count)

        # As long as continuity is a penalty, nodes keep an unstable predictor near the data.
        iterate = simulate_stable(parts, iterate) if progress.is_exact else iterate
        # Linearize, unless the last step failed, and step.
        if not linearizations:
            weights = (
                parts.residual_weights(iterate)
                if progress.is_exact
                # As long as continuity is a penalty, errors have an assumed size.
                else [part.initial_weight() for part in parts.parts]
            )
            linearizations = parts.linearize(iterate, weights)
            # The first linearization gives the variances of the gaps.
            pairs = zip(parts.parts, linearizations, strict=True)
            variances = progress.gap_variance or [part.continuity_variance(b) for part, b in pairs]
            progress = replace(progress, gap_variance=variances)
        nodes_alone = states_only or progress.state_iterations > 0
        step = gauss_newton_step(parts, iterate, linearizations, progress, states_only=nodes_alone)
        progress = progress.with_penalties(step)
        merit = merit_function(parts, weights, progress)
        start = merit(iterate)

        # Converged?
        settled = _is_settled(parts, iterate, step, start, progress, states_only=nodes_alone)
        if settled and step.distance <= parts.settings.tol:
            # The step is known already: polishing then has one less to compute.
            end = followed(parts, iterate, step)
            return End(end or iterate, CONVERGED, count, step.hessian)
        # With 50 iterations between two of these looks, 20 unknown initial states take a third more
        # time; on 29 hard problems neither time nor success change.
        looks = progress.is_exact and not nodes_alone and (count + 1) % 10 == 0
        if looks and (end := _end_within_noise(parts, iterate, step, progress)):
            return End(end, CONVERGED, count, step.hessian)
        # Beside a kink, as at a whole sample of a delay, steps to and fro gain as little as
        # rounding, and none fails: 9 of 80 fits of a held input ended after 2100 iterations.
        rests = looks and last_look - start <= 10 * ROUNDING * abs(start)
        last_look = start if looks else last_look

        # Line search.
        trial, length = line_search(parts, iterate, step, merit, start)
        # Where poles meet at the stability limit, it has no tangent: runs would creep for thousands
        # of steps, for hundredths of the cost.
        at_limit = (
            progress.is_exact
            and progress.damping >= 1e3
            and any(gain.is_at_limit(t) for gain, t in predictors(parts, iterate))
        )
        if at_limit or (trial is None and settled and step.distance <= 1e3 * parts.settings.tol):
            # The merit function shows only rounding.
            return End(iterate, CONVERGED, count, step.hessian)
        if trial is None and progress.damping <= LARGEST_DAMPING:
            progress = replace(progress, damping=after_failure(progress.damping))
            continue
        # If heavy damping has not helped, delays at which the cost jumps block the steps. Holding
        # these delays halves the time where a held input reaches an output directly. Otherwise a
        # run whose minimum lies at a jump may take 2000 iterations, and the fit may choose another
        # minimum.
        blocked = parts.is_discontinuous.any() and not np.any(progress.held)
        if blocked and progress.is_exact and progress.damping >= 1e2:
            progress = replace(progress, held=parts.is_discontinuous, damping=0.0)
            continue
        fails = progress.is_exact and (trial is None or progress.damping > LARGEST_DAMPING)
        ends = fails or rests
        closed = parts.made_continuous(iterate, step) if ends else iterate
        status = status_at_kink(parts, closed, states_only=nodes_alone) if ends else STALLED
        # A run that rests elsewhere continues.
        if fails or status != STALLED:
            return End(closed, status, count)

        # Accept.
        gained = 0.0 if trial is None else start - merit(trial)
        following = progress.after(step, start, gained, length)
        becomes_exact = following.is_exact and not (progress.is_exact or states_only)
        progress = following
        iterate = trial or iterate
        # Without good gains to begin with, and stable predictors that are simulated, at most one of
        # 7 runs reaches the predictors of the tilt plant.
        z = best_gains(parts, iterate, progress.gap_variance) if becomes_exact else iterate.z
        iterate = iterate if z is iterate.z else parts.at(z, iterate.nodes)
        # For a long record, they take an eighth of the memory.
        del step, trial, closed
        linearizations = []
    end = End(iterate, EXCEEDED, iterations)
    return _arrived(parts, end, states_only=states_only) if progress.is_exact else end


def _arrived(parts: AllParts, end: End, *, states_only: bool) -> End:
    """Return the end at the limit of iterations, continuous; the run may have arrived."""

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
    dearer = parts.cost(end) > with_rounding(parts.cost(iterate))
    return None if dearer or not (parts.is_continuous(end) and are_stable(parts, end)) else end


def _is_settled(
    parts: AllParts,
    iterate: Iterate,
    step: Step,
    merit: float,
    progress: Progress,
    *,
    states_only: bool,
) -> bool:
    """Return whether little is left to gain, also by a step that is not damped."""
    negligible = max(parts.settings.tol, ROUNDING * abs(merit))
    little = (1 + progress.damping) * step.decrease <= negligible
    if not (progress.is_exact and little and parts.is_continuous(iterate)):
        return False
    if not progress.damping:
        return True
    undamped = gauss_newton_step(
        parts,
        iterate,
        step.linearizations,
        replace(progress, damping=0.0),
        states_only=states_only,
    )
    return undamped.decrease <= progress.undamped_decrease


def _end_within_noise(
    parts: AllParts, iterate: Iterate, step: Step, progress: Progress
) -> Iterate | None:
    """Return the iterate, continuous, if noise hides all that is left to gain, else None.

    Where the data hardly determine some directions, short steps continue along them for thousands
    of iterations, for a hundredth of a unit of log-likelihood (the tanh chain is lost without
    this). A plateau far from the data looks the same; but there the residuals are not noise. What
    lies beyond a bound is not to gain.
    """
    # Steps along states that no output shows leave gaps beyond rounding.
    closed = parts.made_continuous(iterate, step)
    explained = (part.explains_data(trajectory) for part, trajectory in parts.along(closed))
    if not (parts.is_continuous(closed) and all(explained)):
        return None
    # The gaps of the last linearization are closed, which changes its residuals.
    undamped = exact_step(parts, closed, replace(progress, damping=0.0))
    # A step that is not stopped by a bound decreases the cost by its `distance`, and continues to
    # converge.
    stopped = undamped.decrease > 2 * undamped.distance
    # Noise moves the minimum by half a unit of log-likelihood per unknown on average. At a tenth
    # of a standard error, a hundredth of it is left; half of the square is used here.
    unknowns = len(closed.z) + sum(part.unknown_initial_states for part in parts.parts)
    is_noise = undamped.distance <= 5e-3 and undamped.decrease <= 0.01 * unknowns / 2
    return closed if stopped and is_noise else None
