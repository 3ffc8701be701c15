"""The interface of every solver: a run from one start, and what a search from many starts needs besides."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.part import Trajectory
from greybox.files.arrays import Array, IntArray
from greybox.solve.minima import Minimum, Multistart
from greybox.solve.outcome import Outcome
from greybox.solve.runs import Runs


@dataclass(frozen=True, eq=False)
class Profile:
    """The best hidden unknowns of every part at given parameters: those of the smallest cost."""

    z: Array
    trajectories: tuple[Trajectory, ...]
    cost: float
    converged: bool


class Runner(ABC):
    """What makes runs, here or on workers, each from a row of numbers.

    Attributes
    ----------
    together : int
        How many it makes at once.
    """

    together: int = 1

    @abstractmethod
    def __reduce__(self) -> tuple[Callable[..., "Runner"], tuple[Any, ...]]:
        """Return what builds the same, and its arguments."""

    @abstractmethod
    def run(self, start: Array) -> Outcome:
        """Make the run that `start` (s,) stands for."""

    def run_together(self, starts: Array) -> list[Outcome]:
        """Make those of every row of `starts` (r, s), at most `together`."""
        return [self.run(start) for start in starts]


@dataclass(frozen=True, eq=False)
class Screened:
    """Starts that were compared before any of them is run.

    Attributes
    ----------
    order : (r,) array of int
        Their numbers, the most promising first.
    costs : (r,) array
        At the starts, as far as the criterion was evaluated there; infinite elsewhere.
    begins : (r, p) array
        Where runs from them begin: there, or where the comparison has led.
    """

    order: IntArray
    costs: Array
    begins: Array


class LocalSolver(Runner):
    """A solver of one compiled problem, built once for all starts, which are parameters (p,).

    Pickled, it is its problem and its options, and is built anew where it arrives.

    Attributes
    ----------
    starts : int
        How many are tried where nothing is said.
    tries_declared_values : bool
        Whether the declared values are the first of a number of starts.
    promising : tuple of int
        How many of the starts that it has compared are run first, and how many of these must agree.
    """

    starts: ClassVar[int] = 20
    tries_declared_values: ClassVar[bool] = True
    promising: ClassVar[tuple[int, int]] = (4, 3)

    @abstractmethod
    def __reduce__(self) -> tuple[Callable[..., "LocalSolver"], tuple[Any, ...]]:
        """Return what builds the same solver, and its arguments."""

    @abstractmethod
    def profile(self, x: Array, nodes: Sequence[Array] | None = None) -> Profile:
        """Return the best nodes at the parameters x (p,); `nodes`, if given, are known to be the best."""

    @abstractmethod
    def cost(self, values: Array) -> float:
        """Return the smallest cost at all values (k,), the constants among them; NaN where there is none."""

    def is_finite_at(self, start: Array) -> bool:
        """Tell whether a run can begin at the parameters `start` (p,)."""
        return True

    def screened(self, starts: Array) -> Screened | None:
        """Compare the starts (r, p) at low cost; None where they cannot be."""
        return None

    def judged(self, estimates: Array) -> tuple[Array, Any] | None:
        """Return costs (r,) and signatures (r, m) at the ends (r, p) of runs; None where the runs leave them."""
        return None

    def certified(self, runs: Runs, minima: Sequence[Minimum]) -> dict[int, Outcome]:
        """Return what takes the place of runs so that one is certified to be at a minimum for each of the `minima`."""
        return {}

    @abstractmethod
    def refined(self, nlp: CompiledProblem) -> "LocalSolver":
        """Return the solver of the same problem with finer steps."""

    def polished(self, search: Multistart) -> Multistart:
        """Return the search with its best minimum as exact as the arithmetic allows, not only as a run's tolerances."""
        return search
