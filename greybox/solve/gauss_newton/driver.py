"""The iteration: from a start to a minimum of one compiled problem, see `greybox.solve.gauss_newton`."""

import math
import time
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Part, Trajectory
from greybox.compiled.record_group import excerpts
from greybox.compiled.strategies import Strategies
from greybox.files.arrays import Array
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.solve.constraints import Limits
from greybox.solve.gauss_newton.all_parts import AllParts
from greybox.solve.gauss_newton.damping import after_failure, next_damping
from greybox.solve.gauss_newton.homotopy import Progress
from greybox.solve.gauss_newton.iterate import Iterate, Nodes, Step
from greybox.solve.gauss_newton.line_search import line_search
from greybox.solve.gauss_newton.merit import merit_function
from greybox.solve.gauss_newton.normal_equations import gauss_newton_step
from greybox.solve.gauss_newton.screening import Screening, distinct
from greybox.solve.gauss_newton.sharpening import is_blurred, sharp_step
from greybox.solve.gauss_newton.stability import are_stable, best_gains, simulate_stable
from greybox.solve.interruption import reason_to_end
from greybox.solve.local_solver import LocalSolver, Profile, Screened
from greybox.solve.minima import Multistart, same_cost
from greybox.solve.outcome import CUT_SHORT, NOT_FINITE, Outcome

# Trial steps may overflow; they are then shortened.
DIVERGING = np.errstate(over="ignore", invalid="ignore", divide="ignore")

# Iterations of the nodes alone that smooth the states for another solver to begin with.
SMOOTHING_ITERATIONS = 3

# Iterations of a run that is continued, at most: of the narrow valleys among NIST's problems,
# Bennett5 takes 1300.
MOST_ITERATIONS = 2000

# Steps that polish the best minimum, at most: those of a model that hardly explains the data shrink
# by a third only.
POLISHING = 50

# Half the squared length of a step, in standard errors, that changes none of a parameter's first
# nine digits.
EXACT = 1e-18

# Decrease and half squared length of an undamped step from which the best minimum is polished by
# damped ones first.
LONG_STEP = 1e-7

# Iterations from one look to the next whether noise hides what is left to gain; most runs take
# fewer in all.
LONG_RUN = 50

# Share of the half unit of log-likelihood per parameter by which noise moves the minimum from the
# truth, in the mean: what is left to gain at a distance of a tenth of a standard error in every
# direction.
AGAINST_NOISE = 0.01

# Half the square of a tenth of a standard error.
TENTH = 5e-3

# A step of up to a thousand times the tolerance that no line search can take any more is rounding
# of the merit.
ROUNDED = 1e3


