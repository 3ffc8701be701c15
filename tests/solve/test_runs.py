"""Runs in columns are the runs that were put in, and take a fraction of their memory."""

import tracemalloc
from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from greybox.solve import runs as runs_module
from greybox.solve.runs import IMPROVED, POLISHED, SCREENED, Ended, Outcome, Run, Runs

LISTED = [
    Run(4, np.array([0.1, 0.2]), np.array([1.0, 2.0]), 0.5, "Solve_Succeeded", True, 7, 0.25),
    Run(
        6,
        np.array([0.3, 0.4]),
        np.array([3.0, 4.0]),
        np.inf,
        "cut",
        False,
        0,
        0.5,
        "no response",
        IMPROVED,
    ),
    Run(9, np.array([0.5, 0.6]), np.array([5.0, 6.0]), 1.5, SCREENED, False, 1, 0.75, "", SCREENED),
]


def require_same(found, wanted):
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted, strict=True):
        for name in (field.name for field in fields(Run)):
            assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("at_once", [1, 2, 4096])
def test_the_runs_are_those_that_were_put_in(monkeypatch, at_once):
    monkeypatch.setattr(runs_module, "AT_ONCE", at_once)
    runs = Runs.of(iter(LISTED))
    require_same(runs, LISTED)
    require_same([runs[k] for k in range(-3, 3)], LISTED + LISTED)
    require_same(runs[1:], LISTED[1:])
    require_same(runs[runs.cost < 2], [LISTED[0], LISTED[2]])
    require_same(runs[np.array([2, 0])], [LISTED[2], LISTED[0]])
    assert Runs.of(runs) is runs
    assert len(Runs.of([])) == 0
    assert isinstance(runs[0].iterations, int)
    assert isinstance(runs[0].converged, bool)
    for beyond in (3, -4):
        with pytest.raises(IndexError):
            runs[beyond]


def test_what_ended_is_numbered_in_its_order_and_converged_where_its_cost_is_finite():
    starts = np.arange(8.0).reshape(4, 2)
    ended = Ended(starts)
    for row, cost in ((3, 1.0), (1, np.inf)):
        ended.put(
            row,
            starts[row] + 0.5,
            Outcome(starts[row] + 10, "end", row, 0.1, True, cost, np.full(2, row)),
        )
    runs = ended.runs()
    assert_array_equal(runs.indices, [0, 1])
    assert_array_equal(runs.start, starts[[1, 3]] + 0.5)
    assert_array_equal(runs.estimate, starts[[1, 3]] + 10)
    assert_array_equal(runs.converged, [False, True])
    assert_array_equal(ended.runs(np.array([2.0, 3.0])).cost, [2, 3])

    ended.put(4, np.ones(2), Outcome(np.zeros(2), "elsewhere", 5, 0.1, True, 0.5, stage=POLISHED))
    assert_array_equal(ended.rows, [1, 3, 4])
    assert [None if s is None else s[0] for s in ended.signatures] == [None, 1, None, 3, None]
    every = ended.among_screened(
        ended.runs(np.array([2.0, 3.0, 0.5])), np.array([7.0, 8.0, 9.0, 10.0])
    )
    assert_array_equal(every.indices, range(5))
    assert_array_equal(every.cost, [7, 2, 9, 3, 0.5])
    assert_array_equal(every.start[[0, 2]], starts[[0, 2]])
    assert_array_equal(every.estimate[[0, 2]], starts[[0, 2]])
    assert list(every.stage) == [SCREENED, POLISHED, SCREENED, POLISHED, POLISHED]
    assert list(every.status) == [SCREENED, "end", SCREENED, "end", "elsewhere"]
    assert_array_equal(every.converged, [False, True, False, True, True])


def test_a_run_takes_less_than_a_quarter_of_a_kilobyte():
    starts = np.zeros((2000, 5))
    tracemalloc.start()
    ended = Ended(starts)
    for row, start in enumerate(starts):
        ended.put(
            row,
            start,
            Outcome(start + row, "Solve_Succeeded", 1000 + row, 0.1 * row, True, 0.3 * row),
        )
    runs = ended.runs()
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert used / len(runs) < 256
