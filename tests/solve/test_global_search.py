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
from greybox.solve import global_search as module
from greybox.solve.global_search import _Filters, _ScatterSearch, global_search
from greybox.solve.ipopt import merits
from greybox.solve.outcome import SCREENED, Outcome

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
    filters = _Filters(threshold=5.0)
    filters.reached(np.array([2.0, 0]), np.array([0.0, 0]), 1.0)
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
    filters = _Filters(threshold=5.0)
    end = np.array([100.0, 0])
    filters.reached(end + np.array([4.0, 0]), end, 1.0)
    filters.reached(
        end + np.array([-2.0, 0]), end + np.array([0.05, 0]), 1.0
    )  # the same, from nearer
    assert [minimum[2] for minimum in filters.minima] == [4.0]
    filters.reached(end, end + np.array([0.2, 0]), 1.0)  # another, more than a thousandth away
    assert len(filters.minima) == 2
    filters.minima.pop()
    for turned_down in range(20):
        assert filters.minima[0][2] == 4.0, turned_down
        assert not filters.let_pass(end + np.array([2.9, 0]), 0.0)
    assert filters.minima[0][2] == pytest.approx(3.2)
    assert filters.let_pass(end + np.array([2.9, 0]), 0.0)
    assert filters.threshold == 0.0  # that of the last start
    assert not filters.let_pass(end + np.array([2.9, 0]), 1e-9)


def scatter(drawn, low=-10.0, high=10.0):
    """Trial points of a problem whose variables are those of the solver."""
    same = SimpleNamespace(to_solver=np.asarray)
    nlp = SimpleNamespace(scaling=same, lower=np.full(2, low), upper=np.full(2, high))
    return _ScatterSearch(nlp, np.asarray(drawn), lambda z: float(z @ z), np.random.default_rng(0))


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


def test_the_worst_of_the_reference_set_makes_room_for_a_better_point_that_is_new():
    search = scatter(np.zeros((5, 2)))
    search._references = [
        (1.0, np.array([1.0, 0])),
        (4.0, np.array([2.0, 0])),
        (9.0, np.array([3.0, 0])),
    ]
    assert not search._improved(0.0, np.array([1.0, 5e-7]))  # known
    assert not search._improved(9.0, np.array([0.0, 3.0]))  # no better
    assert search._improved(0.0, np.array([0.0, 0.0]))
    assert sorted(value for value, _ in search._references) == [0, 1, 4]


def test_when_all_drawn_points_are_used_it_goes_on_around_the_best():
    search = scatter(np.random.default_rng(1).uniform(2, 10, (30, 2)), low=1.0, high=11.0)
    search._references = [
        (9.0, np.array([9.0, 9.0])),
        (4.0, np.array([4.0, 4.0])),
        (16.0, np.array([5.0, 5.0])),
    ]
    drawn = list(islice(search._renewed(), 20))
    assert len(drawn) == len({tuple(z) for z, _ in drawn}) == 20
    list(islice(search._drawn, 10))
    search._references = [
        (9.0, np.array([9.0, 9.0])),
        (4.0, np.array([4.0, 4.0])),
        (16.0, np.array([5.0, 5.0])),
    ]
    around = np.array([z for z, _ in search._renewed()])
    assert len(around) == 20
    assert np.median(around, axis=0) == pytest.approx(4.0, abs=1.0)  # a tenth of the box is one
    assert np.std(around) == pytest.approx(1.0, abs=0.3)
    assert len(search._references) == 10


@pytest.mark.parametrize(("count", "first"), [(50, 10), (4, 1)])
def test_of_the_first_fifth_the_best_is_run_and_later_what_the_filters_let_pass(
    monkeypatch, count, first
):
    """Of two wells, whose ends are known; the merit is the cost at the start, and 7 more."""
    wells = np.array([[2.0, 2.0], [-3.0, -1.0]])
    monkeypatch.setattr(module, "packed", None)
    monkeypatch.setattr(
        module, "merits", lambda nlp, z: 7 + ((z.T[:, None] - wells) ** 2).sum(axis=2).min(axis=1)
    )
    same = SimpleNamespace(to_solver=np.asarray, to_parameters=np.asarray)
    nlp = SimpleNamespace(
        scaling=same,
        lower=np.full(2, -5.0),
        upper=np.full(2, 5.0),
        parts=[SimpleNamespace(is_likelihood=False, numbers=9)],
    )
    ran = []

    class Solver:
        def run(self, start):
            ran.append(start)
            well = int(np.argmin(((wells - start) ** 2).sum(axis=1)))
            return Outcome(wells[well], "there", 5, 0.1, True, 7.0 + well, np.array([float(well)]))

        def judged_run(self, outcome):
            return outcome

    drawn, seen = np.random.default_rng(3).uniform(-5, 5, (count, 2)), []
    found = global_search(nlp, Solver(), drawn, seed=2, progress=lambda *now: seen.append(now))
    assert seen == [(k + 1, count) for k in range(count)]
    np.testing.assert_array_equal(found.runs.start[:first], drawn[:first])
    turned_down = found.runs.stage == SCREENED
    assert (~turned_down).sum() == len(ran)
    at_start = 7 + ((found.runs.start[:, None] - wells) ** 2).sum(axis=2).min(axis=1)
    assert found.runs.cost[turned_down] == pytest.approx(at_start[turned_down])
    np.testing.assert_array_equal(found.runs.estimate[turned_down], found.runs.start[turned_down])
    assert np.flatnonzero(~turned_down[:first]).tolist() == [np.argmin(at_start[:first])]
    assert not found.runs.converged[turned_down].any()
    if count == 50:
        assert [m.cost for m in found.minima] == [7.0, 8.0]
        # As the filters say, told of the same runs.
        filters = _Filters(threshold=at_start[:first].min())
        filters.reached(ran[0], found.runs.estimate[~turned_down][0], 0.0)
        for k in range(first, count):
            passes = filters.let_pass(found.runs.start[k], at_start[k])
            assert passes == (not turned_down[k]), k
            if passes:
                filters.reached(found.runs.start[k], found.runs.estimate[k], 0.0)


def test_merits_are_costs_with_a_penalty_on_missed_constraints():
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.05)
    problem = gb.Problem(LagLagDelay(), data, constraints=[lambda p: p.K - 4])
    nlp = compile_problem(problem)
    x = np.array([[5.0, 0.5, 0.2, 0.1], [3.5, 0.5, 0.2, 0.1]])
    costs = [gb.cost(problem, dict(zip(nlp.free, row, strict=True))) for row in x]
    wanted = [costs[0], costs[1] + 1e3 * 0.5]
    assert merits(nlp, nlp.scaling.to_solver(x).T) == pytest.approx(wanted, rel=1e-3)