class GaussNewton(LocalSolver):
    """The solver of one compiled problem whose parts have hidden unknowns, built once for all starts."""

    def __init__(
        self,
        nlp: CompiledProblem,
        parts: tuple[Part, ...] | None = None,
        *,
        settings: Strategies | None = None,
    ) -> None:
        """Build what every run shares; `parts` and `settings` stand in for those of the problem."""
        self._nlp = nlp
        self._settings: Strategies = settings or nlp.strategies
        self._limits = _limits(nlp)
        self._parts = AllParts(parts or nlp.parts, self._limits, self._settings)
        gains = [gain for gain in self._parts.gains if gain is not None]
        self._all_predict = len(gains) == sum(part.has_states for part in self._parts.parts)
        self._has_free_gains = any(name in nlp.free for gain in gains for name in gain.names)
        jumping = {name for part in self._parts.parts for name in part.discontinuous_delays}
        self._is_discontinuous = np.array([name in jumping for name in nlp.free])
        # The answer does not depend on where a run is made.
        self._can_sharpen = parts is None and all(part.travels_whole for part in nlp.parts)
        self._coarse = self._coarse_solver() if parts is None else None
        self._polished: tuple[Array, Nodes, Iterate] | None = (
            None  # an estimate, and the iterate that it belongs to
        )

    def __reduce__(self) -> tuple[Callable[..., "GaussNewton"], tuple[Any, ...]]:
        """Return what builds the same solver, of the whole problem."""
        return partial(GaussNewton, settings=self._settings), (self._nlp,)

    def _coarse_solver(self) -> "GaussNewton | None":
        """Return the solver on excerpts of long records, which lead to the neighborhood of the minimum."""
        settings = self._settings
        samples = sum(part.samples for part in self._nlp.parts)
        if samples <= settings.long_record or not settings.stretches_first:
            return None
        return self.on_excerpts(settings.long_record // 2)

    def on_excerpts(self, samples: int) -> "GaussNewton":
        """Return the solver of the same problem on excerpts of the records, of about so many samples in all."""
        return GaussNewton(
            self._nlp, tuple(excerpts(self._nlp.parts, samples)), settings=self._settings
        )

    def within(self, low: Array, high: Array, equation: ca.Function | None = None) -> "GaussNewton":
        """Return the same solver with other bounds of the variables z (p,), and an `equation` (z) -> 0 that holds."""
        other = copy(self)
        other._polished = None
        other._limits = replace(self._limits, low=low, high=high)
        if equation is not None:
            other._limits = other._limits.with_equation(equation)
        other._parts = self._parts.within(other._limits)
        other._coarse = None if self._coarse is None else self._coarse.within(low, high, equation)
        return other

    def refined(self, nlp: CompiledProblem) -> "GaussNewton":
        """Return the solver of the same problem with finer steps."""
        return GaussNewton(nlp, settings=self._settings)

    @property
    def nlp(self) -> CompiledProblem:
        """The compiled problem."""
        return self._nlp

    @property
    def samples(self) -> int:
        """Those of all records, or of their excerpts."""
        return sum(part.samples for part in self._parts.parts)

    @property
    def limits(self) -> Limits:
        """The bounds and constraints."""
        return self._limits

    @property
    def settings(self) -> Strategies:
        """Those of the problem, with the options of the solver."""
        return self._settings

    # --- runs

    @DIVERGING
    def run(self, start: Array, iterations: int | None = None) -> Outcome:
        """Solve from the parameters `start` (p,) in so many `iterations`."""
        began = time.perf_counter()
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        before = 0
        if self._coarse is not None:
            first = self._coarse.run(start, iterations)
            if first.status in CUT_SHORT:  # its cost is that of the excerpts
                return replace(first, cost=math.inf, signature=None, nodes=None)
            z, before = self._nlp.scaling.to_solver(first.estimate), first.iterations
        outcome, _ = self.run_from(z, iterations, near_solution=self._coarse is not None)
        return replace(
            outcome, iterations=before + outcome.iterations, seconds=time.perf_counter() - began
        )

    @DIVERGING
    def run_from(
        self, z: Array, iterations: int | None = None, *, near_solution: bool = False
    ) -> tuple[Outcome, Array | None]:
        """Solve from z (p,) with nodes from the data; also return the Hessian (p, p) of the last step, None without.

        From about a solution, continuity is demanded from the first step of the parameters.
        """
        progress = self._progress(near_solution=near_solution)
        outcome = self._solve(self._parts.from_data(z), progress, iterations)
        return outcome, progress.hessian

    @DIVERGING
    def run_simulated(self, start: Array, nodes: Nodes, iterations: int) -> Outcome | None:
        """Solve from a simulation at the parameters `start` (p,); None where it diverges.

        It begins with the first of the `nodes` of every stretch. Limits that a model reaches at
        times, and nodes close to the data would hide, are so seen at once.
        """
        began = time.perf_counter()
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        first = self._parts.at(z, self._parts.joined(nodes))
        iterate = self._parts.simulated(first.z, first.nodes) if first.finite else first
        if not self._parts.stays_near_data(iterate) or not are_stable(self._parts, iterate):
            return None
        outcome = self._solve(iterate, Progress.exact(self._settings), iterations)
        return replace(outcome, seconds=time.perf_counter() - began)

    @DIVERGING
    def solved_from(self, x: Array, nodes: Nodes) -> Outcome:
        """Solve from the parameters x (p,) and nodes that are about those of the solution."""
        began = time.perf_counter()
        outcome = self._solve(self._at(x, nodes), Progress.exact(self._settings), None)
        return replace(outcome, seconds=time.perf_counter() - began)

    @DIVERGING
    def continued(self, outcome: Outcome) -> Outcome:
        """Go on from the end of a run that did not converge, with many more iterations."""
        if outcome.nodes is None:
            return outcome
        began = time.perf_counter()
        samples = sum(part.samples for part in self._nlp.parts)
        most = max(min(self._settings.continued_samples // max(samples, 1), MOST_ITERATIONS), 1)
        iterations = max(most, self._settings.max_iterations)
        iterate = self._at(outcome.estimate, outcome.nodes)
        after = self._solve(iterate, Progress.exact(self._settings), iterations)
        spent = {
            "iterations": outcome.iterations + after.iterations,
            "seconds": outcome.seconds + time.perf_counter() - began,
        }
        return replace(after if after.converged or after.cost < outcome.cost else outcome, **spent)

    @DIVERGING
    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum moved by undamped steps, as long as they grow shorter.

        They are judged by their length in standard errors: the cost no longer shows them. In a
        narrow curved valley, where the first of them is long, damped ones come before.
        """
        if not search.minima or search.nodes is None or not self._settings.polished_minimum:
            return search
        best = search.minima[0]
        start = self._at(best.estimate, search.nodes)
        try:
            end, remaining = self._undamped(start)
            if remaining > LONG_STEP:
                progress = Progress.exact(self._settings)
                progress.undamped_decrease = LONG_STEP
                later, _, _ = self._descend(
                    end, progress, POLISHING, states_only=False, restarted=True
                )
                end, _ = self._undamped(later)
        except np.linalg.LinAlgError:
            return search
        cost = self._parts.cost(end, 0.0)
        # What leads to another cost has left the minimum, as where a predictor ends at its
        # stability limit.
        rounding = self._settings.cost_rounding * max(1.0, abs(best.cost))
        if not best.cost - same_cost(self._nlp, best.cost) <= cost <= best.cost + rounding:
            return search
        estimate = np.clip(self._nlp.scaling.to_parameters(end.z), self._nlp.lower, self._nlp.upper)
        minimum = replace(best, cost=min(cost, best.cost), estimate=estimate)
        nodes = self._parts.nodes_by_part(end)
        self._polished = (estimate, nodes, end)
        return replace(search, minima=(minimum, *search.minima[1:]), nodes=nodes)

    def _at(self, x: Array, nodes: Nodes) -> Iterate:
        """Return the iterate at the parameters x (p,) with these nodes of every part of the problem."""
        if (
            self._polished is not None
            and nodes is self._polished[1]
            and np.array_equal(x, self._polished[0])
        ):
            return self._polished[2]
        return self._parts.at(self._nlp.scaling.to_solver(x), self._parts.joined(nodes))

    def _undamped(self, iterate: Iterate) -> tuple[Iterate, float]:
        """Return where undamped steps lead that grow shorter, and the decrease and half squared length of the next."""
        progress = Progress.exact(self._settings)
        highest = self._parts.cost(iterate) + self._settings.cost_rounding * max(
            1.0, abs(self._parts.cost(iterate))
        )
        last, end = math.inf, iterate
        for k in range(POLISHING):
            step = self._exact_step(iterate, progress, first=k == 0)
            remaining = abs(step.decrease) + step.distance
            if not remaining < last:
                break
            last, end = remaining, iterate
            if remaining < EXACT:
                break
            iterate = self._continuous(self._parts.moved(iterate, step, 1.0), step, progress)
            within = iterate.finite and self._parts.cost(iterate) <= highest
            if (
                not within
                or not self._parts.is_continuous(iterate)
                or not are_stable(self._parts, iterate)
            ):
                break
        return end, last

    def _exact_step(self, iterate: Iterate, progress: Progress, *, first: bool) -> Step:
        """Return the step where continuity is exact and an estimated covariance follows; the `first` begins it."""
        weights = self._parts.residual_weights(iterate)
        linearizations = self._parts.linearize(iterate, weights, covariance_curvature=True)
        if first:
            progress.begin(iterate, self._parts.gap_variances(linearizations))
        return self._step(iterate, linearizations, progress, states_only=False)

    def _continuous(self, iterate: Iterate, step: Step, progress: Progress) -> Iterate:
        """Close what gaps curvature has left, to rounding."""
        for _ in range(self._settings.gap_closings):
            if not iterate.finite or self._parts.is_continuous(iterate):
                break
            iterate = self._parts.close_gaps(iterate, step, progress.multipliers, 0.0)
        return iterate

    def _solve(self, iterate: Iterate, progress: Progress, iterations: int | None) -> Outcome:
        nlp = self._nlp
        try:
            iterate, status, count = self._descend(
                iterate, progress, iterations or self._settings.max_iterations, states_only=False
            )
        except np.linalg.LinAlgError:
            return Outcome(
                nlp.scaling.to_parameters(iterate.z), "singular", 0, 0.0, False, math.inf
            )
        if status == "converged" and self._can_sharpen and is_blurred(progress.hessian):
            iterate = self._sharpened(iterate)
        estimate = np.clip(nlp.scaling.to_parameters(iterate.z), nlp.lower, nlp.upper)
        cost = self._parts.cost(iterate, 0.0)
        if status == "converged" and self._limits.violation(iterate.z) > 0:
            status = "constraints violated"
        if status == "converged" and not are_stable(self._parts, iterate):
            status = "unstable predictor"
        converged = status == "converged" and math.isfinite(cost)
        signature, nodes = self._parts.signature(iterate), self._parts.nodes_by_part(iterate)
        return Outcome(estimate, status, count, 0.0, converged, cost, signature, nodes)

    def _sharpened(self, iterate: Iterate) -> Iterate:
        """Return where steps lead that are exact where the Hessian has lost its digits, within all limits."""
        progress = Progress.exact(self._settings)
        for k in range(POLISHING):
            step = sharp_step(
                self._nlp, self._parts, iterate, self._exact_step(iterate, progress, first=k == 0)
            )
            normals, bounds = self._limits.linearized(iterate.z)
            if step.decrease <= self._settings.tolerance or np.any(normals @ step.dz < bounds):
                break
            merit = merit_function(self._parts, self._parts.residual_weights(iterate), progress)
            trial, _ = line_search(self._parts, iterate, step, merit, merit(iterate), progress)
            if trial is None or not are_stable(self._parts, trial):
                break
            iterate = self._continuous(trial, step, progress)
        return iterate

    @DIVERGING
    def is_finite_at(self, start: Array) -> bool:
        """Tell whether the model is finite at the parameters `start` (p,), near the data."""
        if self._coarse is not None:
            return self._coarse.is_finite_at(start)
        z = self._limits.nearest(self._nlp.scaling.to_solver(start))
        return self._parts.from_data(z).finite

    @DIVERGING
    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) by prediction errors over short segments, see `screening`.

        The first start, the declared values, is among the promising ones in any case, and as it is.
        Of several that lead to one point the best begins there, and the others are tried last, as
        they are.
        """
        if not self._settings.screened_starts or not Screening.serves(self._nlp):
            return None
        z = np.array(
            [self._limits.nearest(self._nlp.scaling.to_solver(start)) for start in starts[1:]]
        )
        improved = Screening(self._nlp, self._limits).improved(z)
        promising = [k + 1 for k in distinct(improved)]
        begins = starts.copy()
        found = self._nlp.scaling.to_parameters(improved.z)
        begins[promising] = np.clip(found, self._nlp.lower, self._nlp.upper)[
            [k - 1 for k in promising]
        ]
        left = sorted(set(range(1, len(starts))) - set(promising))
        before = self.promising[0] - 1
        order = np.array([*promising[:before], 0, *promising[before:], *left])
        return Screened(order, np.full(len(starts), np.inf), begins)

    # --- at given parameters

    @DIVERGING
    def profile(self, x: Array, nodes: Nodes | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,); `nodes`, if given, are known to be the best."""
        iterate, cost, found = self._best(x, nodes)
        return Profile(iterate.z, self._parts.split(iterate), cost, found)

    @DIVERGING
    def _best(self, x: Array, nodes: Nodes | None = None) -> tuple[Iterate, float, bool]:
        """Return the iterate with the best nodes at the parameters x (p,), its cost, and whether they were found."""
        status = "converged"
        if nodes is not None:
            iterate = self._at(x, nodes)
        else:
            iterate = self._parts.from_data(self._nlp.scaling.to_solver(x))
            try:
                iterate, status, _ = self._descend(
                    iterate, self._progress(), self._settings.max_iterations, states_only=True
                )
            except np.linalg.LinAlgError:
                status = "singular"
        found = status == "converged" and are_stable(self._parts, iterate)
        return iterate, self._parts.cost(iterate, 0.0), found

    @DIVERGING
    def lost_beyond(self, x: Array, nodes: Nodes) -> tuple[Trajectory, ...] | None:
        """Return where the shortest step from an end leads at which the model is not finite; None without one."""
        iterate = self._at(x, nodes)
        if not iterate.finite:
            return self._parts.split(iterate)
        progress = Progress.exact(self._settings)
        lost = None
        try:
            linearizations = self._parts.linearize(iterate, self._parts.residual_weights(iterate))
            progress.begin(iterate, self._parts.gap_variances(linearizations))
            step = self._step(iterate, linearizations, progress, states_only=False)
        except np.linalg.LinAlgError:
            return None
        length = 1.0
        while length > self._settings.shortest_step:
            trial = self._parts.moved(iterate, step, length)
            if trial.finite:
                break
            lost = self._parts.split(trial)
            length *= self._settings.step_reduction
        return lost

    def cost(self, values: Array) -> float:
        """Return the smallest cost at all values (k,) with exact continuity; NaN where there is none.

        Raises
        ------
        ValueError
            For another value of a fixed parameter: it is compiled in.
        """
        count = len(self._nlp.free)
        for name, value, stated in zip(
            self._nlp.constants, values[count:], self._nlp.constant_values, strict=True
        ):
            if value != stated:
                raise ValueError(
                    f"{name} is fixed at {stated:g} here: give {value:g} to the problem, fixed={{{name!r}: ...}}."
                )
        _, cost, found = self._best(values[:count])
        return cost if found else math.nan

    def signature(self, x: Array) -> Array | None:
        """Return what `Outcome.signature` holds, at the best nodes for x (p,); None where there are none."""
        iterate, _, found = self._best(x)
        return self._parts.signature(iterate) if found else None

    @DIVERGING
    def smoothed(self, z: Array) -> tuple[Trajectory, ...] | None:
        """Return the trajectories of every part at z with nodes close to the data and nearly continuous.

        None where the model diverges.
        """
        iterate = self._parts.from_data(z)
        if not iterate.finite:
            return None
        try:
            smoothed, _, _ = self._descend(
                iterate, Progress(self._settings), SMOOTHING_ITERATIONS, states_only=True
            )
        except np.linalg.LinAlgError:
            return None
        return self._parts.split(smoothed)

    def _progress(self, *, near_solution: bool = False) -> Progress:
        """Return the progress of an iteration that begins with nodes from the data, exact where there are none."""
        if not any(part.has_nodes for part in self._parts.parts):
            return Progress.exact(self._settings)
        return Progress(self._settings, near_solution=near_solution)

    # --- the iteration

    def _descend(
        self,
        iterate: Iterate,
        progress: Progress,
        iterations: int,
        *,
        states_only: bool,
        restarted: bool = False,
    ) -> tuple[Iterate, str, int]:
        """Iterate from a start; a stalled run begins once more near the data, with the parameters that it found."""
        if not iterate.finite:
            return iterate, NOT_FINITE, 0
        linearizations = self._parts.linearize(iterate, self._parts.initial_weights())
        progress.begin(iterate, self._parts.gap_variances(linearizations))
        if self._all_predict and self._settings.early_prediction:
            progress.last_scale = self._settings.prediction_gap
        first = None if progress.is_exact else linearizations
        end, status, count = self._iterate(
            iterate, first, progress, iterations, states_only=states_only
        )
        if status != "stalled" or states_only or restarted or not self._settings.restart_near_data:
            return end, status, count

        again = self._parts.from_data(end.z)
        later, status, more = self._descend(
            again, self._progress(), iterations - count, states_only=False, restarted=True
        )
        return (
            (later, status, count + more)
            if status == "converged"
            else (end, "stalled", count + more)
        )

    def _iterate(
        self,
        iterate: Iterate,
        linearizations: list | None,
        progress: Progress,
        iterations: int,
        *,
        states_only: bool,
    ) -> tuple[Iterate, str, int]:
        settings, parts = self._settings, self._parts
        initial_weights = parts.initial_weights()
        for iteration in range(iterations):
            if cut := reason_to_end():
                return iterate, cut, iteration
            weights = parts.residual_weights(iterate) if progress.is_exact else initial_weights
            near = (
                progress.last_decrease < settings.covariance_decrease
                and settings.covariance_curvature
            )
            linearizations = linearizations or parts.linearize(
                iterate, weights, covariance_curvature=near
            )
            alone = states_only or progress.state_iterations > 0
            step = self._step(iterate, linearizations, progress, states_only=alone)
            linearizations = None

            merit = merit_function(parts, weights, progress)
            before = merit(iterate)
            settled = self._is_settled(iterate, step, before, progress, states_only=alone)
            looks = not alone and (iteration + 1) % LONG_RUN == 0
            if (settled and step.distance <= settings.tolerance) or (
                looks and self._is_within_noise(iterate, step, progress)
            ):
                return iterate, "converged", iteration
            trial, length = line_search(parts, iterate, step, merit, before, progress)
            if trial is None and settled and step.distance <= ROUNDED * settings.tolerance:
                return iterate, "converged", iteration
            recovered = self._recover(iterate, trial, length, progress)
            if recovered is not None:
                iterate = recovered
                continue
            if progress.is_exact and (trial is None or progress.damping > settings.largest_damping):
                return iterate, "stalled", iteration

            gained = 0.0 if trial is None else before - merit(trial)
            iterate = trial or iterate
            ratio = gained / step.decrease if step.decrease > 0 else 1.0
            if length == 1 and progress.damping:
                progress.full_damping = progress.damping
            progress.damping = next_damping(
                settings, progress.damping, length, ratio, progress.full_damping
            )
            if not progress.is_exact:
                iterate = self._tighten(
                    iterate, step, progress, gained, length, before, states_only=states_only
                )
                continue
            iterate = self._simulate_predictors(iterate)
            if self._has_converged(iterate, step, progress, length):
                return iterate, "converged", iteration + 1
        return iterate, "iterations exceeded", iterations

    def _recover(
        self, iterate: Iterate, trial: Iterate | None, length: float, progress: Progress
    ) -> Iterate | None:
        """Return where to go on after a line search that made no progress; None where its step stands."""
        settings = self._settings
        if trial is None and progress.damping <= settings.largest_damping:
            progress.damping = after_failure(settings, progress.damping)
            return iterate
        if length < settings.short_step:
            simulated = self._simulate_instead(progress)
            if simulated is not None:
                return simulated
        if self._may_hold_delays(progress) and progress.hold_delays():
            return iterate
        return None

    def _step(
        self, iterate: Iterate, linearizations: list, progress: Progress, *, states_only: bool
    ) -> Step:
        """Return the step; delays that are held do not move."""
        held = self._is_discontinuous & progress.delays_held
        return gauss_newton_step(
            self._parts, iterate, linearizations, progress, held=held, states_only=states_only
        )

    def _is_settled(
        self, iterate: Iterate, step: Step, before: float, progress: Progress, *, states_only: bool
    ) -> bool:
        """Tell whether little is left to gain, also by a step that is not damped."""
        settings = self._settings
        small = max(settings.tolerance, settings.cost_rounding * abs(before))
        little = (1 + progress.damping) * step.decrease <= small
        if not (progress.is_exact and little and self._parts.is_continuous(iterate)):
            return False
        if not progress.damping:
            return True
        return (
            self._undamped_step(iterate, step, progress, states_only=states_only).decrease
            <= progress.undamped_decrease
        )

    def _is_within_noise(self, iterate: Iterate, step: Step, progress: Progress) -> bool:
        """Tell whether noise hides all that is left to gain, wherever bounds let a step go.

        Where the data hardly determine some directions, short steps go on along them for thousands
        of iterations, for a hundredth of a unit of log-likelihood. What is far from the data, on a
        plateau, looks the same; but there the residuals are not noise.
        """
        if not (
            progress.is_exact
            and self._parts.is_continuous(iterate)
            and self._parts.explain_data(iterate)
        ):
            return False
        undamped = self._undamped_step(iterate, step, progress, states_only=False)
        # What no bound stops decreases the cost by its distance, and goes on to converge.
        stopped = undamped.decrease > 2 * undamped.distance
        return (
            stopped
            and undamped.distance <= TENTH
            and undamped.decrease <= AGAINST_NOISE * len(iterate.z) / 2
        )

    def _undamped_step(
        self, iterate: Iterate, damped: Step, progress: Progress, *, states_only: bool
    ) -> Step:
        """Return the step from the same linearization without damping."""
        undamped = copy(progress)
        undamped.damping, undamped.multipliers = 0.0, list(progress.multipliers)
        return self._step(iterate, list(damped.linearizations), undamped, states_only=states_only)

    def _tighten(
        self,
        iterate: Iterate,
        step: Step,
        progress: Progress,
        gained: float,
        length: float,
        before: float,
        *,
        states_only: bool,
    ) -> Iterate:
        """Demand more continuity where it is time; gains are chosen once it is exact."""
        settings = self._settings
        done = step.decrease <= settings.kept_promise * abs(before) or length == 0
        if self._all_predict and settings.early_prediction:
            done = done or length < settings.brief_step
        if not length:
            progress.damping = 0.0
        progress.advance(iterate, step, gained, length, done=done)
        if not progress.is_exact:
            return iterate
        return self._simulate_predictors(
            iterate if states_only else self._with_gains(iterate, progress)
        )

    def _has_converged(
        self, iterate: Iterate, step: Step, progress: Progress, length: float
    ) -> bool:
        """Tell whether the step to `iterate` was the last: at worst, the next decrease follows from the last two."""
        if length < 1 or progress.damping:
            progress.last_decrease = math.nan
            return False
        decrease, last = max(step.decrease, step.distance), progress.last_decrease
        following = decrease**2 / last if decrease < last < 1 else math.inf
        progress.last_decrease = decrease
        if not self._settings.extrapolated_convergence:
            return False
        return following <= self._settings.tolerance and self._parts.is_continuous(iterate)

    def _simulate_instead(self, progress: Progress) -> Iterate | None:
        """Return the best simulation where Newton steps do not close the gaps, None where it diverges.

        From here on every trial is simulated from its first nodes: a trajectory that a stable model
        always has.
        """
        if (
            not self._settings.simulation_fallback
            or progress.homotopy_end is None
            or progress.start is None
        ):
            return None
        origins = (progress.homotopy_end, progress.start)
        best = min((self._parts.simulated(*origin) for origin in origins), key=self._parts.cost)
        progress.homotopy_end = None
        if not self._parts.stays_near_data(best) or not are_stable(self._parts, best):
            return None
        progress.damping = 0.0
        progress.last_decrease = math.nan
        progress.multipliers = [np.zeros_like(m) for m in progress.multipliers]
        return best

    def _simulate_predictors(self, iterate: Iterate) -> Iterate:
        return (
            simulate_stable(self._parts, iterate)
            if self._settings.simulated_predictors
            else iterate
        )

    def _may_hold_delays(self, progress: Progress) -> bool:
        settings = self._settings
        blocked = progress.damping >= settings.blocked_damping
        return settings.held_discontinuous_delays and blocked and bool(self._is_discontinuous.any())

    def _with_gains(self, iterate: Iterate, progress: Progress) -> Iterate:
        """Return the iterate with gains to begin with; without stable ones, continuity is tightened more slowly."""
        if not self._has_free_gains:
            return iterate
        settings = self._settings
        z = iterate.z
        if settings.riccati_gains:
            z = best_gains(self._parts, iterate, progress.gap_variance)
        iterate = self._parts.at(z, iterate.nodes)
        if progress.last_scale == settings.prediction_gap and not are_stable(self._parts, iterate):
            # As without a predictor: the model alone leads to the neighborhood.
            progress.gap_scale = settings.gap_reduction
            progress.last_scale = settings.last_gap
        return iterate


@one_thread_at_a_time
def _limits(nlp: CompiledProblem) -> Limits:
    """Return the bounds and constraints in the solver's variables."""
    kind: Any = ca.SX if nlp.program.is_a("SXFunction") else ca.MX
    z = kind.sym("z", len(nlp.free))
    _, g = nlp.program(z, 0.0)
    constraints = ca.Function("constraints", [z], [g, ca.densify(ca.jacobian(g, z))])
    return Limits(nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper), constraints)
