"""Storage for the runs of a search as they finish, so that a killed search can resume."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.engine.solve.runs import CUT_SHORT, Outcome, has_raised
from greybox.modeling.fingerprint import value_fingerprint


class RunStorageError(ValueError):
    """Stored runs belong to another search, or cannot be read."""


class RunStorage:
    """The stored runs of one problem by number of the start, or by that of their `continuation`.

    This class itself stores none.
    """

    def stored(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return start (p,) and outcome of the stored runs by number.

        `fingerprint` identifies the compiled problem and the options of its solver.

        Raises
        ------
        RunStorageError
            If the runs are those of another problem or of other options, or cannot be read.
        """
        return {}

    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Store a run as soon as it is finished, in any order."""

    def write_due(self) -> None:
        """Write the runs that are due; called often."""


def continuation(number: int) -> int:
    """Return the number under which the continuation of a run is stored: below zero."""
    return -1 - number


class Memory:
    """The runs of an earlier search by a `solver`, and storage for new ones; empty without one."""

    def __init__(self, storage: RunStorage | None = None, solver: Any = None) -> None:
        self._storage = storage or RunStorage()
        self._stored = storage.stored(value_fingerprint(solver)) if storage else {}
        self._added: set[int] = set()
        self.write_due = self._storage.write_due

    def recall(self, number: int, start: Array) -> Outcome | None:
        """Return the stored outcome of a run; None without one.

        Raises
        ------
        RunStorageError
            If the run of this number began at another start.
        """
        stored_start, outcome = self._stored.get(number, (start, None))
        if np.array_equal(stored_start, start):
            return outcome
        # Where a continuation begins depends on the options: it is made again.
        if number < 0:
            return None
        raise RunStorageError(
            f"the stored runs began at other starts, from number {number} on: "
            "give the same rule and seed."
        )

    def keep(self, number: int, start: Array, outcome: Outcome) -> None:
        """Store a run, unless it is stored already, or has to be made again.

        Runs that were cut short have to be, and those that raised an error, whose cause may be gone
        the next time.
        """
        # A task may be looked at twice: when it is finished, and when its turn comes.
        is_new = number not in self._added and self.recall(number, start) is None
        is_whole = outcome.status not in CUT_SHORT and not has_raised(outcome.status)
        if is_new and is_whole:
            self._added.add(number)
            self._storage.add(number, start, outcome)
