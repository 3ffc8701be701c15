"""The interface of every solver: a run from one start, and whatever else a search needs."""

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
    """The best hidden unknowns of every part at given parameters: those of the smallest cost."""

    trajectories: tuple[Trajectory, ...]
    cost: float
    converged: bool


class Runner(Rebuilt, ABC):
    """An object that makes runs, here or on workers, each from a row of numbers.

    Attributes
    ----------
    together : int
        Number of runs that it makes at once.
    """

    together: int = 1

    @abstractmethod
    def run(self, start: Array) -> Outcome:
        """Make the run from `start` (s,)."""

    def run_together(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, s), at most `together`."""
        return [self.run(start) for start in starts]

    def without_end(self, start: Array, status: str) -> Outcome:
        """Return the outcome of a run from `start` (s,) that ended nowhere."""
        return Outcome(start, status, 0, 0.0, converged=False, cost=math.inf)

    def outcomes(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, s); one that raises an error fails alone.

        The status of its outcome has the error.
        """
        try:
            return self.run_together(starts)
        except Exception as error:
            # CasADi turns Ctrl-C into errors of other classes.
            raise_interrupt(error)
            if len(starts) == 1:
                return [self.without_end(starts[0], f"{RAISED}: {error_sentence(error)}")]
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

    Another process receives its problem and its options, and builds it again.

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
        """Return the best nodes at the parameters x (p,), which are `nodes` if these are known."""

    def is_finite_at(self, start: Array) -> bool:
        """Return whether a run can begin at the parameters `start` (p,)."""
        return True

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) with little work; None if that is not possible."""
        return None

    def near(self, x: Array, nodes: Sequence[Array] | None = None) -> Outcome:
        """Return the run from parameters x (p,) near a minimum, with its nodes if known."""
        return self.run(x)

    def continued(self, outcome: Outcome) -> Outcome:
        """Return a run that did not converge with more iterations, if the solver can."""
        return outcome

    def judged(self, outcomes: Outcomes) -> Outcomes:
        """Return outcomes with costs and signatures."""
        return outcomes

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return outcomes that replace runs, by number: every minimum needs a certified run."""
        return {}

    def with_problem(self, nlp: CompiledProblem) -> "LocalSolver":
        """Return the solver of the same problem with finer steps or other samples."""
        raise NotImplementedError

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum as exact as the arithmetic allows."""
        return search


class Descent(LocalSolver):
    """A solver of which no run ends above the stated cost of its start.

    Barriers, smoothing, other criteria, weights and soft continuity lead its runs to good minima,
    but may lead them away from a better one at the start.
    """

    @abstractmethod
    def led(self, starts: Array) -> Outcomes:
        """Return the runs from the rows of `starts` (r, p), however they are led to minima.

        Costs are the stated ones.
        """

    @abstractmethod
    def descended(self, starts: Array) -> Outcomes:
        """Return where the stated cost alone leads from the rows of `starts` (r, p).

        None that counts as converged ends higher, but for the smoothing.
        """

    @abstractmethod
    def costs_at(self, starts: Array, ends: Outcomes) -> Array:
        """Return the stated costs (r,) at the starts (r, p) of runs with these ends.

        They are infinite where a constraint is missed, or a start surely costs more than the end.
        """

    def run(self, start: Array) -> Outcome:
        """Make the run from the parameters `start` (p,)."""
        return self._no_higher(start[None])[0]

    def run_together(self, starts: Array) -> Outcomes:
        """Make the runs from the rows of `starts` (r, p), at most `together`."""
        return self._no_higher(starts) if self.together > 1 else super().run_together(starts)

    def _no_higher(self, starts: Array) -> Outcomes:
        """Return the runs from `starts` (r, p); those that are led higher begin again, unguided."""
        outcomes = self.led(starts)
        begun = self.costs_at(starts, outcomes)
        above = [k for k, end in enumerate(outcomes) if is_above(end.cost, begun[k])]
        direct = self.descended(starts[above]) if above else []
        for k, end in zip(above, direct, strict=True):
            # A descent lowers the smoothed cost: the minimum of the stated one is then nearer here.
            if is_above(end.cost, begun[k]):
                end = replace(end, estimate=starts[k], cost=begun[k])  # noqa: PLW2901
            outcomes[k] = spent(end, outcomes[k])
        return outcomes
