"""The solver of frequency responses: Newton's method improves many starts, IPOPT confirms minima.

Newton's method and IPOPT minimize the same smoothed cost. Afterwards IPOPT starts again from one
run of every distinct minimum: a minimum counts only if IPOPT finds nothing lower from there. If
`fits_a_batch` is false for a problem, IPOPT makes all runs, except for the large problems of
`shared_solver`.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.response_part import SMOOTHING, ResponsePart
from greybox.engine.compiled.response_programs import CostProgram, fits_a_batch, instructions
from greybox.engine.solve.batched_newton import BatchedNewton, Ends, continued
from greybox.engine.solve.constraints import Limits, limits_of
from greybox.engine.solve.interruption import Response, reason_to_end, responding, stop_requested
from greybox.engine.solve.ipopt import CONFIRMING, WARM, Ipopt
from greybox.engine.solve.local_solver import Descent, Profile, Screened
from greybox.engine.solve.minima import (
    AT_ONCE,
    RIVAL,
    Minimum,
    Multistart,
    explains_nothing,
    likelihood_unit,
    same_cost,
)
from greybox.engine.solve.promising import Promising
from greybox.engine.solve.runs import (
    CUT_SHORT,
    IMPROVED,
    POLISHED,
    Outcome,
    Outcomes,
    Run,
    Runs,
    spent,
)
from greybox.engine.solve.stationarity import is_above, is_minimum
from greybox.modeling.cached_property import cached_property

AT_MINIMUM = "At_Minimum"  # status of a run whose projected gradient vanishes
AT_BOUND = 1e-8  # distance from a bound that counts as on it: IPOPT widens bounds by as much
EXCEEDED = "Maximum_Iterations_Exceeded"  # IPOPT's status at its limit

# Most iterations of a batch. Runs on the fits of the paper take 20 to 60, on polynomials of high
# order up to 200. IPOPT continues runs that need more.
ITERATIONS = 300

# Smoothings that are tried one after the other for the last digits. With the last of them, the cost
# at a residual of zero is too large by about 0.4 times its square root.
FINER = (1e-10, 1e-12, 1e-14, 1e-16)
# Options of IPOPT near such a kink, where it cannot meet its usual tolerance.
AT_A_KINK = {"acceptable_tol": 1e-4, "acceptable_iter": 3}
FEW = 10  # iterations that suffice for the last digits if no residual is zero
# Sizes of a batch, see `_batch_size`.
SMALLEST_BATCH = 128
LARGEST_BATCH = 1024
INSTRUCTIONS = 10_000_000  # of an iteration of a batch, which takes some 0.5 s
# With options of the user, fewer starts than this are left to IPOPT, which applies them exactly.
FEWEST_WITH_OPTIONS = 6
NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})
TOLERANCE = 1e-8  # on the projected gradient in the solver's variables, as in IPOPT
POLISHED_TO = 1e-13  # the same for the last digits of a minimum


class ResponseSolver(Descent):
    """Newton's method improves batches of starts, and IPOPT confirms the minima.

    Where batches are impossible, IPOPT makes all runs. If the problem's criterion has a `locator`,
    an easier criterion with a nearby minimum, every run minimizes that one first.
    """

    starts = 200  # a run takes some milliseconds
    promising = Promising((8,), agree=4)
    fewest = 2  # starts of a batch; IPOPT makes the run of a single one

    def __init__(
        self,
        nlp: CompiledProblem,
        options: Mapping[str, Any] = NO_OPTIONS,
        *,
        batched: bool = True,
    ) -> None:
        """Store the problem and the options of IPOPT.

        Without `batched`, IPOPT makes all runs, in the order of the starts.
        """
        self.nlp = nlp
        self._options = options
        self._batched = batched
        if options:
            # IPOPT refuses unknown options when it is built. The user should hear of it now.
            for stage in self._stages:
                _ = stage.solver
        lower, upper = nlp.bounds
        self._bounds = {"lbx": lower, "ubx": upper, "lbg": 0.0, "ubg": np.inf}
        self.limits = {
            "max_iterations": int(options.get("max_iter", ITERATIONS)),
            "tolerance": float(options.get("tol", TOLERANCE)),
        }
        explicit = nlp.programs[-1].explicit
        if batched and explicit and ResponseSolver.serves(nlp):
            self.together = _batch_size(explicit)

    @cached_property
    def _stages(self) -> list[Ipopt]:
        """Build IPOPT for every program: the locator's, if there is one, then the problem's own."""
        return [Ipopt.of(program, self._options) for program in self.nlp.programs]

    @staticmethod
    def serves(nlp: CompiledProblem) -> bool:
        """Return whether starts of a problem can be improved in batches."""
        return not nlp.has_states and fits_a_batch(nlp.programs[-1].explicit)

    # --- runs

    def led(self, starts: Array) -> Outcomes:
        """Return the runs from the starts (r, p), made in one batch if possible.

        IPOPT continues those that do not reach a minimum.
        """
        fewest = FEWEST_WITH_OPTIONS if self._options else self.fewest
        if len(starts) < fewest or self.together == 1:
            return self._with_costs([self._solved(start, SMOOTHING) for start in starts])
        return self._arrived(starts, self.improved)

    def descended(self, starts: Array) -> Outcomes:
        """Return the runs of the problem's own criterion from the starts (r, p)."""
        if self.together > 1:
            return self._arrived(starts, self.settled)
        outcomes = []
        for start in starts:
            outcome = self._solved(start, SMOOTHING, WARM)
            # IPOPT may climb, and is then at the minimum of another valley.
            cost, cost_of_start = map(self._smoothed_cost, (outcome.estimate, start))
            if is_above(cost, cost_of_start):
                outcome = replace(outcome, converged=False)
            outcomes.append(outcome)
        return self._with_costs(outcomes)

    def _smoothed_cost(self, x: Array) -> float:
        """Return the cost that the solvers minimize, at the parameters x (p,)."""
        z = self.nlp.scaling.to_solver(x)
        return float(self.nlp.programs[-1].function(z, SMOOTHING, self.nlp.data)[0])

    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the costs (r,) at the starts (r, p); infinite where a constraint is violated."""
        limits = self.nlp.constraint(self.nlp.all_values(starts).T).full()
        is_feasible = limits.min(axis=0, initial=0) >= 0
        return np.where(is_feasible, self.nlp.costs(starts), np.inf)

    def _with_costs(self, outcomes: Outcomes) -> Outcomes:
        """Return the outcomes with their costs without smoothing."""
        costs = self.nlp.costs(np.array([outcome.estimate for outcome in outcomes]))
        pairs = zip(outcomes, costs.tolist(), strict=True)
        return [replace(outcome, cost=cost) for outcome, cost in pairs]

    def _arrived(self, starts: Array, search: Callable[[Array], Ends]) -> Outcomes:
        """Return the runs of a batched search from the starts (r, p).

        `search` leads z (p, r) to its ends. IPOPT continues runs that stop early.
        """
        began = time.perf_counter()
        ends = search(self.nlp.scaling.to_solver(starts).T)
        seconds = (time.perf_counter() - began) / len(starts)
        outcomes = []
        estimates = self.nlp.estimate_at(ends.z.T)
        for x, count, at_minimum in zip(
            estimates, ends.iterations.tolist(), ends.at_minimum, strict=True
        ):
            is_end = at_minimum and self.meets_constraints(x)
            # Empty, unless time is up or the user has stopped the search.
            status = AT_MINIMUM if is_end else reason_to_end()
            outcome = Outcome(x, status, count, seconds, is_end, stage=IMPROVED)
            if not status:
                outcome = self.again(x, outcome)
            outcomes.append(outcome)
        return self._with_costs(outcomes)

    def _solved(
        self, start: Array, smoothing: float, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Return the end of IPOPT's run from the parameters `start` (p,).

        `options` of IPOPT are those of a run that begins near a minimum.
        """
        began = time.perf_counter()
        nlp = self.nlp
        p = np.append(smoothing, nlp.data)
        z = nlp.scaling.to_solver(start)
        iterations = 0
        status = ""
        stages = self._stages
        if options:
            # The run begins near a minimum, so that no other criterion need locate it.
            stages = [self._stages[-1].variant({**options, **self._options})]
        for stage in stages:
            if status not in CUT_SHORT:
                z, status, count = self._limited(stage, iterations).solve(z, p, self._bounds)
                iterations += count

        # IPOPT scales the cost by its gradient at the start. If the start is steep, this makes its
        # tolerance so loose that parameters end some standard errors from the minimum. A second run
        # from there has a tighter one.
        own = stages[-1]
        converged = status not in CUT_SHORT and self._is_minimum(own, z, p)
        if not (converged or status in (*CUT_SHORT, EXCEEDED)):
            # IPOPT widens bounds by 1e-8. If a parameter ends beyond its bound, the others settle
            # in the wrong place.
            within_bounds = {**CONFIRMING, "bound_relax_factor": 0.0}
            second = self._limited(own.variant({**within_bounds, **self._options}), iterations)
            second_end, second_status, count = second.solve(z, p, self._bounds)
            iterations += count
            if self._is_minimum(second, second_end, p):
                z, status, converged = second_end, second_status, True
        seconds = time.perf_counter() - began
        return Outcome(nlp.estimate_at(z), status, iterations, seconds, converged)

    def _limited(self, stage: Ipopt, iterations: int) -> Ipopt:
        """Return IPOPT with the iterations that remain of the user's limit, after `iterations`."""
        if "max_iter" not in self._options or iterations == 0:
            return stage
        remaining = max(self.limits["max_iterations"] - iterations, 0)
        return stage.variant({"max_iter": remaining})

    def _is_minimum(self, stage: Ipopt, z: Array, p: Array) -> bool:
        """Return whether z (p,) is a minimum of IPOPT's program.

        `p` are the smoothing and the data, which are inputs of the program.
        """
        # IPOPT meets bounds to a tolerance only.
        z = self.nlp.scaling.to_solver(self.nlp.estimate_at(z))
        # Its barrier keeps variables at a small distance from active bounds. Where the cost is
        # steep, this distance alone exceeds the tolerance, so that the point on the bounds is tried
        # as well.
        low, high = self._limits.low, self._limits.high
        at_bounds = np.where(z - low < AT_BOUND, low, z)
        at_bounds = np.where(high - z < AT_BOUND, high, at_bounds)
        tolerance = self.limits["tolerance"]
        return any(
            is_minimum(self._limits, point, *stage.derivatives(point, p), tolerance)
            for point in (z, at_bounds)
        )

    @cached_property
    def _limits(self) -> Limits:
        """Return the bounds and constraints of the problem."""
        return limits_of(self.nlp)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the cost at x (p,). Frequency responses have no states to solve for."""
        z = self.nlp.scaling.to_solver(x)
        trajectories = tuple(part.trajectory(z) for part in self.nlp.parts)
        return Profile(trajectories, self.nlp.costs(x[None]).item(), converged=True)

    def judged(self, outcomes: Outcomes) -> Outcomes:
        """Return the outcomes with costs without smoothing, and with signatures.

        Independent blocks of parameters are exchanged between converged runs, see `_exchanged`.
        """
        ends = np.array([outcome.estimate for outcome in outcomes])
        converged = [k for k, outcome in enumerate(outcomes) if outcome.converged]
        has_batches = self.together > 1 and self.nlp.programs[-1].roots is None
        if len(converged) > 1 and has_batches:
            own = ends[converged]
            exchanged = self._exchanged(own)
            costs = self.nlp.costs(np.vstack([exchanged, own])).reshape(2, -1)
            # A run keeps its own end if that is lower.
            ends[converged] = np.where((costs[0] < costs[1])[:, None], exchanged, own)
        return [
            replace(outcome, estimate=x, cost=float(cost), signature=signature)
            for outcome, x, cost, signature in zip(outcomes, ends, *self._judged(ends), strict=True)
        ]

    def _judged(self, estimates: Array) -> tuple[Array, Array]:
        """Return costs (r,) and signatures (r, m) at ends (r, p)."""
        costs, signatures = [], []
        # In batches, which limits the memory.
        for first in range(0, max(len(estimates), 1), AT_ONCE):
            batch_costs, batch_signatures = self.nlp.judged(estimates[first : first + AT_ONCE])
            costs.append(batch_costs)
            # Single precision is enough: signatures are stored for every run, and compared to a
            # percent.
            signatures.append(batch_signatures.astype(np.float32))
        return np.concatenate(costs), np.concatenate(signatures)

    def _exchanged(self, ends: Array) -> Array:
        """Return the ends (r, p) of runs, with independent blocks exchanged between them.

        Parameters that share no data, such as those of the longitudinal and the lateral motion, are
        two blocks: the cost is a sum of two, and a run seldom reaches the minima of both. The ends
        of each block are therefore ranked by the cost of that block alone. The best ends of all
        blocks are combined in one run, the second best in another, and so on.
        """
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (imports slowly)

        # The Hessian shows which parameters share data. It is evaluated at several points, because
        # at a value of zero a parameter may seem to be independent of all others.
        z = self.nlp.scaling.to_solver(ends[-8:]).T
        ones = np.ones_like(z[:1])
        data = self.nlp.data[:, None]
        hessian = self.nlp.programs[-1].second_order(z, SMOOTHING * ones, data * ones)[2]
        slopes = ca.DM(self.nlp.constraint.jac_sparsity(0, 0), 1).full()[:, : len(z)]
        is_coupled = np.any(hessian, axis=1).reshape(len(z), -1)
        blocks, block_of = connected_components(is_coupled + slopes.T @ slopes)
        if blocks == 1:
            return ends
        # For each block, the costs (blocks, r) if this block alone is taken from every run, and all
        # other parameters from the first run.
        is_in_block = block_of == np.arange(blocks)[:, None]
        mixed = np.where(is_in_block[:, None], ends, ends[0])
        costs = self._judged(mixed.reshape(-1, len(block_of)))[0].reshape(blocks, -1)
        lowest = costs.min(axis=1)
        # The cost with all blocks at their best.
        best = np.sum(lowest) - (blocks - 1) * costs[0, 0]
        limits = lowest + RIVAL * likelihood_unit(self.nlp, best)
        # Ends that the data do not exclude count as equal and keep their order. If they were
        # sorted, a rival of the best end would always be combined with worse ends of other blocks,
        # and would never show as a rival.
        order = np.argsort(np.maximum(costs, limits[:, None]), axis=1, kind="stable")
        # The first block stays in its runs, and the others join it by rank.
        by_run = order[:, np.argsort(order[0])]
        return np.take_along_axis(ends, by_run[block_of].T, axis=0)

    # --- many starts

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) by smoothed costs, with a penalty on violated constraints."""
        if not self._batched:
            return None
        z = self.nlp.scaling.to_solver(starts).T
        first = self.nlp.programs[0].function
        costs, limits = [matrix.full() for matrix in first(z, SMOOTHING, self.nlp.data)]
        # A violation of a thousandth weighs as much as a cost of one.
        values = costs.ravel() + 1e3 * np.maximum(-limits, 0).sum(axis=0)
        values = np.where(np.isfinite(values), values, np.inf)
        return Screened(np.argsort(values, kind="stable"), values)

    def improved(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from z (p, m), by the locator and the problem's criterion.

        `limits` replace those of the solver: `max_iterations` and `tolerance`.
        """
        limits = {**self.limits, **limits}
        first, *others = self.batches
        ends = self._away_from_zero(z, first.minimize(z, **limits))
        limits["from_near"] = True
        for batch in others:
            ends = continued(ends, batch.minimize(ends.z, **limits))
        return ends

    def settled(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from z (p, m) by the problem's own criterion.

        The starts are near minima: no barrier keeps the searches from the bounds at first.
        """
        return self.batches[-1].minimize(z, **{**self.limits, "from_near": True, **limits})

    def _away_from_zero(self, z: Array, ends: Ends) -> Ends:
        """Repeat the searches from z (p, m) that ended at a response of zero, see `walled`."""
        program = self.nlp.programs[0]
        is_shared = program.shared is not None
        if is_shared or program.explicit is None or program.roots is not None:
            return ends
        zero = np.flatnonzero(explains_nothing(ends.cost, self.nlp.zero_costs.sum()))
        if not zero.size:
            return ends

        return continued(ends, self._walled.minimize(z[:, zero], **self.limits), zero)

    @cached_property
    def _walled(self) -> BatchedNewton:
        """Build the search with a wall around zero responses."""
        return BatchedNewton.of(self.nlp, walled(self.nlp))

    @cached_property
    def batches(self) -> list[BatchedNewton]:
        """Build the criterion that locates the minimum, if any, then the problem's own."""
        return [BatchedNewton.of(self.nlp, program) for program in self.nlp.programs]

    def meets_constraints(self, x: Array) -> bool:
        """Return whether x (p,) meets all constraints, which batched searches ignore."""
        nlp = self.nlp
        if not nlp.limits:
            return True
        return bool(nlp.constraint(nlp.all_values(x)).full().min() >= 0)

    def again(
        self, x: Array, earlier: Outcome | Run, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Return IPOPT's run from x (p,), with the earlier run's iterations and seconds added."""
        return spent(self._solved(x, SMOOTHING, options), earlier)

    # --- the certificate

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return the outcomes of IPOPT, by the number of their run, that confirm the minima.

        Ends that IPOPT does not confirm are no minima. An example is a gain of zero, where no other
        parameter has an effect. IPOPT makes these runs again from their starts.
        """
        certified: dict[int, Outcome] = {}
        for minimum in minima:
            is_by_ipopt = runs.stage[np.array(minimum.runs)] != IMPROVED
            if np.any(is_by_ipopt):
                continue
            # It is enough if one of the three best runs of a minimum is confirmed.
            if any(self._confirm(runs[k], certified) for k in minimum.runs[:3]):
                continue
            for k in minimum.runs:
                if k not in certified and not stop_requested():
                    certified[k] = self._again_from_start(runs[k])
        return certified

    def _confirm(self, run: Run, certified: dict[int, Outcome]) -> bool:
        """Return whether IPOPT finds nothing lower from the end of a run.

        The lowest end that it finds is added to `certified`.
        """
        if stop_requested():
            return True
        # A search from two equal lags has no slope toward unequal ones, and may end at a saddle.
        # IPOPT therefore starts beside the end as well, where no two parameters are moved alike.
        z = self.nlp.scaling.to_solver(run.estimate)
        beside = self.nlp.estimate_at(z + 1e-5 * np.cos(np.arange(z.size)))
        # The end itself is a candidate, too: IPOPT first moves away from the bounds, and may so
        # leave a valley that is narrow in a wide box. It may also climb where rounding stops it.
        own = Outcome(run.estimate, run.status, run.iterations, run.seconds, converged=True)
        candidates = [own]
        for x in (run.estimate, beside):
            candidates.append(self.again(x, run, CONFIRMING))
        ends = []
        for candidate in candidates:
            ends += [end for end in self.judged([candidate]) if end.converged]
        lowest = min(ends, key=lambda end: end.cost)
        certified[run.index] = replace(lowest, stage=POLISHED)
        return bool(lowest.cost >= run.cost - same_cost(self.nlp, run.cost))

    def _again_from_start(self, run: Run) -> Outcome:
        """Return IPOPT's run from the start of a run that ended at no minimum.

        If IPOPT ends higher, the end of that run remains, and has not converged.
        """
        [end] = self.judged([self.again(run.start, run)])
        if is_above(end.cost, run.cost):
            end = replace(end, estimate=run.estimate, cost=run.cost, converged=False)
        return end

    # --- the last digits

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minima solved again with less smoothing.

        These are the minima with costs close to the lowest; after Ctrl-C, only the lowest.
        """
        minima = search.minima
        if not minima:
            return search
        # Smoothing moves costs by 6e-5 and may change the order of close minima.
        close = [minimum for minimum in minima if minimum.cost <= 1.01 * minima[0].cost]
        if stop_requested():
            close = close[:1]
        others = minima[len(close) :]

        polished = []
        with responding(Response.FINISH):
            for minimum in close:
                x = minimum.estimate
                # Constraints may tell interchangeable parameters apart.
                if not self.nlp.limits:
                    x = self._in_order(x, search.runs.start[0])
                polished.append(self._polish(replace(minimum, estimate=x)))
        by_cost = sorted([*polished, *others], key=lambda minimum: minimum.cost)
        return replace(search, minima=tuple(by_cost))

    def _in_order(self, x: Array, first: Array) -> Array:
        """Return x (p,) with interchangeable parameters in the order of the first start (p,).

        If the first start has equal values, they are ascending. Two lags in series, for example,
        have the same response when their values are exchanged. Without an order, rounding would
        decide which of them gets which value.
        """
        nlp = self.nlp
        order = np.argsort(first, kind="stable").tolist()
        response = nlp.judged(x[None])[1]
        for i, j in combinations(order, 2):
            exchanged = x.copy()
            exchanged[[i, j]] = x[[j, i]]
            is_inside = np.all(exchanged == np.clip(exchanged, nlp.lower, nlp.upper))
            if x[i] > x[j] and is_inside:
                # The relative change of a response. Rounding is 1e-13.
                change = np.abs(nlp.judged(exchanged[None])[1] - response)
                if change.max() < 1e-9:
                    x = exchanged
        return x

    def _polish(self, best: Minimum) -> Minimum:
        """Return a minimum solved again with less smoothing, as long as the cost does not grow."""
        has_batches = self.serves(self.nlp)
        if has_batches:
            # Usually a few steps with the least smoothing are enough. At the kink of a zero
            # residual the search would stall: the smoothing is then reduced step by step.
            estimate, iterations = self._refined(best, FINER[-1], FEW)
            if iterations < FEW:
                return self._unless_higher(best, estimate)

        for smoothing in FINER:
            if has_batches:
                estimate, _ = self._refined(best, smoothing, 100)
            else:
                estimate = self._solved(best.estimate, smoothing, AT_A_KINK).estimate
            previous = best
            best = self._unless_higher(best, estimate)
            if best is previous:
                break
        return best

    def _refined(self, best: Minimum, smoothing: float, most: int) -> tuple[Array, int]:
        """Return the end (p,) of a batched search from a minimum, and its number of iterations."""
        ends = self.settled(
            self.nlp.scaling.to_solver(best.estimate)[:, None],
            max_iterations=most,
            tolerance=POLISHED_TO,
            smoothing=smoothing,
        )
        estimate = self.nlp.estimate_at(ends.z[:, 0])
        # The search ignores constraints. If it violates one, the minimum of IPOPT remains.
        if not self.meets_constraints(estimate):
            estimate = best.estimate
        return estimate, int(ends.iterations[0])

    def _unless_higher(self, best: Minimum, estimate: Array) -> Minimum:
        """Return the minimum with this estimate (p,), or unchanged if its cost would be higher."""
        cost = self.nlp.costs(estimate[None]).item()
        # Rounding of the cost must not decide whether digits are refined.
        if not cost <= best.cost + 1e-13 * abs(best.cost):
            return best
        return replace(best, cost=cost, estimate=estimate)


def _batch_size(program: ca.Function) -> int:
    """Return the number of starts that are improved at once, a power of two.

    A batch takes at most some 0.5 s an iteration, so that time limits hold and progress shows. With
    fewer than 128 starts, each would take more than twice its time; more than 1024 save nothing.
    """
    count = INSTRUCTIONS // instructions(program)
    count = min(max(count, SMALLEST_BATCH), LARGEST_BATCH)
    return 1 << (count.bit_length() - 1)


def walled(nlp: CompiledProblem) -> CostProgram:
    """Return the first program of a problem with a wall around zero responses.

    Most criteria have a finite cost at a response of zero: that of (4.26) is the number of points.
    While the phase of the model is wrong, a smaller gain lowers the cost. At a gain of zero no
    other parameter changes it, so that a search that arrives there cannot leave. For (2.7) on the
    pitch rate, with a gain of up to 1e6, all of 200 searches end there. With the wall they find the
    phase first, and 199 of them end at the minimum.

    The wall is a logarithmic barrier of the mean square of the relative response. It vanishes when
    the smoothing reaches its last level.
    """
    program: Any = nlp.programs[0].explicit
    z, smoothing, data = program.sx_in()
    cost, limits = program(z, smoothing, data)
    # The height of the wall as a share of the cost of a zero response. It falls with the square
    # root of the smoothing, by a factor of ten from level to level. Of 1024 searches for (2.7) in
    # the box above, 99.9 % end at the minimum with a factor of 0.5, 93 % with 1 and 71 % with 0.2.
    # In the declared box 86 % do, and only half of them if the height falls with the smoothing
    # itself.
    share = 0.5 * ca.sqrt(ca.fmax(smoothing - SMOOTHING, 0))
    for part, height in zip(nlp.parts_of(ResponsePart), nlp.zero_costs, strict=True):
        relative = part.scaled_response(z) / np.tile(part.magnitude, 2)
        square = ca.sumsqr(relative) / len(part.magnitude)
        # At the last level a response may vanish, and its logarithm must still be finite.
        cost -= share * float(height) * ca.log(square + 1e-30)

    function = ca.Function("walled", [z, smoothing, data], [cost, limits])
    return CostProgram(function, explicit=function)
