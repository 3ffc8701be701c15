"""The Gauss-Newton solver of one compiled problem, for a search and for an estimate."""

import math
import time
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.solve.constraints import Limits, limits_of
from greybox.engine.solve.gauss_newton.all_parts import AllParts, with_rounding
from greybox.engine.solve.gauss_newton.iterate import (
    CONVERGED,
    EXACT,
    Iterate,
    Nodes,
    Progress,
    relaxed,
)
from greybox.engine.solve.gauss_newton.iteration import SINGULAR, descend
from greybox.engine.solve.gauss_newton.kinks import status_at_kink
from greybox.engine.solve.gauss_newton.polishing import is_blurred, polished, sharpened
from greybox.engine.solve.gauss_newton.screening import can_move, can_screen, distinct, improved
from greybox.engine.solve.gauss_newton.settings import USUAL, Settings
from greybox.engine.solve.gauss_newton.stability import are_stable
from greybox.engine.solve.local_solver import Descent, Profile, Screened
from greybox.engine.solve.minima import Multistart, same_cost
from greybox.engine.solve.runs import NOT_FINITE, Outcome, Outcomes, spent
from greybox.modeling.cached_property import cached_property

# Trial steps may overflow; they are then shortened.
DIVERGING = np.errstate(all="ignore")

# Units of log-likelihood for every number by which a cost is in doubt after one step of the states:
# those of residuals that are larger by a tenth.
DOUBTFUL = 0.1

# A run of a record of more than four times this number of samples begins on excerpts of so many. A
# fit of 250 000 or 10⁶ samples then takes a quarter less time. In segments of ten samples, they
# fill whole batches: memory for another number of columns is not needed.
EXCERPT = 40_000


