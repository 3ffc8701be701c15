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

# Doubt about a cost after a single step of the states, in units of log-likelihood for every
# measured number. The cost grows by as much if all residuals grow by a tenth.
DOUBTFUL = 0.1

# Samples of the excerpts on which runs of long records begin. Records are long with more than four
# times as many: a fit of 250 000 or 10⁶ samples then takes a quarter less time. In segments of ten
# samples, the excerpts fill whole batches, which need no memory for another number of columns.
EXCERPT = 40_000


class GaussNewton(Descent):
    """The solver of one compiled problem whose states are unknowns, built once for all starts.

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
        """Store the arguments; the limits are those of the problem by default."""
        self.nlp = nlp
        self.settings = settings
        self.limits = limits or limits_of(nlp)
        self._parts = AllParts(nlp, self.limits, settings)
        # Ends of the runs of a long record with all of its samples, by the minimum of the excerpts
        # at which they began.
        self._ends: dict[bytes, Outcome] = {}
        # Estimate, nodes and iterate of the minimum that was polished last.
        self._polished: tuple[Array, Nodes, Iterate] | None = None

    def within(self, low: Array, high: Array, equation: ca.Function | None = None) -> "GaussNewton":
        """Return the solver with other bounds of z (p,), and an equation (z) -> 0 to meet."""
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
        """Return the runs from the starts (r, p) and the states that minimize the cost there.

        These runs minimize the cost alone, without a penalty on gaps between segments.
        """
        return [self._solved(self._at(start, self._best_nodes(start)), EXACT) for start in starts]

    @DIVERGING
    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the costs (r,) at the starts (r, p) with the states that minimize them.

        A cost that is surely above that of the run's end is infinite.
        """
        costs = [self._cost_at(start, end) for start, end in zip(starts, ends, strict=True)]
        return np.array(costs)

    def _cost_at(self, start: Array, end: Outcome) -> float:
        """Return the cost at the parameters `start` (p,); infinite if surely above the end's."""
        parts = self._parts
        z = self.nlp.scaling.to_solver(start)
        if self.limits.violation(z) > 0 or np.any(z != self.limits.clipped(z)):
            return math.inf
        # Solving for the states may take as long as a run. First a cheap estimate of the cost: in a
        # long record, initial states matter little and a simulation is enough. Otherwise one step
        # of the states closes the gaps, which is exact if the model is linear in its states.
        near = parts.simulated(z) if self._excerpts else parts.continuous(parts.at(z))
        if end.cost < parts.cost(near) - DOUBTFUL * self.nlp.numbers:
            return math.inf
        profile = self.profile(start)
        return profile.cost if profile.converged else math.inf

    def _best_nodes(self, x: Array) -> Nodes:
        """Return the nodes of every part that minimize the cost at the parameters x (p,)."""
        return [part.nodes for part in self.profile(x).trajectories]

    def _led(self, start: Array) -> Outcome:
        """Return the run from the parameters `start` (p,).

        The start is moved first if predictions over whole segments are worse than the means of the
        outputs: to where a fit of short segments leads. A run of a long record begins on excerpts.
        """
        parts = self._parts
        begin = parts.at(self._nearest(start))
        # The share of the variance of the outputs that predictions leave.
        unexplained = parts.unexplained(begin)
        if self._excerpts:
            outcome = self._led_by_excerpts(start, unexplained)
            if outcome is not None:
                return outcome
        # If segments diverge, their nodes follow them away from the data. Without the move, only 30
        # to 32 of 40 starts of the tilt plant reach the minimum, in twice the time (`time_fit.py`).
        if can_move(self.nlp) and unexplained > 1:
            moved = parts.at(improved(self.nlp, self.limits, begin.z[None]).z[0])
            z = moved.z
            is_inside = np.all((z > self.limits.low) & (z < self.limits.high))
            # A run seldom returns from a bound. It may begin there only if the minimum is near:
            # predictions then leave less than a hundredth of the variance.
            if parts.unexplained(moved) < (unexplained if is_inside else 0.01):
                begin = moved
        return self._solved(*self._begun(begin))

    def _led_by_excerpts(self, start: Array, unexplained: float) -> Outcome | None:
        """Return the run from `start` (p,) that begins on excerpts of a long record.

        None if it does not converge, or if the minimum of the excerpts explains the whole record
        worse than the start, which leaves a share `unexplained` of the variance.
        """
        assert self._excerpts
        first = self._excerpts._led(start)
        # Rounded, so that runs which meet at one minimum continue from the same digits, once for
        # all of them. Each ends as it would alone, on which resumed searches and workers rely.
        minimum = np.array([float(f"{value:.6g}") for value in first.estimate])
        begin = self._parts.at(self._nearest(minimum))
        # Excerpts may lack the manoeuvre that informs on a parameter.
        if not self._parts.unexplained(begin) < unexplained:
            return None
        outcome = self._ends.get(minimum.tobytes()) or self._solved(begin, EXACT)
        if not outcome.converged:
            return None
        self._ends[minimum.tobytes()] = replace(outcome, seconds=0.0)
        return spent(outcome, first)

    @cached_property
    def _finer(self) -> "GaussNewton":
        """Return the solver with twice the steps, for runs that end where steps are too long."""
        return self.with_problem(self.nlp.refined(2))

    @cached_property
    def _excerpts(self) -> "GaussNewton | None":
        """Return the solver of the excerpts of a long record."""
        if max(part.samples for part in self.nlp.parts) <= 4 * EXCERPT:
            return None
        excerpts = tuple(part.excerpt(EXCERPT) for part in self.nlp.parts)
        return self.with_problem(replace(self.nlp, parts=excerpts))

    def _begun(self, begin: Iterate) -> tuple[Iterate, Progress]:
        """Return the first iterate of a run and its settings.

        Nodes usually come from the data. If few states are measured, predictions from there may be
        worse than the means of the outputs, and a simulation may be better: a rod of 40 states
        takes half the time from simulated nodes.
        """
        parts = self._parts
        unexplained = parts.unexplained(begin)
        if unexplained > 1 and not parts.is_gain.any():
            simulated = parts.simulated(begin.z)
            if parts.unexplained(simulated) < unexplained:
                return simulated, EXACT
        return begin, parts.first_progress()

    @DIVERGING
    def solved_from(self, x: Array, nodes: Nodes, iterations: int | None = None) -> Outcome:
        """Return the run from the parameters x (p,) and nodes near those of the solution."""
        return self._solved(self._at(x, nodes), EXACT, iterations)

    def near(self, x: Array, nodes: Nodes | None = None) -> Outcome:
        """Return the run from parameters x (p,) near a minimum.

        Unknown nodes are solved for first: from those of the data, the run may leave for another
        minimum.
        """
        return self.solved_from(x, nodes or self._best_nodes(x))

    def continued(self, outcome: Outcome) -> Outcome:
        """Continue a run that did not converge, with many more iterations."""
        if outcome.nodes is None:
            return outcome
        # Three million samples take only a moment. Bennett5, the narrowest valley among NIST's
        # problems, takes 1300 iterations.
        affordable = min(3_000_000 // max(self._parts.samples, 1), 2000)
        iterations = max(affordable, self.settings.max_iter)
        return spent(self.solved_from(outcome.estimate, outcome.nodes, iterations), outcome)

    def _solved(
        self, iterate: Iterate, progress: Progress, iterations: int | None = None
    ) -> Outcome:
        """Return the run from an iterate, with at most so many iterations."""
        began = time.perf_counter()
        most = iterations or self.settings.max_iter
        end = descend(self._parts, iterate, progress, most)
        count = end.iterations
        if not self._parts.has_stable_steps(end.iterate):
            # The integration steps are too long for the model at the end. The run continues with
            # steps of half the length.
            finer = self._finer
            first, settings = finer._begun(finer._parts.at(end.iterate.z))
            outcome = finer._solved(first, settings, iterations)
            count += outcome.iterations
            # If it ends where the longer steps are stable after all, these give the cost, which is
            # then comparable with that of other runs.
            end = descend(self._parts, self._at(outcome.estimate, outcome.nodes), EXACT, most)
            if end.status != CONVERGED:
                return replace(outcome, iterations=count, seconds=time.perf_counter() - began)
        iterate, status = end.iterate, end.status

        # Exact derivatives take as long as several iterations, and are used only where it matters.
        # Parts on workers may lack what they need. Results must be the same in every process: then
        # no process uses them.
        is_inexact = status == CONVERGED and is_blurred(end.hessian)
        if is_inexact and all(part.travels_whole for part in self.nlp.parts):
            iterate = sharpened(self._parts, iterate)
        if status.startswith(CONVERGED) and self.limits.violation(iterate.z) > 0:
            status = "constraints violated"
        if status.startswith(CONVERGED) and not are_stable(self._parts, iterate):
            status = "unstable predictor"
        cost = self._parts.cost(iterate, 0.0)
        return Outcome(
            estimate=self.nlp.estimate_at(iterate.z),
            status=status,
            iterations=count,
            seconds=time.perf_counter() - began,
            converged=status.startswith(CONVERGED) and math.isfinite(cost),
            cost=cost,
            signature=self._parts.signature(iterate) if iterate.finite else None,
            nodes=tuple(self._parts.groups.nodes_by_part(iterate.nodes)),
        )

    @DIVERGING
    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum polished by undamped steps.

        In NIST's 27 regressions, nine or more digits are then correct instead of four to eight.
        """
        if search.nodes is None:
            return search
        best = search.minima[0]
        try:
            end = polished(self._parts, self._at(best.estimate, search.nodes))
        except np.linalg.LinAlgError:
            return search

        cost = self._parts.cost(end, 0.0)
        # If the cost differs, the steps have left the minimum, as they may where a predictor is at
        # its stability limit.
        lowest = best.cost - same_cost(self.nlp, best.cost)
        if not lowest <= cost <= with_rounding(best.cost):
            return search
        minimum = replace(best, cost=min(cost, best.cost), estimate=self.nlp.estimate_at(end.z))
        nodes = tuple(self._parts.groups.nodes_by_part(end.nodes))
        self._polished = minimum.estimate, nodes, end
        return replace(search, minima=(minimum, *search.minima[1:]), nodes=nodes)

    # --- starts

    @DIVERGING
    def is_finite_at(self, start: Array) -> bool:
        """Return whether the model is finite at the parameters `start` (p,) and states of the data.

        Of a long record, the excerpts decide.
        """
        return (self._excerpts or self)._parts.at(self._nearest(start)).finite

    @DIVERGING
    def screened(self, starts: Array) -> Screened | None:
        """Rank the starts (r, p) by prediction errors over short segments, see `screening`.

        If several starts lead to one point, only the best of them is promising; the others are
        tried last. The first start, the declared values, is always among the promising ones.
        """
        # Without screening, ten of 17 fits from the default starts take 1.5 to 8 times as long, and
        # four of NIST's regressions more than 40 s. Only MGH17 is faster, by half.
        if not can_screen(self.nlp):
            return None
        z = np.array([self._nearest(start) for start in starts[1:]])
        searches = improved((self._excerpts or self).nlp, self.limits, z)
        # The first start is not among those that are compared.
        promising = [number + 1 for number in distinct(searches)]
        others = sorted(set(range(1, len(starts))) - set(promising))

        # The declared values, number 0, are the last of the first wave of runs.
        ahead = self.promising.runs[0] - 1
        order = np.array([*promising[:ahead], 0, *promising[ahead:], *others])
        return Screened(order, np.full(len(starts), np.inf))

    # --- at given parameters

    @DIVERGING
    def profile(self, x: Array, nodes: Nodes | None = None) -> Profile:
        """Return the trajectories and the cost at the parameters x (p,).

        Unless they are given, the nodes are those that minimize the cost there.
        """
        if nodes is not None:
            return self._profile(self._at(x, nodes), converged=True)
        first = self._begun(self._parts.at(self.nlp.scaling.to_solver(x)))
        return self._best_states(*first)

    @DIVERGING
    def profile_near(self, x: Array, nodes: Nodes) -> Profile:
        """Return the profile at the parameters x (p,), with nodes that are solved from these."""
        return self._best_states(self._at(x, nodes), EXACT)

    def _best_states(self, iterate: Iterate, progress: Progress) -> Profile:
        """Return the profile at the parameters of an iterate, from which its nodes are solved."""
        most = self.settings.max_iter
        end = descend(self._parts, iterate, progress, most, states_only=True)
        return self._profile(end.iterate, converged=end.status.startswith(CONVERGED))

    def _profile(self, iterate: Iterate, *, converged: bool) -> Profile:
        """Return the trajectories and the cost of an iterate."""
        # The cost of an unstable predictor depends on where its segments begin.
        converged = converged and are_stable(self._parts, iterate)
        cost = self._parts.cost(iterate, 0.0)
        trajectories = tuple(self._parts.groups.split(iterate.trajectories))
        return Profile(trajectories, cost, converged)

    @DIVERGING
    def is_minimum(self, x: Array, profile: Profile) -> bool:
        """Return whether x (p,) with the nodes of its profile is a minimum within the limits."""
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

        None if the model diverges. Another solver begins with them.
        """
        # Three iterations of the nodes are enough for that.
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
        # Parts keep their linearization along the trajectory object of the polished minimum, from
        # which the standard errors follow. An equal new iterate would compute it again.
        if self._polished:
            polished_x, polished_nodes, polished_iterate = self._polished
            if x is polished_x and nodes is polished_nodes:
                return polished_iterate
        return self._parts.at(self.nlp.scaling.to_solver(x), self._parts.groups.joined(nodes))
