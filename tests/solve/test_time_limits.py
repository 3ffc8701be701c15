"""Runs and searches that are cut at a time limit, with a clock that goes on by a second at every look."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from sampled_lag import lag_problem

import greybox as gb
from greybox.solve.interruption import (
    TimeLimits,
    current_limits,
    is_run_over,
    is_search_over,
    limited,
    one_run,
)
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.runs import RUN_OVER, Outcome

OMEGA = np.geomspace(0.1, 10, 8)


class Valley(gb.TransferFunction):
    """A gain with two kinks that meet in a valley, as of a table that is interpolated."""

    a = gb.Parameter(3.3, bounds=(-5, 5))
    b = gb.Parameter(-2.0, bounds=(-5, 5))

    def response(self, s, p):
        return (abs(p.a - 1) + abs(p.a - p.b) + 1) / (s + 1)


VALLEY = gb.Problem(Valley(), gb.FrequencyResponse(OMEGA, 0.5 / (1j * OMEGA + 1)))
RECORD = lag_problem(samples=100)
METHODS = [
    pytest.param(VALLEY, None, id="response"),
    pytest.param(RECORD, None, id="record"),
    pytest.param(RECORD, gb.Collocation(), id="record by IPOPT"),
]


def test_a_run_that_makes_no_progress_ends():
    """At a kink IPOPT goes to and fro."""
    found = gb.fit(VALLEY, [{}], progress=False)
    assert found.runs[0].status == "stagnated"
    assert 80 < found.runs[0].iterations < 400
    assert not found.converged


@pytest.mark.parametrize(("problem", "method"), METHODS)
def test_a_start_is_cut_and_the_others_are_tried(clock, problem, method):
    found = gb.fit(problem, 3, method=method, start_seconds=2.5, progress=False)
    assert [run.status for run in found.runs] == [RUN_OVER] * 3
    assert all(run.iterations <= 3 for run in found.runs)
    assert "3 of 3 starts were cut at 2.5 s, the time limit of a start" in found.warnings[0]
    assert not found.converged


@pytest.mark.parametrize(("problem", "method"), METHODS)
def test_a_fit_ends_with_what_it_has(clock, problem, method):
    found = gb.fit(problem, 10_000, method=method, seconds=200, progress=False)
    assert 1 <= len(found.runs) < 10_000
    assert found.runs[-1].status != RUN_OVER
    assert found.warnings[0].startswith("the time limit ended the search after")
    assert "a faster machine may answer otherwise" in found.warnings[0]
    assert found.converged == any(run.converged for run in found.runs)


def test_without_time_there_is_a_run_all_the_same(clock):
    found = gb.fit(RECORD, 5, seconds=1e-6, progress=False)
    assert [(run.status, run.iterations) for run in found.runs] == [("time limit of the fit", 0)]
    assert not found.converged


def test_enough_time_changes_nothing():
    limited_fit, free = (
        gb.fit(RECORD, 3, progress=False, **limit) for limit in ({"seconds": 1e6}, {})
    )
    assert [run.cost for run in limited_fit.runs] == [run.cost for run in free.runs]
    assert limited_fit.warnings == free.warnings


def test_the_limits_of_a_batch_hold_within_those_of_a_fit():
    with limited(TimeLimits(start=3, end=50)), limited(TimeLimits(end=40)):
        assert current_limits() == TimeLimits(start=3, end=40)
    assert current_limits() == TimeLimits()


def test_a_run_that_was_cut_is_made_again_with_more_time():
    class Kept(KeptRuns):
        def known(self, fingerprint):
            cut = Outcome(np.ones(1), RUN_OVER, 4, 2.1, converged=False, cost=1.0)
            return {0: (np.zeros(1), cut)}

        def add(self, number, start, outcome):
            raise AssertionError

        def look(self):
            pass

    memory = Memory(Kept())
    with limited(TimeLimits(start=2.0)):
        assert memory.recall(0, np.zeros(1)) is not None
    assert memory.recall(0, np.zeros(1)) is None


def test_what_is_no_time_is_refused():
    with pytest.raises(ValueError, match="seconds=-1 must be"):
        gb.fit(RECORD, 1, seconds=-1)
    with pytest.raises(ValueError, match="start_seconds='long'"):
        gb.fit(RECORD, 1, start_seconds="long")


def test_limits_are_reached_at_their_end(monkeypatch):
    """On a clock that stands at 100 s until it is set.

    Of three starts at once of 5 s each, of which 2 s are spent.
    """
    now = [100.0]
    monkeypatch.setattr("greybox.solve.interruption.time", SimpleNamespace(time=lambda: now[0]))
    assert TimeLimits.from_now(7, None) == TimeLimits(math.inf, 107.0)
    assert TimeLimits.from_now(None, 3) == TimeLimits(3, math.inf)
    for end, over in ((100.1, False), (100.0, True), (99.9, True)):
        with limited(TimeLimits(end=end)):
            assert is_search_over() is over
    with limited(TimeLimits(start=5.0)), one_run(spent=2.0, starts=3):
        for now[0], over in ((112.9, False), (113.0, True)):
            assert is_run_over() is over
        now[0] = 100.0
        with one_run(starts=9):  # no longer than what is around it
            now[0] = 113.0
            assert is_run_over()
        now[0] = 112.0
        assert not is_run_over()
    now[0] = 1e9
    assert not is_run_over()
    with limited(TimeLimits(4.0, 20.0)), limited(TimeLimits(6.0, 10.0)):
        assert current_limits() == TimeLimits(4.0, 10.0)
    assert current_limits() == TimeLimits()
