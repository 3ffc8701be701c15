"""What a search on records tries besides its starts: unfinished runs, and neighbors of the best.

It decides as the runs end, in the order of the starts. A search with more starts that begins with
the same ones therefore tries all that a shorter one does, and never ends at a higher cost.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.gauss_newton.shared_runs import SharedRuns
from greybox.solve.interruption import one_run, stop_requested
from greybox.solve.kept_runs import Memory
from greybox.solve.local_solver import LocalSolver
from greybox.solve.minima import same_cost
from greybox.solve.runs import CUT_SHORT, NOT_FINITE, Outcome

NEIGHBOR_ITERATIONS = 40  # of a run from the neighborhood of the best end


class LocalSearch:
    """The runs of a search so far, in the order of the starts.

    Attributes
    ----------
    further : list of (start, Outcome)
        Runs from the neighborhood of the best.
    """

    def __init__(
        self,
        nlp: CompiledProblem,
        solver: LocalSolver,
        memory: Memory,
        shared: SharedRuns | None = None,
        *,
        neighbors: bool,
    ) -> None:
        """Begin a search; with `neighbors`, the neighborhood of every new best end is tried."""
        self._nlp = nlp
        self._solver = solver
        self._shared = shared
        self._memory = memory
        self._number = 0  # of the last run that was made, counted down from zero
        self._tries_more = isinstance(solver, GaussNewton)
        self._neighbors = neighbors and nlp.strategies.scaled_neighbors
        self._best: Outcome | None = None
        self.further: list[tuple[Array, Outcome]] = []

    def improved(self, outcome: Outcome) -> Outcome:
        """Continue an unfinished run, and try the neighborhood of a new best one."""
        if not self._tries_more:
            return outcome
        solver, unfinished = self._solver, outcome
        assert isinstance(solver, GaussNewton)
        if (
            self._nlp.strategies.continued_runs
            and self._is_unfinished(outcome)
            and not stop_requested()
        ):
            outcome = self._remembered(
                outcome.estimate, lambda: solver.continued(unfinished), outcome.seconds
            )
        if self._is_best(outcome):
            self._best = outcome
            if self._neighbors:
                self._try_neighbors(solver)
        return outcome

    def _is_unfinished(self, outcome: Outcome) -> bool:
        # A run that a time limit or Ctrl-C has cut short must not continue.
        if (
            outcome.converged
            or outcome.status in (NOT_FINITE, *CUT_SHORT)
            or not math.isfinite(outcome.cost)
        ):
            return False
        return self._best is None or outcome.cost < self._best.cost

    def _is_best(self, outcome: Outcome) -> bool:
        """Tell whether an outcome is better than all before, beyond the scatter of one end."""
        if not outcome.converged:
            return False
        return self._best is None or outcome.cost < self._best.cost - same_cost(
            self._nlp, self._best.cost
        )

    def _try_neighbors(self, solver: GaussNewton) -> None:
        """Add runs from the neighborhood of the best end as long as they find a lower cost."""
        while self._best is not None and not stop_requested():
            best = self._best

            # All neighbors are tried before the search moves on: their order must not decide.
            points = _scaled(self._nlp, best.estimate)
            tried: list[tuple[Array, Outcome]] = []
            for point in points:
                if not stop_requested():
                    run = partial(self._run_near, solver, point, best)
                    tried.append((point, self._remembered(point, run)))
            better = [(point, outcome) for point, outcome in tried if self._is_best(outcome)]
            if not better:
                break
            point, lowest = min(better, key=lambda pair: pair[1].cost)
            self._best = lowest
            self.further.append((point, lowest))

    def _remembered(self, start: Array, make: Callable[[], Outcome], spent: float = 0.0) -> Outcome:
        """Return the outcome of a run, stored or made; `spent` s of its time have passed."""
        # Counted down in the order of the decisions, the number is the same when a search resumes.
        self._number -= 1
        outcome = self._memory.recall(self._number, start)
        if outcome is None:
            with one_run(spent):
                outcome = make()
            self._memory.keep(self._number, start, outcome)
        return outcome

    def _run_near(self, solver: GaussNewton, point: Array, best: Outcome) -> Outcome:
        settings = self._nlp.strategies
        simulated = None
        if settings.simulated_neighbors and best.nodes is not None:
            simulated = solver.run_simulated(point, best.nodes, NEIGHBOR_ITERATIONS)
        return simulated or (self._shared or solver).run(point, NEIGHBOR_ITERATIONS)


def _scaled(nlp: CompiledProblem, best: Array) -> list[Array]:
    """Return the point with every positive parameter a factor of four smaller and larger.

    Lags that swap places make minima whose neighborhoods take up shares of the start box that
    differ a hundredfold.
    """
    points = []
    for k in np.flatnonzero(nlp.lower > 0):
        for factor in (0.25, 4.0):
            point = best.copy()
            point[k] = np.clip(factor * point[k], nlp.lower[k], nlp.upper[k])
            points.append(point)
    return points
