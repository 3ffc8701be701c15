"""The solver of frequency responses: Newton's method improves many starts, IPOPT confirms minima.

Starts that are improved together end at a minimum of the same smoothed cost as those of IPOPT.
IPOPT then begins at one run of every distinct minimum again: a minimum counts only where IPOPT
finds nothing lower. IPOPT alone makes all runs of problems for which `fits_a_batch` is false,
except for the large ones that `shared_solver` serves.
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
AT_BOUND = 1e-8  # distance from a bound, by which IPOPT widens it
EXCEEDED = "Maximum_Iterations_Exceeded"  # IPOPT's status at its limit

# Iterations of a batch. Runs on the fits of the paper take 20 to 60, on polynomials of high order
# up to 200. IPOPT continues those that need more.
ITERATIONS = 300

# Smoothings of the last digits. At a residual of zero the cost is too large by about 0.4 of the
# root of the last one.
AT_A_KINK = {"acceptable_tol": 1e-4, "acceptable_iter": 3}  # IPOPT reaches looser tolerances only
FINER = (1e-10, 1e-12, 1e-14, 1e-16)
FEW = 10  # iterations that suffice for the last digits where no residual is zero
NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})
TOLERANCE = 1e-8  # on the projected gradient in the solver's variables, as in IPOPT
POLISHED_TO = 1e-13  # the same for the last digits of a minimum


class ResponseSolver(Descent):
    """Newton's method on batches of starts, and IPOPT: without a batch, and to confirm the minima.

    Where another criterion locates the minimum, IPOPT solves with that one first.
    """

    starts = 200  # a run takes some milliseconds
    promising = Promising((8,), agree=4)
    fewest = 2  # IPOPT makes fewer runs

    def __init__(
        self,
        nlp: CompiledProblem,
        options: Mapping[str, Any] = NO_OPTIONS,
        *,
        batched: bool = True,
    ) -> None:
        """Build IPOPT; without `batched`, it makes all runs and compares no starts."""
        self.nlp = nlp
        self._options = options
        self._batched = batched
        if options:  # those that IPOPT does not take are refused here
            _ = [stage.solver for stage in self._stages]
        lower, upper = nlp.bounds
        self._bounds = {"lbx": lower, "ubx": upper, "lbg": 0.0, "ubg": np.inf}
        self.limits = {
            "max_iterations": int(options.get("max_iter", ITERATIONS)),
            "tolerance": float(options.get("tol", TOLERANCE)),
        }
        explicit = nlp.programs[-1].explicit
        if batched and explicit and ResponseSolver.serves(nlp):
            # The starts that are improved at once are a power of two, as the columns of a batch. Up
            # to 1024: more do not become cheaper. Fewer where a batch would take more than some
            # 0.5 s (10 million instructions), so that a time limit costs no more and progress is
            # seen. At least 128: below, a start takes more than twice its time.
            count = min(max(10_000_000 // instructions(explicit), 128), 1024)
            self.together = 1 << (count.bit_length() - 1)

    @cached_property
    def _stages(self) -> list[Ipopt]:
        return [Ipopt.of(program, self._options) for program in self.nlp.programs]

    @staticmethod
    def serves(nlp: CompiledProblem) -> bool:
        """Return whether starts of a problem can be improved together."""
        return not nlp.has_states and fits_a_batch(nlp.programs[-1].explicit)

    # --- runs

    def led(self, starts: Array) -> Outcomes:
        """Bring all starts (r, p) to minima together; IPOPT continues those that do not arrive."""
        # With few starts, IPOPT's own options apply exactly.
        if len(starts) < (6 if self._options else self.fewest) or self.together == 1:
            return self._with_costs([self._solved(start, SMOOTHING) for start in starts])
        return self._arrived(starts, self.improved)

    def descended(self, starts: Array) -> Outcomes:
        """Return where the problem's own criterion leads from the starts (r, p)."""
        if self.together > 1:
            return self._arrived(starts, self.settled)
        ends = [self._solved(start, SMOOTHING, WARM) for start in starts]
        # IPOPT may climb, and is then at another minimum.
        climbed = [
            is_above(self._smoothed_cost(end.estimate), self._smoothed_cost(start))
            for start, end in zip(starts, ends, strict=True)
        ]
        pairs = zip(ends, climbed, strict=True)
        return self._with_costs([replace(e, converged=e.converged and not up) for e, up in pairs])

    def _smoothed_cost(self, x: Array) -> float:
        z = self.nlp.scaling.to_solver(x)
        return float(self.nlp.programs[-1].function(z, SMOOTHING, self.nlp.data)[0])

    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the costs (r,) at the starts (r, p); infinite where a constraint is missed."""
        limits = self.nlp.constraint(self.nlp.all_values(starts).T).full()
        return np.where(limits.min(axis=0, initial=0) >= 0, self.nlp.costs(starts), np.inf)

    def _with_costs(self, outcomes: Outcomes) -> Outcomes:
        costs = self.nlp.costs(np.array([outcome.estimate for outcome in outcomes]))
        pairs = zip(outcomes, costs.tolist(), strict=True)
        return [replace(outcome, cost=cost) for outcome, cost in pairs]

    def _arrived(self, starts: Array, search: Callable[[Array], Ends]) -> Outcomes:
        """Return the runs of a search from starts (r, p); IPOPT continues those that stop early."""
        began = time.perf_counter()
        ends = search(self.nlp.scaling.to_solver(starts).T)
        seconds = (time.perf_counter() - began) / len(starts)
        outcomes = []
        estimates = self.nlp.estimate_at(ends.z.T)
        for x, count, at_minimum in zip(
            estimates, ends.iterations.tolist(), ends.at_minimum, strict=True
        ):
            is_end = at_minimum and self.meets_constraints(x)
            status = AT_MINIMUM if is_end else reason_to_end()
            outcome = Outcome(x, status, count, seconds, is_end, stage=IMPROVED)
            outcomes.append(outcome if status else self.again(x, outcome))
        return self._with_costs(outcomes)

    def _solved(
        self, start: Array, smoothing: float, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Return the end of IPOPT's run from the parameters `start` (p,)."""
        began = time.perf_counter()
        nlp = self.nlp
        p = np.append(smoothing, nlp.data)
        z = nlp.scaling.to_solver(start)
        iterations, status = 0, ""
        # A run with options of its own begins near a minimum: no other criterion need locate it.
        changed = {**options, **self._options} if options else {}
        stages = [self._stages[-1].variant(changed)] if options else self._stages
        for stage in stages:
            if status not in CUT_SHORT:
                z, status, count = self._limited(stage, iterations).solve(z, p, self._bounds)
                iterations += count

        # IPOPT scales the cost by its gradient at the start. At a steep one, its tolerance is loose
        # and leaves parameters some standard errors from the minimum: a second run begins there.
        own = stages[-1]
        converged = status not in CUT_SHORT and self._is_minimum(own, z, p)
        if not (converged or status in (*CUT_SHORT, EXCEEDED)):
            # Beyond a bound, which IPOPT widens by 1e-8, the others settle in the wrong place.
            within = {**CONFIRMING, "bound_relax_factor": 0.0}
            near = self._limited(own.variant({**within, **self._options}), iterations)
            end, again, count = near.solve(z, p, self._bounds)
            iterations += count
            if self._is_minimum(near, end, p):
                z, status, converged = end, again, True
        seconds = time.perf_counter() - began
        return Outcome(nlp.estimate_at(z), status, iterations, seconds, converged)

    def _limited(self, stage: Ipopt, iterations: int) -> Ipopt:
        """Return IPOPT with what `iterations` leave of a stated limit for the whole run."""
        if "max_iter" not in self._options or not iterations:
            return stage
        return stage.variant({"max_iter": max(self.limits["max_iterations"] - iterations, 0)})

    def _is_minimum(self, stage: Ipopt, z: Array, p: Array) -> bool:
        """Return whether z (p,) is a minimum of IPOPT's program with the parameters p."""
        # IPOPT respects bounds to a tolerance only.
        z = self.nlp.scaling.to_solver(self.nlp.estimate_at(z))
        # Its barrier holds variables off the bounds that hold them: where the cost is steep, the
        # rest of the way is worth more than the tolerance.
        low, high = self._limits.low, self._limits.high
        at_bounds = np.where(z - low < AT_BOUND, low, np.where(high - z < AT_BOUND, high, z))
        tolerance = self.limits["tolerance"]
        return any(
            is_minimum(self._limits, point, *stage.derivatives(point, p), tolerance)
            for point in (z, at_bounds)
        )

    @cached_property
    def _limits(self) -> Limits:
        return limits_of(self.nlp)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the point x (p,): there are no hidden unknowns."""
        z = self.nlp.scaling.to_solver(x)
        trajectories = tuple(part.trajectory(z) for part in self.nlp.parts)
        return Profile(trajectories, self.nlp.costs(x[None]).item(), converged=True)

    def judged(self, outcomes: Outcomes) -> Outcomes:
        """Return outcomes with costs, without smoothing, and signatures; blocks are exchanged."""
        ends = np.array([outcome.estimate for outcome in outcomes])
        arrived = [k for k, outcome in enumerate(outcomes) if outcome.converged]
        is_alone = self.together == 1 or self.nlp.programs[-1].roots is not None
        if len(arrived) > 1 and not is_alone:
            exchanged = self._exchanged(ends[arrived])
            costs = self.nlp.costs(np.vstack([exchanged, ends[arrived]])).reshape(2, -1)
            # A run keeps an end of its own that is lower.
            ends[arrived] = np.where((costs[0] < costs[1])[:, None], exchanged, ends[arrived])
        return [
            replace(outcome, estimate=x, cost=float(cost), signature=signature)
            for outcome, x, cost, signature in zip(outcomes, ends, *self._judged(ends), strict=True)
        ]

    def _judged(self, estimates: Array) -> tuple[Array, Array]:
        """Return costs (r,) and signatures (r, m) at ends (r, p)."""
        firsts = range(0, max(len(estimates), 1), AT_ONCE)
        batches = (self.nlp.judged(estimates[k : k + AT_ONCE]) for k in firsts)
        # In single precision: they are stored for every run, and compared to a percent.
        pairs = ((costs, signatures.astype(np.float32)) for costs, signatures in batches)
        costs, signatures = zip(*pairs, strict=True)
        return np.concatenate(costs), np.concatenate(signatures)

    def _exchanged(self, ends: Array) -> Array:
        """Return the ends (r, p) of runs, with independent blocks exchanged between them.

        Parameters that share no data, such as those of the longitudinal and the lateral motion, are
        two blocks: the cost is a sum of two, and a run seldom reaches the minima of both. The best
        ends of each block become those of the same runs. So as many runs reach the best minimum as
        reach that of the block which fewest of them solve.
        """
        from scipy.sparse.csgraph import connected_components  # noqa: PLC0415  (imports slowly)

        # At a few points: at zero, a parameter may seem to couple nothing.
        z = self.nlp.scaling.to_solver(ends[-8:]).T
        ones = np.ones_like(z[:1])
        data = self.nlp.data[:, None]
        hessian = self.nlp.programs[-1].second_order(z, SMOOTHING * ones, data * ones)[2]
        slopes = ca.DM(self.nlp.constraint.jac_sparsity(0, 0), 1).full()[:, : len(z)]
        hessian = np.any(hessian, axis=1).reshape(len(z), -1)
        blocks, of = connected_components(hessian + slopes.T @ slopes)
        if blocks == 1:
            return ends
        mixed = np.where((of == np.arange(blocks)[:, None])[:, None], ends, ends[0])
        costs = self._judged(mixed.reshape(-1, len(of)))[0].reshape(blocks, -1)
        lowest = costs.min(axis=1)
        # All blocks at their best.
        best = np.sum(lowest) - (blocks - 1) * costs[0, 0]
        limits = lowest + RIVAL * likelihood_unit(self.nlp, best)
        # Ends that the data do not exclude keep their order: sorted, a rival of the best would
        # always meet the worst ends of other blocks, and nobody would see it.
        order = np.argsort(np.maximum(costs, limits[:, None]), axis=1, kind="stable")
        return np.take_along_axis(ends, order[of][:, np.argsort(order[0])].T, axis=0)

    # --- many starts

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) by smoothed costs, with a penalty on missed constraints."""
        if not self._batched:
            return None
        z = self.nlp.scaling.to_solver(starts).T
        first = self.nlp.programs[0].function
        costs, limits = [matrix.full() for matrix in first(z, SMOOTHING, self.nlp.data)]
        # A constraint missed by a thousandth weighs as much as a cost of one.
        values = costs.ravel() + 1e3 * np.maximum(-limits, 0).sum(axis=0)
        values = np.where(np.isfinite(values), values, np.inf)
        return Screened(np.argsort(values, kind="stable"), values)

    def improved(self, z: Array, **limits: Any) -> Ends:
        """Return the ends of searches from the columns of z (p, m), within the limits."""
        limits = {**self.limits, **limits}
        first, *others = self.batches
        ends = self._away_from_zero(z, first.minimize(z, **limits))
        limits["from_near"] = True
        for batch in others:
            ends = continued(ends, batch.minimize(ends.z, **limits))
        return ends

    def settled(self, z: Array, **limits: Any) -> Ends:
        """Return where the problem's own criterion leads, without a barrier, from z (p, m)."""
        return self.batches[-1].minimize(z, **{**self.limits, "from_near": True, **limits})

    def _away_from_zero(self, z: Array, ends: Ends) -> Ends:
        """Repeat the searches from z (p, m) that ended at a response of zero."""
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
        return BatchedNewton.of(self.nlp, walled(self.nlp))

    @cached_property
    def batches(self) -> list[BatchedNewton]:
        """Build the criterion that locates the minimum, if any, then the problem's own."""
        return [BatchedNewton.of(self.nlp, program) for program in self.nlp.programs]

    def meets_constraints(self, x: Array) -> bool:
        """Return whether a search that knows none of the constraints ended where all hold."""
        nlp = self.nlp
        if not nlp.limits:
            return True
        return bool(nlp.constraint(nlp.all_values(x)).full().min() >= 0)

    def again(
        self, x: Array, earlier: Outcome | Run, options: Mapping[str, Any] = NO_OPTIONS
    ) -> Outcome:
        """Run IPOPT from x (p,), and add the iterations and seconds of the earlier run."""
        return spent(self._solved(x, SMOOTHING, options), earlier)

    # --- the certificate

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return a run of IPOPT's for every minimum that has none.

        An end that IPOPT does not confirm is not a minimum, for example a gain of zero, where no
        other parameter has an effect. IPOPT makes these runs again from their starts.
        """
        certified: dict[int, Outcome] = {}
        for minimum in minima:
            if np.any(runs.stage[np.array(minimum.runs)] != IMPROVED):
                continue
            # One of the three best runs of a minimum must be confirmed.
            if any(self._confirm(runs[k], certified) for k in minimum.runs[:3]):
                continue
            for k in minimum.runs:
                if k not in certified and not stop_requested():
                    certified[k] = self._again_from_start(runs[k])
        return certified

    def _confirm(self, run: Run, certified: dict[int, Outcome]) -> bool:
        """Return whether IPOPT finds nothing lower from where a run ended; its end is certified."""
        if stop_requested():
            return True
        # A search from two equal lags has no slope toward unequal ones: it ends at a saddle, unless
        # rounding differs. From beside it, at different parts of the start box, IPOPT leaves it.
        z = self.nlp.scaling.to_solver(run.estimate)
        beside = self.nlp.estimate_at(z + 1e-5 * np.cos(np.arange(z.size)))
        # From inside its bounds IPOPT would leave a valley that is narrow in a wide box.
        own = Outcome(run.estimate, run.status, run.iterations, run.seconds, converged=True)
        tried = [own, *(self.again(x, run, CONFIRMING) for x in (run.estimate, beside))]
        # IPOPT may climb, where rounding or a narrow valley stops its steps.
        ends = [end for outcome in tried for end in self.judged([outcome]) if end.converged]
        lowest = min(ends, key=lambda end: end.cost)
        certified[run.index] = replace(lowest, stage=POLISHED)
        return bool(lowest.cost >= run.cost - same_cost(self.nlp, run.cost))

    def _again_from_start(self, run: Run) -> Outcome:
        """Return IPOPT's run from the start of a run that ended at no minimum, unless it climbs."""
        [end] = self.judged([self.again(run.start, run)])
        if is_above(end.cost, run.cost):
            end = replace(end, estimate=run.estimate, cost=run.cost, converged=False)
        return end

    # --- the last digits

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with the minima close to the best solved with less smoothing.

        After Ctrl-C only the best one is.
        """
        minima = search.minima
        if not minima:
            return search
        # Smoothing moves costs by 6e-5 and may change the order of close minima.
        close = [m for m in minima if m.cost <= 1.01 * minima[0].cost]
        close = minima[:1] if stop_requested() else close
        with responding(Response.FINISH):
            if not self.nlp.limits:
                first = search.runs.start[0]
                close = [replace(m, estimate=self._in_order(m.estimate, first)) for m in close]
            polished = [*map(self._polish, close), *minima[len(close) :]]
        return replace(search, minima=tuple(sorted(polished, key=lambda m: m.cost)))

    def _in_order(self, x: Array, first: Array) -> Array:
        """Return x (p,) with exchangeable parameters ordered as in the first start, or ascending.

        Exchanged, they have the same responses, so that rounding would choose which of two lags
        gets which value.
        """
        nlp = self.nlp
        order = np.argsort(first, kind="stable").tolist()
        response = nlp.judged(x[None])[1]
        for i, j in combinations(order, 2):
            y = x.copy()
            y[[i, j]] = x[[j, i]]
            if x[i] > x[j] and np.all(y == np.clip(y, nlp.lower, nlp.upper)):
                change = np.abs(nlp.judged(y[None])[1] - response)
                # Relative change of a response: rounding leaves 1e-13, and less for parameters that
                # no data show.
                x = y if change.max() < 1e-9 else x
        return x

    def _polish(self, best: Minimum) -> Minimum:
        """Return a minimum solved again with less smoothing, as long as the cost does not grow."""
        is_served = self.serves(self.nlp)
        if is_served:
            # At once where a few steps then arrive. At the kink of a zero residual a search stalls:
            # there the smoothing falls in steps.
            estimate, iterations = self._refined(best, FINER[-1], FEW)
            if iterations < FEW:
                return self._unless_dearer(best, estimate)

        for smoothing in FINER:
            if is_served:
                estimate, _ = self._refined(best, smoothing, 100)
            else:
                estimate = self._solved(best.estimate, smoothing, AT_A_KINK).estimate
            previous = best
            best = self._unless_dearer(best, estimate)
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
        # A constraint that holds with equality keeps its minimum where IPOPT found it.
        if not self.meets_constraints(estimate):
            estimate = best.estimate
        return estimate, int(ends.iterations[0])

    def _unless_dearer(self, best: Minimum, estimate: Array) -> Minimum:
        """Return the minimum with this estimate; unchanged if its cost is higher."""
        cost = self.nlp.costs(estimate[None]).item()
        # Rounding of the cost must not decide whether digits are refined.
        if not cost <= best.cost + 1e-13 * abs(best.cost):
            return best
        return replace(best, cost=cost, estimate=estimate)


def walled(nlp: CompiledProblem) -> CostProgram:
    """Return the first, explicit program of a problem with a wall around zero responses.

    Most criteria have a finite cost there: over the measured magnitude, (4.26) is the number of
    points. If the phase of the model is wrong, a smaller gain lowers the cost. At a gain of zero no
    other parameter changes it, so a search that arrives there cannot leave: for (2.7) on the pitch
    rate, in a box of up to 1e6 for the gain, all of 200 searches end there. With the wall they find
    the phase first, and 199 of them end at the minimum.

    The wall is a logarithmic barrier of the mean square of the relative response; it vanishes at
    the smoothing of the last level.
    """
    program: Any = nlp.programs[0].explicit
    z, smoothing, data = program.sx_in()
    cost, limits = program(z, smoothing, data)
    # Height of the wall at the first level of a search, as a share of the cost of a zero response.
    # The square root of the smoothing takes it down by ten from level to level. In the box above,
    # 99.9 % of 1024 searches for (2.7) end at the minimum with 0.5, 93 % with 1 and 71 % with 0.2;
    # in its declared box 86 % do if it falls with the root, and half of them if it falls with the
    # smoothing.
    share = 0.5 * ca.sqrt(ca.fmax(smoothing - SMOOTHING, 0))
    for part, height in zip(nlp.parts_of(ResponsePart), nlp.zero_costs, strict=True):
        relative = part.scaled_response(z) / np.tile(part.magnitude, 2)
        square = ca.sumsqr(relative) / len(part.magnitude)
        # At the last level a response may vanish, and its logarithm must still be finite.
        cost -= share * float(height) * ca.log(square + 1e-30)

    function = ca.Function("walled", [z, smoothing, data], [cost, limits])
    return CostProgram(function, explicit=function)
