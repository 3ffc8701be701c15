"""IPOPT for what few starts need, and Newton's method from many starts at once for the rest.

Runs that are improved together end at a minimum of the same smoothed cost as those of IPOPT. Of
every distinct minimum IPOPT solves one run once more: a minimum counts only when IPOPT's conditions
of optimality (KKT) hold there too.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.augmented_lagrangian import ConstrainedNewton
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.interruption import reason_to_end, stop_requested
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.minima import Minimum, same_cost
from greybox.solve.outcome import IMPROVED, Outcome, Run
from greybox.solve.runs import Runs
from greybox.solve.screened_ipopt import ScreenedIpopt
from greybox.solve.time_limits import one_run

AT_MINIMUM = "At_Minimum"  # status of a run whose projected gradient vanishes

# Starts from which a batch takes less time than as many runs of IPOPT: the operations of one step
# on few points take 0.3 ms, ten times an iteration of IPOPT.
FEWEST = 6

# Starts in a batch, at most: operations on more do not become cheaper. Instructions times starts,
# of what takes some 0.5 s: a time limit costs no more than the batch at hand, and progress is seen.
# In batches of fewer than the last number a start takes more than twice its time.
MOST = 1024
MOST_AT_ONCE = 10_000_000
FEWEST_AT_ONCE = 128

# Iterations of a batch. Runs on the fits of the paper take 20 to 60, on polynomials of high order
# up to 200; IPOPT goes on with those that need more.
ITERATIONS = 300

# Of the projected gradient, in the solver's variables: that of IPOPT.
TOLERANCE = 1e-8

# Instructions of cost, gradient and Hessian from which the functions take most of IPOPT's time, and
# unknowns from which eigenvalues do: there is little to gain from a batch.
MOST_INSTRUCTIONS = 50_000
MOST_UNKNOWNS = 20

TRIES = 3  # runs of one minimum that IPOPT solves once more, until one is confirmed


class BatchedSolver(ScreenedIpopt):
    """Newton's method on all starts of a batch; IPOPT for what it leaves, and for the certificate."""

    def __init__(
        self,
        nlp: CompiledProblem,
        options: Mapping[str, Any] = MappingProxyType({}),
        like: "IpoptSolver | None" = None,
    ) -> None:
        """Build IPOPT; the functions of the batch are built when the first one is run."""
        super().__init__(nlp, options, like)
        self.together = _power_of_two(
            min(max(MOST_AT_ONCE // _instructions(nlp), FEWEST_AT_ONCE), MOST)
        )
        self._batches: list[BatchedNewton | ConstrainedNewton] = []

    @staticmethod
    def serves(nlp: CompiledProblem) -> bool:
        """Tell whether a problem has the form that a batch takes: small, without states, and explicit."""
        if any(part.has_states for part in nlp.parts) or not nlp.explicit:
            return False
        return len(nlp.free) <= MOST_UNKNOWNS and _instructions(nlp) <= MOST_INSTRUCTIONS

    def run_together(self, starts: Array) -> list[Outcome]:
        """Bring all starts (r, p) to a minimum together; those that do not get there are IPOPT's."""
        if len(starts) < FEWEST:
            return super().run_together(starts)
        began = time.perf_counter()
        z = self._nlp.scaling.to_solver(starts).T
        limits = {
            "max_iterations": int(self._options.get("max_iter", ITERATIONS)),
            "tolerance": float(self._options.get("tol", TOLERANCE)),
        }
        iterations, arrived = np.zeros(len(starts), int), np.zeros(len(starts), bool)
        for k, batch in enumerate(self._built()):
            ends = batch.minimize(z, **limits, from_near=k > 0)
            z, iterations, arrived = ends.z, iterations + ends.iterations, ends.at_minimum
        estimates = np.clip(self._nlp.scaling.to_parameters(z.T), self._nlp.lower, self._nlp.upper)
        each = (time.perf_counter() - began) / len(starts)
        return [
            Outcome(x, AT_MINIMUM, n, each, converged=True, stage=IMPROVED)
            if at_minimum
            else self._gone_on(x, n, each)
            for x, n, at_minimum in zip(estimates, iterations.tolist(), arrived, strict=True)
        ]

    def _built(self) -> "list[BatchedNewton | ConstrainedNewton]":
        """Return the criterion that locates the minimum, if any, then the problem's own."""
        if not self._batches:
            nlp, bounds = self._nlp, (self._bounds["lbx"], self._bounds["ubx"])
            self._batches = [
                ConstrainedNewton(program, *bounds, nlp.origin, nlp.roots)
                if nlp.limits
                else BatchedNewton(program, *bounds, nlp.roots)
                for program in nlp.explicit
            ]
        return self._batches

    def _gone_on(self, x: Array, iterations: int, seconds: float) -> Outcome:
        """Return where IPOPT comes from the end of a run that did not arrive."""
        if cut := reason_to_end():
            return Outcome(x, cut, iterations, seconds, converged=False)
        return self._spent(self._timed_run(x), Outcome(x, "", iterations, seconds, converged=False))

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return a run of IPOPT's for every minimum that has none.

        What IPOPT does not confirm is no minimum, as where a gain of zero makes all other
        parameters idle: these runs are made again by IPOPT, from their starts.
        """
        certified: dict[int, Outcome] = {}
        for minimum in minima:
            places = np.array(minimum.runs)
            if np.any(runs.stage[places] != IMPROVED):
                continue
            if any(self._confirm(runs[k], certified) for k in minimum.runs[:TRIES]):
                continue
            for k in minimum.runs:
                if k not in certified and not stop_requested():
                    certified[k] = self.judged_run(
                        self._spent(self._timed_run(runs[k].start), runs[k])
                    )
        return certified

    def _confirm(self, before: Run, certified: dict[int, Outcome]) -> bool:
        """Solve by IPOPT from the end of a run; tell whether it stays there. A lower minimum is taken over."""
        if stop_requested():
            return True
        after = self.judged_run(self._timed_run(before.estimate))
        higher = after.cost - before.cost
        tolerated = same_cost(self._nlp, before.cost)
        if not after.converged or not higher <= tolerated:
            return False
        certified[before.index] = self._spent(after, before)
        return higher >= -tolerated

    def _timed_run(self, x: Array) -> Outcome:
        with one_run():
            return self.run(x)

    @staticmethod
    def _spent(after: Outcome, before: Outcome | Run) -> Outcome:
        """Return an outcome with what was spent before it."""
        return replace(
            after,
            iterations=before.iterations + after.iterations,
            seconds=before.seconds + after.seconds,
        )


def _instructions(nlp: CompiledProblem) -> int:
    """Return those of cost, gradient and Hessian: some two for every operation of the cost and unknown."""
    return max(nlp.explicit[-1].n_instructions() * 2 * len(nlp.free), 1)


def _power_of_two(count: int) -> int:
    """Return the largest up to a count: as many columns are evaluated at once."""
    return 1 << (count.bit_length() - 1)
