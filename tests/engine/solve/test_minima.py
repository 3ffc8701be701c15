"""What runs are one minimum, which agree with the best, and what is said of those that did not converge."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from greybox.engine.solve.minima import (
    Minimum,
    Multistart,
    agreeing_runs,
    best_unfinished,
    find_minima,
    same_cost,
)
from greybox.engine.solve.runs import SCREENED, TOO_COARSE, Run, Runs


def problem(*, is_likelihood=True, numbers=(40, 60)):
    """Whose variables are those of the solver."""
    parts = [
        SimpleNamespace(
            is_likelihood=is_likelihood and k == 1,
            numbers=n,
        )
        for k, n in enumerate(numbers)
    ]
    scaling = SimpleNamespace(to_solver=np.asarray)
    return SimpleNamespace(
        parts=parts, parts_of=lambda kind: [], scaling=scaling, numbers=sum(numbers)
    )


def run_to(index, cost, x=(1.0, 2.0), status="converged", **more):
    converged = status == "converged"
    return Run(
        index, np.zeros(2), np.array(x, dtype=float), cost, status, converged, 3, 0.1, **more
    )


@pytest.mark.parametrize(
    ("is_likelihood", "best", "same"),
    [
        (True, 0.0, 1e-2),
        (True, -1e6, 1e-2 + 0.1),
        (False, 50.0, 5e-3),
        (
            False,
            0.0,
            1e-4 * 5e-4 * 100,
        ),  # of costs of rounding size, what the smoothing leaves of 100 numbers
    ],
)
def test_costs_are_the_same_within_a_hundredth_of_a_likelihood_or_what_the_smoothing_moves(
    is_likelihood, best, same
):
    assert same_cost(problem(is_likelihood=is_likelihood), best) == pytest.approx(same)


def test_runs_of_the_same_cost_and_response_are_one_minimum_whatever_their_parameters():
    response, other = np.array([4.0, 0.1, -0.2]), np.array([4.0, 0.1, 0.8])
    costs = [5.0, 3.005, 3.0, 3.0, 3.02, math.inf, 3.001]
    ends = [(1, 2), (1, 2), (2, 1), (1.01, 2.02), (1, 2), (1, 2), (1, 2)]
    runs = [
        run_to(k, cost, x, "converged" if k != 5 else "lost")
        for k, (cost, x) in enumerate(zip(costs, ends, strict=True))
    ]
    signatures = [response, response * [1.01, 1, 1], response, response, response, None, other]
    for given in (
        signatures,
        np.array([np.full(3, np.nan) if s is None else s for s in signatures]),
    ):
        found = find_minima(problem(), runs, given)
        assert [(m.cost, m.runs, m.variants) for m in found] == [
            (
                3.0,
                (2, 3, 1),
                2,
            ),  # two lags that swap are two; a hundredth of the response is no difference
            (3.001, (6,), 1),  # as good, and another response
            (3.02, (4,), 1),
            (5.0, (0,), 1),
        ]
        assert found[0].estimate.tolist() == [2, 1]
    assert find_minima(problem(), runs[5:6], signatures) == ()


@pytest.mark.parametrize(("off", "alike"), [(0.0099, True), (0.0101, False)])
def test_responses_agree_within_a_hundredth_of_the_data_or_of_themselves(off, alike):
    """Signatures come in units of the measured signals, of which those above one are larger than the data."""
    for reference in (np.array([50.0, -50.0]), np.array([0.5, 0.0])):
        away = reference + off * np.maximum(np.abs(reference), 1.0) * [1, -1]
        found = find_minima(problem(), [run_to(0, 1.0), run_to(1, 1.0)], [reference, away])
        assert len(found) == (1 if alike else 2)


@pytest.mark.parametrize(
    ("x", "variants"),
    [((1.0, 2.11), 2), ((1.0, 2.09), 1), ((-1.0, 2.0), 2), ((0.949, 2.0), 2), ((0.951, 2.0), 1)],
)
def test_ends_more_than_a_twentieth_of_the_larger_one_apart_are_variants(x, variants):
    runs = [run_to(0, 1.0), run_to(1, 1.0, x), run_to(2, 1.0, x)]
    (found,) = find_minima(problem(), runs, [np.ones(2)] * 3)
    mirrored = [run_to(run.index, 1.0, -run.estimate) for run in runs]
    assert (
        found.variants == find_minima(problem(), mirrored, [np.ones(2)] * 3)[0].variants == variants
    )
    assert f"{variants} variant{'s' if variants > 1 else ''}" in repr(found)


@pytest.mark.parametrize(
    ("is_likelihood", "best", "limit"),
    [(True, -200.0, 0.1), (False, 8.0, 0.1 * 8 / 40), (False, -8.0, 0.1 * 8 / 40)],
)
def test_runs_agree_up_to_a_tenth_of_a_unit_of_log_likelihood(is_likelihood, best, limit):
    costs = [best, best + 0.99 * limit, best + 1.01 * limit, best + 0.5 * limit, best + 9 * limit]
    runs = [
        run_to(10 + k, cost, status="lost" if k == 3 else "converged")
        for k, cost in enumerate(costs)
    ]
    minima = [Minimum(best, np.zeros(2), (10, 14), 1), Minimum(best + 1, np.zeros(2), (12,), 1)]
    nlp = problem(is_likelihood=is_likelihood, numbers=(15, 25))
    assert agreeing_runs(nlp, runs, minima) == (10, 11, 14)
    assert agreeing_runs(nlp, runs, []) == ()


def test_the_best_run_that_did_not_converge_went_on_from_its_start_if_any_did():
    ended = [
        run_to(0, 1.0),
        run_to(1, 2.0, status=TOO_COARSE),
        run_to(2, 3.0, status="screened", stage=SCREENED),
        run_to(3, 5.0, status="lost"),
        run_to(4, 4.0, status="iterations exceeded"),
        run_to(5, math.inf, status="lost"),
    ]
    assert best_unfinished(ended).index == 4
    assert best_unfinished(ended[:3]).index == 2
    assert best_unfinished(ended[:2]) is None


def test_what_failed_is_counted_by_its_reason_but_not_what_was_left_out():
    runs = [
        run_to(0, 1.0),
        run_to(1, math.inf, status="lost"),
        run_to(2, math.inf, status="lost"),
        run_to(3, math.inf, status="not finite", reason="at t = 3 s"),
        run_to(4, math.inf, status="lost", stage=SCREENED),
    ]
    search = Multistart(Runs.of(runs), (Minimum(1.0, np.zeros(2), (0,), 1),))
    assert search.failures == "2 × lost, 1 × not finite (at t = 3 s)"
    assert (search.converged, len(search.brought)) == (1, 4)
    assert "1 of 4 runs converged, 1 minimum" in repr(search)


@pytest.mark.parametrize("rounding", [-1e-13, 1e-13])
def test_the_first_start_decides_between_equivalent_estimates_of_equal_cost(rounding):
    """And of its own kind the lowest cost is reported."""
    ends = [(1, 2), (2, 1), (1.001, 2)]
    costs = [3.0, 3.0 + rounding, 3.0 - 1e-12]
    runs = [run_to(k, cost, x) for k, (cost, x) in enumerate(zip(costs, ends, strict=True))]
    (minimum,) = find_minima(problem(), runs, [np.ones(2)] * 3)
    assert minimum.runs[0] == 2
    assert minimum.estimate.tolist() == [1.001, 2]
    assert minimum.variants == 2


def test_runs_of_which_none_was_made_or_converged_have_no_minima():
    assert find_minima(problem(), [], []) == ()
    assert find_minima(problem(), [run_to(0, 1.0, status="lost")], [np.ones(2)]) == ()
