"""A user's own solver, and its runs: everything else of a search is that of the included solvers.

What the solver says of its end decides nothing. The cost is the stated one, and a run has converged
where no step within the limits promises a decrease that errors of the data do not hide.
"""

import math
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from greybox.data.files.argument_checks import require_kind
from greybox.data.files.arrays import Array, all_finite
from greybox.data.files.frozen_values import frozen
from greybox.data.files.public import public
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.constraints import Limits, limits_of
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.engine.solve.local_solver import Descent, LocalSolver, Profile, Screened
from greybox.engine.solve.minima import Minimum, Multistart, likelihood_unit, same_cost
from greybox.engine.solve.objective import Objective, objective_near
from greybox.engine.solve.response_solver import TOLERANCE
from greybox.engine.solve.runs import IMPROVED, Outcome, Outcomes, Run, Runs
from greybox.engine.solve.search_method import SearchMethod, solver_for
from greybox.engine.solve.stationarity import is_minimum
from greybox.modeling.cached_property import cached_property

NO_MINIMUM = "no minimum"
NO_COST = "no finite cost at the end"

# Units of log-likelihood that are left to gain where a run counts as converged: half the square of
# a thirtieth of a standard error. The best minimum is polished to the last digits anyway.
NEGLIGIBLE = 5e-4


@public
@frozen
class Solution:
    """Where a solver ended.

    Attributes
    ----------
    estimate : (p,) array
        In the variables of the objective.
    status : str
        What the solver says of its end.
    iterations : int

    Examples
    --------
    >>> gb.Solution(np.array([1.0, 2.0]), "converged", 12).iterations
    12
    """

    estimate: Array
    status: str = ""
    iterations: int = 0


class Solver(SearchMethod):
    """A solver of your own for ``fit(problem, search=MySolver())``: one run from one start.

    A subclass is a frozen dataclass with its settings as fields. With workers, they import it: it
    is declared in a module.

    Attributes
    ----------
    takes_constraints : bool
        Whether it heeds `Objective.constraints`. Others refuse problems that have constraints.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from scipy.optimize import minimize
    >>> from greybox.problems import pitch_hover
    >>> @dataclass(frozen=True)
    ... class QuasiNewton(gb.Solver):
    ...     'L-BFGS-B of SciPy.'
    ...
    ...     def solve(self, objective, start):
    ...         bounds = [*zip(objective.lower, objective.upper)]
    ...         cost = objective.value_and_gradient
    ...         end = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
    ...         return gb.Solution(end.x, end.message, end.nit)
    >>> len(gb.fit(pitch_hover.problem(), starts=3, search=QuasiNewton()).runs)
    3
    """

    takes_constraints: ClassVar[bool] = False

    @abstractmethod
    def solve(self, objective: Objective, start: Array) -> Solution:
        """Return where a run ends.

        Parameters
        ----------
        objective : Objective
            Cost, derivatives, residuals and bounds, of scaled variables: the ends of the start
            boxes are about one, and parameters with ``scale="log"`` are logarithms.
        start : (p,) array
            Within the bounds.
        """

    def local_solver(self, nlp: CompiledProblem, options: Mapping[str, Any]) -> LocalSolver:
        """Return the runs of this solver on a problem.

        Raises
        ------
        ValueError
            For options, and for constraints that the solver does not take.
        """
        name = type(self).__name__
        if options:
            raise ValueError(
                f"solver_options {', '.join(options)} are those of the included solvers: give "
                f"{name} its own as fields."
            )
        if nlp.limits and not self.takes_constraints:
            raise ValueError(
                f"{name} takes no constraints, and the problem has {nlp.limits[0]}: use "
                "search='batched', or a solver with takes_constraints = True that heeds "
                "objective.constraints."
            )
        return OwnSolver(nlp, self)