class GaussNewton(Descent):
    """The solver of one compiled problem with hidden unknowns, built once for all starts.

    Attributes
    ----------
    nlp : CompiledProblem
    settings : Settings
    limits : Limits
        Bounds and constraints.
    """

    def __init__(
        self, nlp: CompiledProblem, *, settings: Settings = USUAL, limits: Limits | None = None
    ) -> None:
        """Build what every run shares; by default the limits are those of the problem."""
        self.nlp = nlp
        self.settings = settings
        self.limits = limits or limits_of(nlp)
        self._parts = AllParts(nlp, self.limits, settings)
        # Where runs of all samples of a long record ended, by the minimum of its excerpts.
        self._ends: dict[bytes, Outcome] = {}
        self._polished: tuple[Array, Nodes, Iterate] | None = None

    def within(self, low: Array, high: Array, equation: ca.Function | None = None) -> "GaussNewton":
        """Return the solver with other bounds of z (p,), and an `equation` (z) -> 0."""
        limits = replace(self.limits, low=low, high=high)
        if equation is not None:
            limits = limits.with_equation(equation)
        return GaussNewton(self.nlp, settings=self.settings, limits=limits)

    def with_problem(self, nlp: CompiledProblem) -> "GaussNewton":
        """Return the solver of the same problem with finer steps or other samples."""
        return GaussNewton(nlp, settings=self.settings, limits=self.limits)

    # --- runs

    @DIVERGING
    def led(self, starts: Array) -> Outcomes:
        """Return the runs from all starts (r, p)."""
        return [self._led(start) for start in starts]

    @DIVERGING
    def descended(self, starts: Array) -> Outcomes:
        """Return where the cost alone leads from the starts (r, p) and their best states."""
        return [self._solved(self._at(start, self._best_nodes(start)), EXACT) for start in starts]

    @DIVERGING
    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the costs (r,) at the starts (r, p) with their best states."""
        return np.array([self._cost_at(*pair) for pair in zip(starts, ends, strict=True)])

    def _cost_at(self, start: Array, end: Outcome) -> float:
        """Return the cost at the parameters `start` (p,); infinite if surely above the end's."""
        parts = self._parts
        z = self.nlp.scaling.to_solver(start)
        if self.limits.violation(z) > 0 or np.any(z != self.limits.clipped(z)):
            return math.inf
        # The best states may take as long as a run. One step of the states, which closes the gaps,
        # gives their cost if the model is linear in its states, and else an idea of it.
        # In a long record, initial states count little.
        near = parts.simulated(z) if self._excerpts else parts.continuous(parts.at(z))
        if end.cost < parts.cost(near) - DOUBTFUL * self.nlp.numbers:
            return math.inf
        profile = self.profile(start)
        return profile.cost if profile.converged else math.inf

    def _best_nodes(self, x: Array) -> Nodes:
        return [part.nodes for part in self.profile(x).trajectories]

    def _led(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,), or from where short segments lead from there.

        It is moved if predictions over whole segments are worse than the means of the outputs. With
        long records, excerpts lead on from there.
        """
        parts = self._parts
        begin = parts.at(self._nearest(start))
        left = parts.unexplained(begin)
        if self._excerpts:
            first = self._excerpts._led(start)
            # Runs that meet there continue once, from the same digits: each ends as it would alone,
            # which resumed searches and those of several workers rely on.
            minimum = np.array([float(f"{value:.6g}") for value in first.estimate])
            after = parts.at(self._nearest(minimum))
            # Excerpts may lack the manoeuvre that shows a parameter.
            if parts.unexplained(after) < left:
                outcome = self._ends.get(minimum.tobytes()) or self._solved(after, EXACT)
                if outcome.converged:
                    self._ends[minimum.tobytes()] = replace(outcome, seconds=0.0)
                    return spent(outcome, first)
        # Nodes follow segments that diverge, away from the data: without this, 30 to 32 of 40
        # starts of the tilt plant arrive, in twice the time (`time_fit.py`).
        if can_move(self.nlp) and left > 1:
            moved = parts.at(improved(self.nlp, self.limits, begin.z[None]).z[0])
            z = moved.z
            is_inside = np.all((z > self.limits.low) & (z < self.limits.high))
            # From a bound, a run seldom returns, unless that is nearly where it ends: predictions
            # then leave a hundredth of the variance.
            if parts.unexplained(moved) < (left if is_inside else 0.01):
                begin = moved
        return self._solved(*self._begun(begin))

    @cached_property
    def _finer(self) -> "GaussNewton":
        """Return the solver with twice the steps, for runs that arrive where they are too long."""
        return self.with_problem(self.nlp.refined(2))

    @cached_property
    def _excerpts(self) -> "GaussNewton | None":
        """Return the solver of the excerpts of a long record."""
        if max(part.samples for part in self.nlp.parts) <= 4 * EXCERPT:
            return None
        excerpts = tuple(part.excerpt(EXCERPT) for part in self.nlp.parts)
        return self.with_problem(replace(self.nlp, parts=excerpts))

    def _begun(self, begin: Iterate) -> tuple[Iterate, Progress]:
        """Return where to begin: with nodes from the data, or with simulated ones.

        Where few states are measured, predictions from the data may be worse than the means of the
        outputs. If a simulation is better, a rod of 40 states takes half the time from there.
        """
        parts = self._parts
        if (left := parts.unexplained(begin)) > 1 and not parts.is_gain.any():
            simulated = parts.simulated(begin.z)
            if parts.unexplained(simulated) < left:
                return simulated, EXACT
        return begin, parts.first_progress()

    @DIVERGING
    def solved_from(self, x: Array, nodes: Nodes, iterations: int | None = None) -> Outcome:
        """Solve from the parameters x (p,) and nodes that are near those of the solution."""
        return self._solved(self._at(x, nodes), EXACT, iterations)

    def near(self, x: Array, nodes: Nodes | None = None) -> Outcome:
        """Solve from parameters x (p,) near a minimum, whose states are solved first if unknown."""
        # From states of the data, a run may leave for another minimum.
        return self.solved_from(x, nodes or self._best_nodes(x))

    def continued(self, outcome: Outcome) -> Outcome:
        """Continue a run that did not converge, with many more iterations."""
        if outcome.nodes is None:
            return outcome
        # Three million samples are a moment's work. Bennett5, the narrowest valley among NIST's
        # problems, takes 1300 iterations.
        affordable = min(3_000_000 // max(self._parts.samples, 1), 2000)
        iterations = max(affordable, self.settings.max_iter)
        return spent(self.solved_from(outcome.estimate, outcome.nodes, iterations), outcome)

    def _solved(
        self, iterate: Iterate, progress: Progress, iterations: int | None = None
    ) -> Outcome:
        nlp, began = self.nlp, time.perf_counter()
        most = iterations or self.settings.max_iter
        end = descend(self._parts, iterate, progress, most)
        count = end.iterations
        if not self._parts.has_stable_steps(end.iterate):
            finer = self._finer
            outcome = finer._solved(*finer._begun(finer._parts.at(end.iterate.z)), iterations)
            count += outcome.iterations
            # Where these steps are stable after all, the cost shall be that of other runs.
            end = descend(self._parts, self._at(outcome.estimate, outcome.nodes), EXACT, most)
            if end.status != CONVERGED:
                return replace(outcome, iterations=count, seconds=time.perf_counter() - began)
        iterate, status = end.iterate, end.status

        # Only where it matters: exact derivatives take as long as several iterations.
        # Workers lack the information of some parts, and results must be the same in every process.
        is_inexact = status == CONVERGED and is_blurred(end.hessian)
        if is_inexact and all(part.travels_whole for part in nlp.parts):
            iterate = sharpened(self._parts, iterate)
        if status.startswith(CONVERGED) and self.limits.violation(iterate.z) > 0:
            status = "constraints violated"
        if status.startswith(CONVERGED) and not are_stable(self._parts, iterate):
            status = "unstable predictor"
        cost = self._parts.cost(iterate, 0.0)
        return Outcome(
            nlp.estimate_at(iterate.z),
            status,
            count,
            time.perf_counter() - began,
            status.startswith(CONVERGED) and math.isfinite(cost),
            cost,
            self._parts.signature(iterate) if iterate.finite else None,
            tuple(self._parts.groups.nodes_by_part(iterate.nodes)),
        )

    @DIVERGING
    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum polished by undamped steps.

        In NIST's 27 regressions, nine or more digits are then right instead of four to eight.
        """
        if search.nodes is None:
            return search
        best = search.minima[0]
        try:
            end = polished(self._parts, self._at(best.estimate, search.nodes))
        except np.linalg.LinAlgError:
            return search

        cost = self._parts.cost(end, 0.0)
        # Steps to another cost have left the minimum, for example if a predictor ends at its
        # stability limit.
        if not best.cost - same_cost(self.nlp, best.cost) <= cost <= with_rounding(best.cost):
            return search
        minimum = replace(best, cost=min(cost, best.cost), estimate=self.nlp.estimate_at(end.z))
        nodes = tuple(self._parts.groups.nodes_by_part(end.nodes))
        self._polished = minimum.estimate, nodes, end
        return replace(search, minima=(minimum, *search.minima[1:]), nodes=nodes)

    # --- starts

    @DIVERGING
    def is_finite_at(self, start: Array) -> bool:
        """Return whether the model is finite at the parameters `start` (p,), near the data.

        Excerpts decide it for a long record.
        """
        return (self._excerpts or self)._parts.at(self._nearest(start)).finite

    @DIVERGING
    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) by prediction errors over short segments, see `screening`.

        The first start, the declared values, is among the promising ones in any case. If several
        lead to one point, the best of them is promising; the others are tried last.
        """
        # Ten of 17 fits from the default starts take 1.5 to 8 times as long without screening, and
        # four of NIST's regressions more than 40 s; MGH17 takes half as long.
        if not can_screen(self.nlp):
            return None
        z = np.array([self._nearest(start) for start in starts[1:]])
        promising = [
            k + 1 for k in distinct(improved((self._excerpts or self).nlp, self.limits, z))
        ]
        untried = sorted(set(range(1, len(starts))) - set(promising))

        # Declared values may be good ones: they are always among the first.
        ahead = self.promising.runs[0] - 1
        order = np.array([*promising[:ahead], 0, *promising[ahead:], *untried])
        return Screened(order, np.full(len(starts), np.inf))

    # --- at given parameters

    @DIVERGING
    def profile(self, x: Array, nodes: Nodes | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,), which are `nodes` if these are known."""
        if nodes is not None:
            return self._profile(self._at(x, nodes), converged=True)
        first = self._begun(self._parts.at(self.nlp.scaling.to_solver(x)))
        return self._best_states(*first)

    @DIVERGING
    def profile_near(self, x: Array, nodes: Nodes) -> Profile:
        """Return the best nodes at the parameters x (p,), sought from these nodes alone."""
        return self._best_states(self._at(x, nodes), EXACT)

    def _best_states(self, iterate: Iterate, progress: Progress) -> Profile:
        most = self.settings.max_iter
        end = descend(self._parts, iterate, progress, most, states_only=True)
        return self._profile(end.iterate, converged=end.status.startswith(CONVERGED))

    def _profile(self, iterate: Iterate, *, converged: bool) -> Profile:
        # The cost of an unstable predictor depends on where its segments begin.
        converged = converged and are_stable(self._parts, iterate)
        cost = self._parts.cost(iterate, 0.0)
        trajectories = tuple(self._parts.groups.split(iterate.trajectories))
        return Profile(trajectories, cost, converged)

    @DIVERGING
    def is_minimum(self, x: Array, profile: Profile) -> bool:
        """Return whether no step from the parameters x (p,) and their best nodes gains anything."""
        iterate = self._at(x, [trajectory.nodes for trajectory in profile.trajectories])
        # IPOPT widens bounds and constraints by 1e-8.
        if not profile.converged or self.limits.violation(iterate.z, rounding=1e-7) > 0:
            return False
        try:
            return status_at_kink(self._parts, iterate, states_only=False).startswith(CONVERGED)
        except np.linalg.LinAlgError:
            return False

    @DIVERGING
    def smoothed(self, z: Array) -> tuple[Trajectory, ...] | None:
        """Return the trajectories at z (p,), with nodes close to the data and nearly continuous.

        None where the model diverges.
        """
        # Three iterations of the nodes are enough for another solver to begin with.
        end = descend(self._parts, self._parts.at(z), relaxed(), 3, states_only=True)
        if end.status in (NOT_FINITE, SINGULAR):
            return None
        return tuple(self._parts.groups.split(end.iterate.trajectories))

    # --- the solver's variables

    def _nearest(self, start: Array) -> Array:
        """Return the point z (p,) nearest to the parameters `start` within all limits."""
        return self.limits.nearest(self.nlp.scaling.to_solver(start))

    def _at(self, x: Array, nodes: Nodes) -> Iterate:
        """Return the iterate at the parameters x (p,) with these nodes of every part."""
        # The part remembers its linearization along the very trajectory of the polished minimum.
        if self._polished and self._polished[0] is x and self._polished[1] is nodes:
            return self._polished[2]
        return self._parts.at(self.nlp.scaling.to_solver(x), self._parts.groups.joined(nodes))
