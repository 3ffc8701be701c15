"""The scatter search that the paper was made by: few runs of the solver, the same minima."""

import time
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from numpy.testing import assert_array_equal
from sampled_lag import lag_problem

import greybox as gb
from greybox.compiled.compiled_problem import compile_problem
from greybox.problems import pitch_hover
from greybox.solve.global_search import Filters, ScatterSearch
from greybox.solve.ipopt import merits

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=2)


def test_the_minimum_of_the_paper_is_found_with_few_runs():
    fit = gb.fit(pitch_hover.problem(), 400, search="global-search", progress=False)
    wanted = gb.fit(pitch_hover.problem(), 20, search="multistart", progress=False)
    assert fit.cost == pytest.approx(wanted.cost, rel=1e-8)
    stages = [run.stage for run in fit.runs]
    assert len(stages) == 400
    assert 1 <= stages.count("polished") < 80
    at_start = [
        gb.cost(pitch_hover.problem(), dict(zip(fit.free, run.start, strict=True)))
        for run in fit.runs[:80]
    ]
    assert [k for k in range(80) if stages[k] == "polished"] == [
        np.argmin(at_start)
    ]  # the best of the first stage
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
    filters = Filters(threshold=5.0)
    filters.reached(np.array([2.0, 0]), np.array([0.0, 0]))
    assert not filters.let_pass(np.array([1.4, 0]), 0.0)  # within three quarters of the distance
    assert filters.let_pass(np.array([1.6, 0]), 4.0)
    for _ in range(
        20
    ):  # the threshold is that of the last start; the twentieth raises it by a fifth of 1 + 4
        assert not filters.let_pass(np.array([9.0, 0]), 4.5)
    assert filters.let_pass(np.array([9.0, 0]), 4.9)


def test_what_it_cannot_do_is_refused():
    with pytest.raises(ValueError, match="for frequency responses alone"):
        gb.fit(lag_problem(), search="global-search")
    with gb.solve.WorkerPool(1) as pool, pytest.raises(ValueError, match="leave out the executor"):
        gb.fit(gb.Problem(LagLagDelay(), DATA), search="global-search", executor=pool)


def test_a_minimum_that_claims_too_large_a_region_gives_a_fifth_of_it_back():
    filters = Filters(threshold=5.0)
    end = np.array([100.0, 0])
    filters.reached(end + np.array([4.0, 0]), end)
    # The same minimum, from nearer; then another one, more than a thousandth away.
    filters.reached(end + np.array([-2.0, 0]), end + np.array([0.05, 0]))
    assert [region.radius for region in filters.regions] == [4.0]
    filters.reached(end, end + np.array([0.2, 0]))
    assert len(filters.regions) == 2
    filters.regions.pop()
    for turned_down in range(20):
        assert filters.regions[0].radius == 4.0, turned_down
        assert not filters.let_pass(end + np.array([2.9, 0]), 0.0)
    assert filters.regions[0].radius == pytest.approx(3.2)
    assert filters.let_pass(end + np.array([2.9, 0]), 0.0)
    assert filters.threshold == 0.0  # that of the last start
    assert not filters.let_pass(end + np.array([2.9, 0]), 1e-9)


def scatter(drawn, low=-10.0, high=10.0):
    """Trial points of a problem whose variables are those of the solver."""
    same = SimpleNamespace(to_solver=np.asarray)
    nlp = SimpleNamespace(scaling=same, lower=np.full(2, low), upper=np.full(2, high))
    return ScatterSearch(nlp, np.asarray(drawn), lambda z: float(z @ z), np.random.default_rng(0))


def test_the_reference_set_has_the_best_points_and_those_farthest_from_all_in_it():
    drawn = np.random.default_rng(1).uniform(-10, 10, (100, 2))
    search = scatter(drawn)
    trials = list(islice(search.points(), 23))
    assert_array_equal([z for z, _ in trials[:20]], drawn[:20])  # a fifth of them
    assert [value for _, value in trials[:20]] == pytest.approx((drawn[:20] ** 2).sum(axis=1))
    order = np.argsort((drawn[:20] ** 2).sum(axis=1))
    chosen = list(order[:5])
    for _ in range(5):
        away = [min(np.linalg.norm(drawn[k] - drawn[c]) for c in chosen) for k in range(20)]
        chosen.append(int(np.argmax(away)))
    one, other = drawn[chosen[0]], drawn[chosen[1]]
    # Of the first pair, one beyond either point and one between them, up to half of their distance
    # away.
    for (z, value), origin, side in zip(trials[20:], (one, one, other), (-1, 1, 1), strict=True):
        share = (z - origin) @ (other - one) / ((other - one) @ (other - one))
        assert np.allclose(z, origin + share * (other - one))
        assert 0 < side * share < 0.5
        assert value == pytest.approx(z @ z)


def test_merits_are_costs_with_a_penalty_on_missed_constraints():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.05)
    problem = gb.Problem(LagLagDelay(), data, constraints=[lambda p: p.K - 4])
    nlp = compile_problem(problem)
    x = np.array([[5.0, 0.5, 0.2, 0.1], [3.5, 0.5, 0.2, 0.1]])
    costs = [gb.cost(problem, dict(zip(nlp.free, row, strict=True))) for row in x]
    wanted = [costs[0], costs[1] + 1e3 * 0.5]
    assert merits(nlp, nlp.scaling.to_solver(x).T) == pytest.approx(wanted, rel=1e-3)


def test_when_all_drawn_points_are_used_trial_points_come_from_around_the_best():
    search = scatter(np.random.default_rng(1).uniform(2, 10, (30, 2)), low=1.0, high=11.0)
    trials = list(islice(search.points(), 2000))
    z = np.array([z for z, _ in trials])
    assert z.min() >= 1.0
    assert z.max() <= 11.0
    best_drawn = min(value for _, value in trials[:30])
    assert min(value for _, value in trials[30:]) < 0.9 * best_drawn
    assert len({tuple(point) for point in z[-300:]}) > 100
