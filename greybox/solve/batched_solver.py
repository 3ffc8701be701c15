"""The search of frequency responses: starts are compared, and Newton's method improves many at once.

Runs that are improved together end at a minimum of the same smoothed cost as those of IPOPT. IPOPT
then solves one run of every distinct minimum again: a minimum counts only when IPOPT's conditions of
optimality (KKT) are met there too. IPOPT also makes all runs of problems that `fits_a_batch` excludes.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.interruption import reason_to_end, stop_requested
from greybox.solve.ipopt import IpoptSolver, merits
from greybox.solve.local_solver import LocalSolver, Profile, Screened
from greybox.solve.minima import Minimum, Multistart, same_cost
from greybox.solve.outcome import IMPROVED, Outcome, Run
from greybox.solve.runs import Runs
from greybox.solve.time_limits import one_run

AT_MINIMUM = "At_Minimum"  # status of a run whose projected gradient vanishes

# Iterations of a batch. Runs on the fits of the paper take 20 to 60, on polynomials of high order
# up to 200. IPOPT continues those that need more.
ITERATIONS = 300

TOLERANCE = 1e-8  # on the projected gradient in the solver's variables, as in IPOPT


def fits_a_batch(program: ca.Function | None) -> bool:
    """Tell whether a batch of a program (z, smoothing, ...) -> cost, constraints is faster than IPOPT's runs.

    It needs an explicit cost (an SX function) and no constraints but bounds. From 50 000 instructions of cost,
    gradient and Hessian on, these take most of IPOPT's time, and from 20 unknowns on eigenvalues
    do: a batch gains little then.
    """
    if program is None or not program.is_a("SXFunction") or program.numel_out(1):
        return False
    return program.numel_in(0) <= 20 and _instructions(program) <= 50_000


class BatchedSolver(LocalSolver):
    """Newton's method on all starts of a batch; IPOPT for the others, and to confirm the minima."""

    starts = IpoptSolver.starts
    tries_declared_values = IpoptSolver.tries_declared_values
    promising = (8, 4)

    def __init__(
        self, problem: CompiledProblem, options: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        """Build IPOPT; the functions of the batch are built when the first one is run."""
        self._problem = problem
        self._options = options
        self._ipopt = IpoptSolver(problem, options)
        self._batches: list[BatchedNewton] = []
        explicit = problem.programs[-1].explicit
        self.together = _batch_size(explicit) if explicit and self.serves(problem) else 1

    def __reduce__(self) -> tuple[Callable[..., "BatchedSolver"], tuple[Any, ...]]:
        """Return what builds the same solver."""
        return BatchedSolver, (self._problem, dict(self._options))

    @staticmethod
    def serves(problem: CompiledProblem) -> bool:
        """Tell whether starts of a problem are improved together."""
        without_states = not any(part.has_states for part in problem.parts)
        return without_states and fits_a_batch(problem.programs[-1].explicit)

    # --- as IPOPT does

    def run(self, start: Array) -> Outcome:
        """Solve by IPOPT from the parameters `start` (p,)."""
        return self._ipopt.run(start)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the point x (p,): there is nothing hidden."""
        return self._ipopt.profile(x, nodes)

    def cost(self, values: Array) -> float:
        """Return the cost without smoothing at all values (k,)."""
        return self._problem.cost(values)

    def judged(self, estimates: Array) -> tuple[Array, Any]:
        """Return the costs, without smoothing, and signatures."""
        return self._ipopt.judged(estimates)

    def refined(self, nlp: CompiledProblem) -> "BatchedSolver":
        """Return the solver of another problem with the same options."""
        return BatchedSolver(nlp, self._options)

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with the minima close to the best solved with less smoothing."""
        return self._ipopt.polished(search)

    # --- many starts

    def screened(self, starts: Array) -> Screened:
        """Compare the starts (r, p) by their merits."""
        values = merits(self._problem, self._problem.scaling.to_solver(starts).T)
        return Screened(np.argsort(values, kind="stable"), values, starts)

    def run_together(self, starts: Array) -> list[Outcome]:
        """Bring all starts (r, p) to a minimum together; IPOPT continues those that do not arrive."""
        # One step on few points takes 0.3 ms, ten times an iteration of IPOPT.
        if len(starts) < 6 or self.together == 1:
            return super().run_together(starts)

        began = time.perf_counter()
        z = self._problem.scaling.to_solver(starts).T
        iterations, arrived = np.zeros(len(starts), int), np.zeros(len(starts), bool)
        for k, batch in enumerate(self._built()):
            ends = batch.minimize(
                z,
                max_iterations=int(self._options.get("max_iter", ITERATIONS)),
                tolerance=float(self._options.get("tol", TOLERANCE)),
                from_near=k > 0,
            )
            z, iterations, arrived = ends.z, iterations + ends.iterations, ends.at_minimum

        parameters = self._problem.scaling.to_parameters(z.T)
        estimates = np.clip(parameters, self._problem.lower, self._problem.upper)
        seconds = (time.perf_counter() - began) / len(starts)
        return [
            Outcome(x, AT_MINIMUM, count, seconds, converged=True, stage=IMPROVED)
            if at_minimum
            else self._continued(x, count, seconds)
            for x, count, at_minimum in zip(estimates, iterations.tolist(), arrived, strict=True)
        ]

    def _built(self) -> list[BatchedNewton]:
        """Return the criterion that locates the minimum, if any, then the problem's own."""
        if not self._batches:
            scale = self._problem.scaling.to_solver
            bounds = scale(self._problem.lower), scale(self._problem.upper)
            self._batches = [
                BatchedNewton(program.explicit, *bounds, program.roots)
                for program in self._problem.programs
                if program.explicit is not None
            ]
        return self._batches

    def _continued(self, x: Array, iterations: int, seconds: float) -> Outcome:
        """Return where IPOPT gets to from the end of a run that did not arrive."""
        if cut := reason_to_end():
            return Outcome(x, cut, iterations, seconds, converged=False)
        return _spent(self._timed_run(x), Outcome(x, "", iterations, seconds, converged=False))

    # --- the certificate

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return a run of IPOPT's for every minimum that has none.

        What IPOPT does not confirm is no minimum, as where a gain of zero makes all other
        parameters idle: these runs are made again by IPOPT, from their starts.
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
                    again = _spent(self._timed_run(runs[k].start), runs[k])
                    certified[k] = self._ipopt.judged_run(again)
        return certified

    def _confirm(self, run: Run, certified: dict[int, Outcome]) -> bool:
        """Solve by IPOPT from the end of a run; tell whether it stays there. A lower minimum replaces the run."""
        if stop_requested():
            return True
        outcome = self._ipopt.judged_run(self._timed_run(run.estimate))
        higher = outcome.cost - run.cost
        tolerated = same_cost(self._problem, run.cost)
        if not outcome.converged or not higher <= tolerated:
            return False
        certified[run.index] = _spent(outcome, run)
        return higher >= -tolerated

    def _timed_run(self, x: Array) -> Outcome:
        with one_run():
            return self.run(x)


def _spent(outcome: Outcome, earlier: Outcome | Run) -> Outcome:
    """Return an outcome with the iterations and seconds of an earlier one added."""
    return replace(
        outcome,
        iterations=earlier.iterations + outcome.iterations,
        seconds=earlier.seconds + outcome.seconds,
    )


def _instructions(program: ca.Function) -> int:
    """Estimate the instructions of cost, gradient and Hessian: two for every operation and unknown."""
    return max(program.n_instructions() * 2 * program.numel_in(0), 1)


def _batch_size(program: ca.Function) -> int:
    """Return how many starts are improved at once: a power of two, as the columns of a batch.

    Up to 1024: more do not become cheaper. Fewer where a batch would take more than some 0.5 s (10
    million instructions), so that a time limit costs no more and progress is seen. At least 128:
    below, a start takes more than twice its time.
    """
    count = min(max(10_000_000 // _instructions(program), 128), 1024)
    return 1 << (count.bit_length() - 1)
