"""Runs in columns are the runs that were put in, and take a fraction of their memory."""

import tracemalloc
from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from greybox.engine.solve.runs import IMPROVED, POLISHED, SCREENED, Outcome, Run, Runs

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


def test_the_runs_are_those_that_were_put_in():
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


def test_a_run_converged_only_where_its_cost_is_finite():
    end = Outcome(np.ones(2), "end", 3, 0.1, True, np.inf, stage=POLISHED)
    run = end.as_run(5, np.zeros(2))
    assert (run.index, run.status, run.iterations, run.stage) == (5, "end", 3, POLISHED)
    assert not run.converged
    assert_array_equal(run.start, [0, 0])


def test_a_run_takes_less_than_a_quarter_of_a_kilobyte():
    starts = np.zeros((2000, 5))
    tracemalloc.start()
    runs = Runs.of(
        Run(k, start, start + k, 0.3 * k, "Solve_Succeeded", True, 1000 + k, 0.1 * k)
        for k, start in enumerate(starts)
    )
    used, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert used / len(runs) < 256
