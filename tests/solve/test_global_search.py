"""The scatter search that the paper was made by: few runs of the solver, the same minima."""

import time

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.problems import pitch_hover
from greybox.solve.global_search import _Filters

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)


def test_the_minimum_of_the_paper_is_found_with_few_runs():
    fit = gb.fit(pitch_hover.problem(), 400, search="global-search", progress=False)
    wanted = gb.fit(pitch_hover.problem(), 20, search="multistart", progress=False)
    assert fit.cost == pytest.approx(wanted.cost, rel=1e-8)
    stages = [run.stage for run in fit.runs]
    assert len(stages) == 400
    assert 1 <= stages.count("polished") < 80
    at_start = [gb.cost(pitch_hover.problem(), dict(zip(fit.free, run.start, strict=True))) for run in fit.runs[:80]]
    assert [k for k in range(80) if stages[k] == "polished"] == [np.argmin(at_start)]  # the best of the first stage
    again = gb.fit(pitch_hover.problem(), 400, search="global-search", progress=False)
    for run, same in zip(fit.runs, again.runs, strict=True):
        assert_array_equal(run.start, same.start)


@pytest.mark.parametrize("search", ["batched", "multistart", "global-search"])
def test_the_time_that_is_told_passed_within_the_call(search):
    began = time.perf_counter()
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), 20, search=search, progress=False)
    assert 0 < fit.seconds <= time.perf_counter() - began
    assert all(0 <= run.seconds <= fit.seconds for run in fit.runs)


def test_constraints_hold():
    ordered = gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p.T1 - p.T2])
    fit = gb.fit(ordered, 200, search="global-search", progress=False)
    assert fit.estimate["T1"] >= fit.estimate["T2"]
    assert fit.cost == pytest.approx(gb.fit(ordered, 20, progress=False).cost, rel=1e-7)


def test_starts_near_a_minimum_that_was_reached_from_farther_are_turned_down():
    filters = _Filters(threshold=5.0)
    filters.reached(np.array([2.0, 0]), np.array([0.0, 0]), 1.0)
    assert not filters.let_pass(np.array([1.4, 0]), 0.0)  # within three quarters of the distance
    assert filters.let_pass(np.array([1.6, 0]), 4.0)
    for _ in range(20):  # the threshold is that of the last start; the twentieth raises it by a fifth of 1 + 4
        assert not filters.let_pass(np.array([9.0, 0]), 4.5)
    assert filters.let_pass(np.array([9.0, 0]), 4.9)


def test_what_it_cannot_do_is_refused():
    with pytest.raises(ValueError, match="for frequency responses alone"):
        gb.fit(lag_problem(), search="global-search")
    with gb.solve.WorkerPool(1) as pool, pytest.raises(ValueError, match="leave out the executor"):
        gb.fit(gb.Problem(LagLagDelay(), DATA), search="global-search", executor=pool)
