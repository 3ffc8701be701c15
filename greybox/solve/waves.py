"""In which order the starts of a search are tried, and when enough were."""

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
    """Parts of the starts that are tried one after the other, until there were enough.

    What is decided depends on the starts and on their order alone, never on who finishes first.
    """

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts (r, p) compared, where they are before any is run."""
        return None

    @abstractmethod
    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Give the numbers of the starts of every wave."""

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Tell whether the runs of all waves so far will do."""
        return False


@dataclass(frozen=True)
class AllAtOnce(Waves):
    """Every start."""

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Give all numbers."""
        yield range(count)


@dataclass(frozen=True)
class PromisingFirst(Waves):
    """The most promising starts first, and the others if these do not agree; all, where they cannot be compared.

    Parameters
    ----------
    promising : int
        How many are run first. On the fits of the paper each of them reaches the best minimum as
        good as always; eight in a batch take the time of two or three runs of IPOPT. Of runs on
        records, each of which takes its own time, four.
    agreeing : int
        How many of them must end at the lowest cost. Of four out of eight, as of three out of four,
        the chance is below 2 % where less than one start in six leads there.
    """

    promising: int
    agreeing: int

    def screened(self, solver: LocalSolver, starts: Array) -> Screened | None:
        """Return the starts compared."""
        return solver.screened(starts) if len(starts) > self.promising else None

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Give the promising ones, the most promising first, then the others, in their order."""
        if screened is None:
            yield range(count)
            return
        first = screened.order[: self.promising].tolist()
        yield first
        yield [k for k in range(count) if k not in set(first)]

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Tell whether enough of them agree."""
        return len(agreeing_runs_of(nlp, runs, minima)) >= self.agreeing


@dataclass(frozen=True)
class FoundAgain(Waves):
    """Waves that double, until it is unlikely that there is a minimum which none of the starts has found.

    After n searches from random points that found w minima, with all numbers of minima and all
    sizes of their regions of attraction equally likely before, the probability that there is no
    other is

        Π_{i=1}^{w} (n - 1 - i) / (n - 1 + i)

    (Boender and Rinnooy Kan, Bayesian stopping rules for multistart global optimization methods,
    Math. Programming 37, 1987).

    Parameters
    ----------
    error : float
        One minus the probability that is enough.
    """

    error: float

    FIRST = 32  # starts: enough to find a single minimum again with an error of 6 %

    def numbers(self, count: int, screened: Screened | None) -> Iterator[Sequence[int]]:
        """Give waves that double the number of starts."""
        done, end = 0, min(self.FIRST, count)
        while done < count:
            yield range(done, end)
            done, end = end, min(2 * end, count)

    def are_enough(
        self, nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
    ) -> bool:
        """Tell whether the probability is reached."""
        return (
            1 - probability_of_no_other(sum(run.converged for run in runs), len(minima))
            <= self.error
        )


def probability_of_no_other(searches: int, minima: int) -> float:
    """Return the probability that so many searches found all minima there are, see `FoundAgain`."""
    if searches <= minima + 1:
        return 0.0
    return math.prod((searches - 1 - i) / (searches - 1 + i) for i in range(1, minima + 1))


def agreeing_runs_of(
    nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
) -> tuple[int, ...]:
    """Return the runs that ended at the cost of the best minimum, as far as the data tell, by their index."""
    numbers = sum(part.numbers for part in nlp.parts)
    is_likelihood = any(part.is_likelihood for part in nlp.parts)
    return agreeing_runs(runs, minima, numbers=numbers, is_likelihood=is_likelihood)
