"""Where the outcomes of a search are kept as they come, so that a search that was killed can go on."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from greybox.files.arrays import Array
from greybox.solve.outcome import INTERRUPTED, RUN_OVER, SEARCH_OVER, Outcome
from greybox.solve.time_limits import current_limits


class KeptRunsError(ValueError):
    """Runs that were kept are not of the search that goes on from them, or cannot be read."""


class KeptRuns(ABC):
    """The runs of one problem by number: that of the start, below zero for runs that began elsewhere."""

    @abstractmethod
    def known(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return start (p,) and outcome of the runs that an earlier search made, by their numbers.

        `fingerprint` stands for the compiled problem and the options of its solver.

        Raises
        ------
        KeptRunsError
            If they were made for another problem, or with other options, or cannot be read.
        """

    @abstractmethod
    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Keep a run, as soon as it is done, in whatever order."""

    @abstractmethod
    def look(self) -> None:
        """Write what is due; called often."""


class Memory:
    """What a search remembers of an earlier one, and hands on to be kept; nothing where nothing is kept.

    The numbers of runs that begin elsewhere than at the starts are negative.
    """

    def __init__(self, kept: KeptRuns | None = None, fingerprint: str = "") -> None:
        self._kept = kept
        self._known = {} if kept is None else kept.known(fingerprint)

    def recall(self, number: int, start: Array) -> Outcome | None:
        """Return what is known of a run, None if it has to be made; what a shorter time limit has cut is made again.

        Raises
        ------
        KeptRunsError
            If the run of this number began at another start.
        """
        if number not in self._known:
            return None
        before, outcome = self._known[number]
        if outcome.status == RUN_OVER and outcome.seconds < current_limits().start:
            return None
        if np.array_equal(before, start):
            return outcome
        if number < 0:
            return None
        raise KeptRunsError(
            f"the runs that were kept began at other starts, from number {number} on: give the same rule and seed."
        )

    def keep(self, number: int, start: Array, outcome: Outcome) -> None:
        """Keep a run, unless it was kept before, or was cut short, so that it is made again."""
        if self._kept is None or outcome.status in (INTERRUPTED, SEARCH_OVER):
            return
        if self.recall(number, start) is None:
            self._kept.add(number, start, outcome)

    def look(self) -> None:
        """Have written what is due."""
        if self._kept is not None:
            self._kept.look()