class OwnSolver(Descent):
    """The runs of a user's solver on one problem."""

    def __init__(self, nlp: CompiledProblem, solver: Solver) -> None:
        """Build the included solver, which judges the runs."""
        self.nlp = nlp
        self._solver = solver
        # States of any transcription are judged by Gauss-Newton steps.
        self._included: Any = GaussNewton(nlp) if nlp.has_states else solver_for(nlp)
        self.starts = self._included.starts

    # --- runs

    def led(self, starts: Array) -> Outcomes:
        """Return the runs from all starts (r, p)."""
        return [self._led(start) for start in starts]

    def _led(self, start: Array) -> Outcome:
        began = time.perf_counter()
        objective = objective_near(self.nlp, start).scaled
        at = np.clip(objective.start, objective.lower, objective.upper)
        solution = self._solver.solve(objective, at)
        require_kind("what solve returns", solution, Solution, "a greybox.Solution")
        z = np.asarray(solution.estimate, dtype=float).ravel()
        if z.shape != start.shape:
            raise ValueError(
                f"the solution has {z.size} values: give the {start.size} of the objective's "
                "variables."
            )

        seconds = time.perf_counter() - began
        ended = Outcome(start, NO_COST, int(solution.iterations), seconds, converged=False)
        if not all_finite(z):
            return replace(ended, cost=math.inf)
        x = self.nlp.estimate_at(z)
        ended = replace(ended, estimate=x, status=solution.status or "ended")
        judged = self._judged_states(ended) if self.nlp.has_states else self._judged_cost(ended)
        if judged.converged or judged.status == NO_COST:
            return judged
        return replace(judged, status=f"{judged.status} ({NO_MINIMUM})")

    def _judged_states(self, ended: Outcome) -> Outcome:
        """Return the outcome with its states and cost, and whether it is a minimum."""
        profile = self._included.profile(ended.estimate)
        if not profile.converged:
            return replace(ended, status=NO_COST, cost=math.inf)
        pairs = zip(self.nlp.parts, profile.trajectories, strict=True)
        signature = np.concatenate([part.signature(trajectory) for part, trajectory in pairs])
        return replace(
            ended,
            cost=profile.cost,
            converged=self._included.is_minimum(ended.estimate, profile),
            signature=signature,
            nodes=tuple(trajectory.nodes for trajectory in profile.trajectories),
        )

    def _judged_cost(self, ended: Outcome) -> Outcome:
        """Return the outcome with its cost, and whether it is a minimum."""
        objective = self._objective
        z = self.nlp.scaling.to_solver(ended.estimate)
        cost = objective.value(z)
        if not math.isfinite(cost):
            return replace(ended, status=NO_COST, cost=math.inf)
        # For every variable, as `is_minimum` takes it.
        tolerance = max(TOLERANCE, NEGLIGIBLE * likelihood_unit(self.nlp, cost) / len(z))
        gradient, hessian = objective.gradient(z), objective.hessian(z)
        converged = is_minimum(self._limits, z, cost, gradient, hessian, tolerance)
        return replace(ended, cost=cost, converged=converged, stage=IMPROVED)

    def descended(self, starts: Array) -> Outcomes:
        """Return no runs: one that ends above its start has failed, and ends at the start."""
        status = f"ended above its start ({NO_MINIMUM})"
        return [Outcome(start, status, 0, 0.0, converged=False, cost=math.inf) for start in starts]

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return the runs of the minima that the included solver confirms, and does not.

        From an end that is a saddle, it finds a lower one: the run has not converged.
        """
        outcomes = self._included.certified(runs, minima)
        for k, outcome in outcomes.items():
            run = runs[k]
            is_confirmed = outcome.cost >= run.cost - same_cost(self.nlp, run.cost)
            if outcome.converged and is_confirmed:
                outcomes[k] = replace(outcome, status=run.status)
            else:
                outcomes[k] = self._refused(run)
        return outcomes

    def _refused(self, run: Run) -> Outcome:
        """Return the outcome of a run that has not ended at a minimum."""
        status = f"{run.status} ({NO_MINIMUM})"
        failed = Outcome(run.estimate, status, run.iterations, run.seconds, converged=False)
        [outcome] = self._included.judged([failed])
        return outcome

    # --- what the included solver does

    def is_finite_at(self, start: Array) -> bool:
        """Return whether a run can begin at the parameters `start` (p,)."""
        return self._included.is_finite_at(start)

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p)."""
        return self._included.screened(starts)

    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the stated costs (r,) at the starts (r, p)."""
        return self._included.costs_at(starts, ends)

    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,)."""
        return self._included.profile(x, nodes)

    def near(self, x: Array, nodes: Sequence[Array] | None = None) -> Outcome:
        """Return the included solver's run from parameters x (p,) near a minimum."""
        return self._included.near(x, nodes)

    def judged(self, outcomes: Outcomes) -> Outcomes:
        """Return outcomes with costs and signatures."""
        return self._included.judged(outcomes)

    def with_problem(self, nlp: CompiledProblem) -> LocalSolver:
        """Return the included solver of the problem, which is near the minimum already."""
        return self._included.with_problem(nlp)

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum as exact as the arithmetic allows."""
        return self._included.polished(search)

    # --- what judges an end

    @cached_property
    def _objective(self) -> Objective:
        return Objective(self.nlp, np.zeros(len(self.nlp.free)), is_scaled=True)

    @cached_property
    def _limits(self) -> Limits:
        return limits_of(self.nlp)
