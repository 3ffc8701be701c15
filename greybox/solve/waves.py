"""The order in which the starts of a search are tried, and when enough have been tried."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.local_solver import LocalSolver, Screened
from greybox.solve.minima import Minimum, agreeing_runs
from greybox.solve.outcome import Run


class Waves(ABC):
    """Parts of the starts, tried one after the other until there were enough.

    The decisions depend on the starts and their order alone, never on which run finishes first.
    """

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts (r, p) compared with each other; None if they are not compared."""
        return None

    @abstractmethod
    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield the numbers of the starts of every wave."""

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether the runs of all waves so far are enough."""
        return False


@dataclass(frozen=True)
class AllAtOnce(Waves):
    """Every start."""

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield all numbers."""
        yield range(count)


@dataclass(frozen=True)
class PromisingFirst(Waves):
    """The most promising starts first, and the others if these do not agree; all if they cannot be compared.

    Parameters
    ----------
    promising : int
        Number of starts in the first wave. On the fits of the paper each of them nearly always
        reaches the best minimum. Eight in a batch take the time of two or three runs of IPOPT; of
        runs on records, which are made one by one, four are enough.
    agreeing : int
        Number of these that must end at the lowest cost. With four of eight, as with three of four,
        the chance of an error is below 2 % if less than one start in six leads there.
    """

    promising: int
    agreeing: int

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts compared by the solver."""
        return solver.screened(starts) if len(starts) > self.promising else None

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield the promising starts, the best first, then the others in their order."""
        if screened is None:
            yield range(count)
            return
        first = screened.order[: self.promising].tolist()
        yield first
        yield [k for k in range(count) if k not in set(first)]

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether enough of the promising starts agree."""
        return len(agreeing_runs_of(nlp, runs, minima)) >= self.agreeing


@dataclass(frozen=True)
class FoundAgain(Waves):
    """Waves that double the number of starts, until another minimum is unlikely.

    If n searches from random points found w minima, and all numbers of minima and all sizes of their
    regions of attraction were equally likely a priori, the probability that there is no other is

        Π_{i=1}^{w} (n - 1 - i) / (n - 1 + i)

    (Boender and Rinnooy Kan, Bayesian stopping rules for multistart global optimization methods,
    Math. Programming 37, 1987).

    Parameters
    ----------
    error : float
        One minus the probability at which the search ends.
    """

    error: float

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Yield waves that double the number of starts."""
        begin = 0
        end = min(32, count)  # starts that find a single minimum again with an error of 6 %
        while begin < count:
            yield range(begin, end)
            begin = end
            end = min(2 * end, count)

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Return whether another minimum is unlikely enough."""
        searches = sum(run.converged for run in runs)
        return 1 - probability_of_no_other(searches, len(minima)) <= self.error


def probability_of_no_other(searches: int, minima: int) -> float:
    """Return the probability that this number of searches found all minima, see `FoundAgain`."""
    if searches <= minima + 1:
        return 0.0
    return math.prod((searches - 1 - i) / (searches - 1 + i) for i in range(1, minima + 1))


def agreeing_runs_of(
    nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
) -> tuple[int, ...]:
    """Return the indices of the runs that ended at the cost of the best minimum, within the noise of the data."""
    numbers = sum(part.numbers for part in nlp.parts)
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    return agreeing_runs(runs, minima, numbers=numbers, is_likelihood=is_likelihood)
