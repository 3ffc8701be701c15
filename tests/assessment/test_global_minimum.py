"""What is said of other minima."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.assessment.checks.discontinuous_cost import discontinuous_cost
from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.checks.few_agreeing_starts import few_agreeing_starts
from greybox.assessment.checks.rival_minima import rival_minima
from greybox.assessment.checks.several_estimates import several_estimates
from greybox.assessment.checks.unfinished_runs import unfinished_runs
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.solve.runs import TOO_COARSE, Run
from greybox.models.rate import DampedRate
from greybox.problems import pitch_hover


def said(is_likelihood, *costs, error=0.1):
    nlp = SimpleNamespace(
        parts=[SimpleNamespace(is_likelihood=is_likelihood)], free=("a",), names=("a",), numbers=48
    )
    minima = [SimpleNamespace(cost=c, estimate=np.array([float(k)])) for k, c in enumerate(costs)]
    accuracy = Accuracy(
        nlp,
        minima[0].estimate,
        (),
        covariance=np.array([[error**2]]),
        blind=np.zeros((1, 0)),
        size=np.ones(1),
        dof=40.0,
        bias=np.zeros(1),
        systematic=np.zeros((1, 0)),
    )
    found = SimpleNamespace(minima=minima)
    evidence = Evidence(SimpleNamespace(found=found), accuracy, None)
    return [finding.text for finding in rival_minima(evidence)]


@pytest.mark.parametrize(
    ("is_likelihood", "costs", "rivals"),
    [
        (True, (-10.0, -9.0), 1),  # e times less likely
        (True, (-10.0, 0.0), 0),  # e¹⁰ = 22026 times
        (False, (1.0, 1.005), 1),
        (False, (1.0, 2.0), 0),
        (False, (1.0,), 0),
    ],
)
def test_minima_that_the_data_hardly_tell_apart_are_named(is_likelihood, costs, rivals):
    assert len(said(is_likelihood, *costs)) == rivals


@pytest.mark.parametrize(
    ("is_likelihood", "costs", "rival"),
    [
        (
            True,
            (-10.0, -7.1),
            "another minimum with a different response has 0.055 times the likelihood: a = 1.",
        ),
        (True, (-10.0, -6.9), ""),
        (
            True,
            (-10.0, -8.0, -7.5),
            "another minimum with a different response has 0.14 times the likelihood: a = 1.",
        ),
        (
            False,
            (2.0, 2.12),
            "another minimum with a different response has 0.056 times the likelihood: a = 1.",
        ),
        (False, (2.0, 2.13), ""),
    ],
)
def test_a_rival_is_within_three_units_of_log_likelihood(is_likelihood, costs, rival):
    """A unit is 1/48 of the cost of 48 relative errors of unknown size."""
    assert said(is_likelihood, *costs) == ([rival] if rival else [])


def test_a_rival_within_a_standard_error_needs_no_words():
    assert [len(said(True, -10.0, -9.9, error=error)) for error in (0.9, 1.1, np.nan)] == [1, 0, 1]


@pytest.mark.parametrize(
    ("agreeing", "converged", "count", "texts"),
    [
        (
            1,
            1,
            1,
            ["one start only: another minimum may be lower; use more starts."],
        ),
        (
            1,
            9,
            9,
            [
                "only 1 of 9 starts reached the best minimum: a better one may exist; use more starts."
            ],
        ),
        (2, 20, 20, []),
        (
            2,
            21,
            21,
            [
                "only 2 of 21 starts reached the best minimum: a better one may exist; use more starts."
            ],
        ),
        (4, 5, 10, []),
        (4, 4, 10, ["only 4 of 10 runs converged (6 failed)."]),
    ],
)
def test_a_tenth_of_the_starts_shall_agree_and_a_half_converge(agreeing, converged, count, texts):
    runs = [None] * count
    search = SimpleNamespace(
        brought=runs,
        runs=runs,
        minima=[SimpleNamespace(cost=1.0)],
        converged=converged,
        failures=f"{count - converged} failed",
    )
    evidence = Evidence(SimpleNamespace(found=search), None, SimpleNamespace(agreeing=agreeing))
    assert [finding.text for finding in few_agreeing_starts(evidence)] == texts


def test_the_lowest_end_that_did_not_converge_is_named():
    def run(index, cost, status="iterations exceeded", converged=False):
        return Run(index, np.zeros(1), np.zeros(1), cost, status, converged)

    brought = [
        run(0, 5.0, "converged", True),
        run(1, 4.5),
        run(2, 4.25),
        run(3, 5.5),
        run(4, 1.0, TOO_COARSE),
    ]

    def lowest(cost):
        found = SimpleNamespace(minima=[SimpleNamespace(cost=cost)], brought=brought)
        return [*unfinished_runs(Evidence(SimpleNamespace(found=found), None, None))]

    (finding,) = lowest(5.0)
    assert finding.text.startswith(
        "run 2 ended at a lower cost, 4.25 instead of 5, but did not converge (iterations exceeded):"
    )
    assert not lowest(4.25)


def test_delays_at_which_the_cost_jumps_are_named_once_each():
    parts = [
        SimpleNamespace(delays={"tau": ("u", "y"), "known": ("w", "z"), "k": ("u", "")}),
        SimpleNamespace(delays={"tau": ("u", "y")}),
    ]
    nlp = SimpleNamespace(parts=parts, free=["k", "tau"])
    (finding,) = discontinuous_cost(SimpleNamespace(nlp=nlp))
    for words in ("held input u reaches y", "discontinuous where tau", "standard error of tau"):
        assert words in finding.text


@pytest.mark.parametrize(
    ("variants", "combinations", "count"), [(1, (), 0), (2, (), 1), (2, ("a/b",), 0)]
)
def test_several_estimates_are_told_where_no_combination_is(variants, combinations, count):
    scaling = SimpleNamespace(to_solver=lambda estimates: estimates)
    nlp = SimpleNamespace(free=("a", "b", "T_delay"), scaling=scaling)
    accuracy = SimpleNamespace(nlp=nlp, combinations=combinations)
    runs = SimpleNamespace(estimate=np.array([[1.0, 2.0, 0.0], [1.0, 3.0, 4e-9]]))
    minima = (SimpleNamespace(variants=variants, runs=(0, 1), estimate=runs.estimate[0]),)
    search = SimpleNamespace(minima=minima, runs=runs)
    evidence = Evidence(SimpleNamespace(found=search), accuracy, None)
    texts = [finding.text for finding in several_estimates(evidence)]
    assert len(texts) == count
    assert all("same response, also a = 1, b = 3 and T_delay = 4e-09." in text for text in texts)


def test_a_response_of_zero_explains_nothing_and_the_default_search_leaves_it():
    """(2.7) in a wide box: at zero gain (4.26) costs the number of points, and most starts end there."""
    data = replace(pitch_hover.data().times_s(), input="u", output=DampedRate.output, units={})
    wide = {"K_1": (0, 1e6), "T_1": (1e-4, 50), "xi": (-50, 50), "omega_p": (0.01, 500)}
    problem = gb.Problem(DampedRate(), data, bounds=wide, fixed={"T_delay": 0.0042})
    fit = gb.fit(problem, [{"K_1": 0.0}], profiles=False, progress=False)
    assert fit.cost == pytest.approx(len(data), rel=1e-3)
    assert fit.agreeing == 0
    assert any("explains nothing" in text for text in fit.warnings)

    # Of 200 runs of IPOPT alone, 4 find this minimum.
    default = gb.fit(problem, profiles=False, progress=False)
    assert default.cost == pytest.approx(7.8172, rel=1e-4)
    assert default.agreeing >= 4
