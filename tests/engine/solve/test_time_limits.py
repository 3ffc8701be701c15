"""Runs and searches that are cut at a time limit, with a clock that goes on by a second at every look."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from sampled_lag import lag_problem

import greybox as gb
from greybox.engine.solve.interruption import end_after, is_search_over, limited, search_end

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
def test_a_fit_ends_with_what_it_has(clock, problem, method):
    found = gb.fit(problem, 10_000, method=method, seconds=60, progress=False)
    assert 1 <= len(found.runs) < 10_000
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


def test_a_limit_within_another_does_not_extend_it():
    with limited(50.0):
        for end in (40.0, 60.0):
            with limited(end):
                assert search_end() == min(end, 50.0)
    assert search_end() == math.inf


def test_what_is_no_time_is_refused():
    for seconds in (-1, "long"):
        with pytest.raises(ValueError, match=f"seconds={seconds!r} must be"):
            gb.fit(RECORD, 1, seconds=seconds)


def test_a_limit_is_reached_at_its_end(monkeypatch):
    """On a clock that stands at 100 s."""
    clock = SimpleNamespace(time=lambda: 100.0)
    monkeypatch.setattr("greybox.engine.solve.interruption.time", clock)
    assert (end_after(7), end_after(None)) == (107.0, math.inf)
    for end, over in ((100.1, False), (100.0, True), (99.9, True)):
        with limited(end):
            assert is_search_over() is over
