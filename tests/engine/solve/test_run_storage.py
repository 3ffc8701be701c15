"""What a search remembers of an earlier one, and what it hands on."""

from dataclasses import replace

import numpy as np
import pytest

from greybox.engine.solve.run_storage import Memory, RunStorage, RunStorageError
from greybox.engine.solve.runs import INTERRUPTED, SEARCH_OVER, Outcome
from greybox.modeling.fingerprint import value_fingerprint

START = np.array([1.0, 2.0])
DONE = Outcome(START + 1, "done", 3, 10.0, converged=True)


class Listed(RunStorage):
    def __init__(self, before):
        self.before, self.added, self.looked, self.names = before, [], 0, []

    def stored(self, fingerprint):
        self.names.append(fingerprint)
        return self.before

    def add(self, number, start, outcome):
        self.added.append((number, start, outcome))

    def write_due(self):
        self.looked += 1


def test_a_run_is_recalled_by_its_number_and_start():
    storage = Listed({4: (START, DONE), -2: (START, DONE)})
    memory = Memory(storage, "of this problem")
    assert storage.names == [value_fingerprint("of this problem")]
    assert memory.recall(4, START.copy()) is DONE
    assert memory.recall(5, START) is None
    assert memory.recall(-2, START) is DONE
    assert (
        memory.recall(-2, START + 1e-9) is None
    )  # elsewhere than a start: a neighborhood that has changed
    with pytest.raises(
        RunStorageError,
        match="began at other starts, from number 4 on: give the same rule and seed",
    ):
        memory.recall(4, START + 1e-9)
    number_zero = Memory(Listed({0: (START, DONE)}))
    with pytest.raises(RunStorageError, match="from number 0 on"):
        number_zero.recall(0, START + 1)
    memory.write_due()
    assert storage.looked == 1


def test_what_is_new_and_finished_is_kept():
    storage = Listed({4: (START, DONE)})
    memory = Memory(storage)
    for number, status in (
        (4, "done"),
        (5, "done"),
        (6, INTERRUPTED),
        (7, SEARCH_OVER),
        (8, "stagnated"),
    ):
        memory.keep(number, START, replace(DONE, status=status))
    assert [number for number, _, _ in storage.added] == [5, 8]
    nothing = Memory()
    nothing.keep(1, START, DONE)
    nothing.write_due()
    assert nothing.recall(1, START) is None
