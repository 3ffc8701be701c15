"""Where the outcomes of a search are kept as they come, so that a search that was killed can go on."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from greybox.solve.outcome import Outcome

Array = NDArray[np.float64]


class KeptRunsError(ValueError):
    """Runs that were kept are not of the search that goes on from them, or cannot be read."""


class KeptRuns(ABC):
    """The runs of one problem by the numbers of their starts."""

    @abstractmethod
    def known(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return start (p,) and outcome of the runs that an earlier search made, by the number of the start.

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


class NothingKept(KeptRuns):
    """Keeps nothing."""

    def known(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return no run."""
        return {}

    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Do nothing."""

    def look(self) -> None:
        """Do nothing."""
