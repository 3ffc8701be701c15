"""The interface of every solver: a run from one start, and the other steps of a search."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.error_place import error_sentence
from greybox.data.files.frozen_values import frozen
from greybox.data.files.rebuilt import Rebuilt
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.part import Trajectory
from greybox.engine.solve.interruption import raise_interrupt
from greybox.engine.solve.minima import Minimum, Multistart
from greybox.engine.solve.promising import Promising
from greybox.engine.solve.runs import RAISED, Outcome, Outcomes, Runs, spent
from greybox.engine.solve.stationarity import is_above


@frozen
class Profile:
    """The hidden unknowns of every part that minimize the cost at given parameters."""

    trajectories: tuple[Trajectory, ...]
    cost: float
    converged: bool


class Runner(Rebuilt, ABC):
    """Makes one run for each start, in this process or in worker processes.

    Attributes
    ----------
    together : int
        Number of runs in a batch.
    """

    together: int = 1

    @abstractmethod
    def run(self, start: Array) -> Outcome:
        """Make the run from `start` (s,)."""

    def run_together(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, s), at most `together`."""
        return [self.run(start) for start in starts]

    def without_end(self, start: Array, status: str) -> Outcome:
        """Return the outcome of a failed run from `start` (s,), which has no end."""
        return Outcome(start, status, iterations=0, seconds=0.0, converged=False, cost=math.inf)

    def outcomes(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, s).

        If a run raises an error, only this run fails, and the status of its outcome states the
        error.
        """
        try:
            return self.run_together(starts)
        except Exception as error:
            # CasADi turns Ctrl-C into errors of other classes.
            raise_interrupt(error)
            if len(starts) == 1:
                return [self.without_end(starts[0], f"{RAISED}: {error_sentence(error)}")]
        # A batch in which some run failed is repeated, one start at a time.
        return [outcome for start in starts for outcome in self.outcomes(start[None])]


@frozen
class Screened:
    """Starts that were compared before any of them is run.

    Attributes
    ----------
    order : (r,) array of int
        Numbers of the starts, the most promising first.
    costs : (r,) array
        Costs at the starts; infinite where the criterion was not evaluated.
    """

    order: IntArray
    costs: Array


class LocalSolver(Runner):
    """A solver of one compiled problem, built once for all starts, which are parameters (p,).

    A worker process receives the problem and the options, and builds the solver again.

    Attributes
    ----------
    nlp : CompiledProblem
    starts : int
        Default number of starts.
    promising : Promising
        How many of the screened starts are run first, and how many of these must agree.
    """

    nlp: CompiledProblem
    starts: int = 20
    promising: ClassVar[Promising] = Promising((4,), agree=3)

    @abstractmethod
    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,); known `nodes` are used as they are."""

    def is_finite_at(self, start: Array) -> bool:
        """Return whether a run can begin at the parameters `start` (p,)."""
        return True

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) with little work; None if that is not possible."""
        return None

    def near(self, x: Array, nodes: Sequence[Array] | None = None) -> Outcome:
        """Run from parameters x (p,) near a minimum, and from its nodes if they are known."""
        return self.run(x)

    def continued(self, outcome: Outcome) -> Outcome:
        """Continue a run that did not converge, if the solver can; else return it unchanged."""
        return outcome

    def judged(self, outcomes: Outcomes) -> Outcomes:
        """Return outcomes with costs and signatures."""
        return outcomes

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return outcomes that replace runs, by index: every minimum needs a certified run."""
        return {}

    def with_problem(self, nlp: CompiledProblem) -> "LocalSolver":
        """Return the solver of the same problem with finer steps or other samples."""
        raise NotImplementedError

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum refined to the precision of the arithmetic."""
        return search


class Descent(LocalSolver):
    """A solver whose runs never end above the stated cost of their starts.

    Barriers, smoothing, other criteria, weights and soft continuity guide its runs to good minima,
    but may guide a run away from a better minimum at its start.
    """

    @abstractmethod
    def led(self, starts: Array) -> Outcomes:
        """Return the guided runs from the rows of `starts` (r, p), with their stated costs."""

    @abstractmethod
    def descended(self, starts: Array) -> Outcomes:
        """Return unguided runs, on the stated cost alone, from the rows of `starts` (r, p).

        A converged run ends no higher than its start, except for the error of the smoothing.
        """

    @abstractmethod
    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the stated costs (r,) at the starts (r, p) of runs with these ends.

        A cost is infinite if the start violates a constraint, or surely costs more than the end.
        """

    def run(self, start: Array) -> Outcome:
        """Make the run from the parameters `start` (p,)."""
        return self._no_higher(start[None])[0]

    def run_together(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, p), at most `together`."""
        return self._no_higher(starts) if self.together > 1 else super().run_together(starts)

    def _no_higher(self, starts: Array) -> Outcomes:
        """Return the runs from `starts` (r, p).

        A guided run that ends above its start is made again without guidance.
        """
        outcomes = self.led(starts)
        start_costs = self.costs_at(starts, outcomes)
        above = [k for k, end in enumerate(outcomes) if is_above(end.cost, start_costs[k])]
        direct = self.descended(starts[above]) if above else []
        for k, end in zip(above, direct, strict=True):
            # A descent lowers the smoothed cost, and may still end at a higher stated cost. The
            # start is then nearer to the minimum.
            if is_above(end.cost, start_costs[k]):
                end = replace(end, estimate=starts[k], cost=start_costs[k])  # noqa: PLW2901
            outcomes[k] = spent(end, outcomes[k])
        return outcomes
