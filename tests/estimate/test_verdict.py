"""The verdict says what a careful reader of the result would."""

from dataclasses import replace

import pytest
from page_results import lag

from greybox.estimate.verdict import verdict


@pytest.fixture(scope="module")
def fit():
    return lag()


def test_a_good_fit_in_three_sentences(fit):
    good = replace(fit, warnings=())
    judged = verdict(good)
    assert judged.grade == "good"
    assert judged.sentences[0] == "3 of 3 starts agree on the best minimum."
    assert "of the standard deviation of y" in judged.sentences[1]
    assert judged.sentences[2].startswith("All 2 free parameters are well determined, with standard errors of at most ")


@pytest.mark.parametrize("count", [1, 2])
def test_a_minimum_that_was_found_once_is_in_doubt(fit, count):
    first, *others = fit.runs
    runs = (first, *(replace(run, cost=run.cost + 5) for run in others[: count - 1]))
    minima = (replace(fit.minima[0], runs=(first.index,), cost=first.cost),)
    judged = verdict(replace(fit, warnings=(), runs=runs, minima=minima))
    assert judged.grade == "doubt"
    assert "another" in judged.sentences[0]


def test_what_is_not_determined_is_named(fit):
    shaky = replace(fit, directions=replace(fit.directions, covariance=fit.directions.covariance * 1e4), warnings=())
    judged = verdict(shaky)
    assert judged.grade == "doubt"
    assert "0 are well determined: b0 and a0 are beyond the guidelines (20 % error" in judged.sentences[2]

    bound = tuple(replace(q, at_bound=q.name == "a0") for q in fit.quantities)
    assert "a0 ended at a bound" in verdict(replace(fit, quantities=bound, warnings=())).sentences[2]


def test_a_failed_fit_has_no_estimate(fit):
    runs = tuple(replace(run, converged=False, status="Maximum_Iterations_Exceeded") for run in fit.runs)
    judged = verdict(replace(fit, runs=runs, minima=()))
    assert judged.grade == "failed"
    assert judged.sentences[0].startswith("There is no estimate: no start converged")
