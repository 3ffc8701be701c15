"""Tests of terms that one model has more than another have their nominal size and find what is needed."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from drag_flights import LINEAR, Drag, LinearDrag, QuadraticDrag, fitted, flight
from scipy.stats import chi2, f

import greybox as gb
from greybox.assessment.validation.nested_models import NestedTest, f_tail
from greybox.engine.compiled.response_part import ResponsePart

pytestmark = pytest.mark.usefixtures("unjudged_file")


def test_a_nested_test_says_what_is_needed():
    record = flight({"a5": 0.2, "C_x": 0.05}, 8)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    found = gb.validation.nested_test(small, large)
    assert found.terms == ("C_x",)
    assert found.p_value < 1e-6
    assert str(found).startswith("C_x is needed: LinearDrag is rejected by the test against Drag")
    held = gb.validation.nested_test(fitted(Drag(), record, fixed={"C_x": 0.05}), large)
    assert held.p_value > 0.01
    assert str(held).startswith(
        "C_x is not shown to be needed: Drag 1 is not rejected by the test against Drag 2 (F(1, "
    )
    # Of a term that changes little the scaled ratio is the squared t-value.
    record = flight({"a5": 0.2, "C_x": 0.03}, 8, noise=0.6)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    t = large.estimate["C_x"] / large.standard_error["C_x"]
    assert 2 < t < 12
    assert gb.validation.nested_test(small, large).statistic == pytest.approx(t**2, rel=0.15)


@pytest.fixture(scope="module")
def drags():
    record = flight({"a5": 0.2, "C_x": 0.03}, 8, duration=10.0, noise=0.6)
    return fitted(LinearDrag(), record), fitted(Drag(), record)


def test_the_scaled_ratio_is_held_against_f(drags):
    """Every number of it, and the sentence."""
    small, large = drags
    found = gb.validation.nested_test(small, large)
    ratio = 2 * (small.cost - large.cost)
    covariance = large.covariance_of(["a5", "C_x"])
    scale = covariance[1, 1] / large.white[1, 1]
    assert found.likelihood_ratio == ratio > 0
    assert found.scale == pytest.approx(scale)
    assert found.statistic == pytest.approx(ratio / scale)
    assert found.dof == (1, large.dof)
    assert found.p_value == pytest.approx(f.sf(ratio / scale, 1, large.dof))
    assert f"scaled by {scale:.3g}" in str(found)
    assert repr(found).startswith("<NestedTest C_x is needed: LinearDrag is rejected by")


def test_fits_are_called_by_their_models(drags):
    record = drags[1].records[0].data
    held = fitted(Drag(), record, fixed={"C_x": 0.0})
    assert gb.validation.nested_test(held, drags[1]).terms == ("C_x",)
    assert (
        gb.validation.nested_test(fitted(QuadraticDrag(), record), drags[1]).small
        == "QuadraticDrag"
    )
    assert gb.validation.nested_test(*drags).small == "LinearDrag"


def test_without_a_likelihood_ratio_nothing_is_tested(drags):
    small, large = drags
    with pytest.raises(ValueError, match="no likelihood ratio"):
        gb.validation.nested_test(small, replace(large, white=None))


def test_on_a_bound_half_of_the_statistic_has_one_degree_less():
    assert f_tail(3.0, 1, 40.0, on_bound=False) == pytest.approx(f.sf(3.0, 1, 40))
    assert f_tail(3.0, 1, 40.0, on_bound=True) == pytest.approx(f.sf(3.0, 1, 40) / 2)
    assert f_tail(0.0, 1, 40.0, on_bound=True) == 1.0
    halves = f.sf(3.0, 2, 40), f.sf(6.0, 1, 40)
    assert f_tail(3.0, 2, 40.0, on_bound=True) == pytest.approx(sum(halves) / 2)
    assert f_tail(3.0, 2, np.inf, on_bound=False) == pytest.approx(chi2.sf(6.0, 2))


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "(F(2, 30) = 1.5, p = 0.24; scaled by 2)."),
        ({"dof": (2, np.inf)}, "(F(2, inf) = 1.5, p = 0.24; scaled"),
        ({"scale": 1.0}, "p = 0.24)."),
        ({"p_value": 0.049}, "a, b are needed: small is rejected"),
        (
            {"p_value": 0.051},
            "a, b are not shown to be needed: small is not rejected by the test against large",
        ),
        (
            {"terms": ("a",)},
            "a is not shown to be needed: small is not rejected by the test against large",
        ),
        ({"statistic": 40.0, "dof": (1, 1.4)}, "may be needed: the residuals are too correlated"),
    ],
)
def test_the_verdict_comes_first(given, words):
    numbers = {"likelihood_ratio": 6.0, "scale": 2.0, "statistic": 1.5, "dof": (2, 30.0)}
    test = {"small": "small", "large": "large", "terms": ("a", "b"), "p_value": 0.24, **numbers}
    assert words in str(NestedTest(**test | given))


def test_a_term_that_ended_at_another_bound_or_is_not_determined_is_told(drags):
    small, large = drags
    a5, c = large.quantities[:2]
    stuck = replace(large, quantities=(a5, replace(c, at_bound=True), *large.quantities[2:]))
    with pytest.raises(ValueError, match="C_x of Drag ended at a bound: widen it before testing"):
        gb.validation.nested_test(small, stuck)
    with pytest.raises(
        ValueError, match="the data do not determine C_x of Drag: nothing can be tested"
    ):
        gb.validation.nested_test(small, replace(large, dof=0.0))
    # A cost that is larger by what solvers leave is none.
    assert gb.validation.nested_test(small, replace(large, cost=small.cost + 0.009)).p_value == 1.0
    with pytest.raises(
        ValueError, match="its fit has not reached the minimum; give it more starts"
    ):
        gb.validation.nested_test(small, replace(large, cost=small.cost + 0.011))


def test_a_nested_test_keeps_its_size_where_residuals_are_correlated():
    """Errors of the color 0.7 make a likelihood ratio (1 + 0.7) / (1 - 0.7) = 6 times too large."""
    tests = []
    for seed in range(4):
        record = flight(LINEAR, 100 + seed, duration=5.0, color=0.7)
        found = gb.validation.nested_test(fitted(LinearDrag(), record), fitted(Drag(), record))
        tests.append((found.p_value, found.likelihood_ratio))
    p_value, ratio = np.array(tests).T
    assert np.sum(ratio > chi2.isf(0.05, 1)) >= 2  # as if the residuals were white
    assert 1 / 36 < np.median(chi2.isf(p_value, 1) / ratio) < 1 / 3


def test_a_value_on_a_bound_has_half_of_the_distribution_at_one_degree_less():
    class NoThrust(Drag):
        """Drag that cannot push."""

        C_x = gb.Parameter(0.05, bounds=(0, 2))

    def tests(seed, *larger):
        record = flight(LINEAR, seed, duration=6.0)
        small = fitted(LinearDrag(), record)
        return [gb.validation.nested_test(small, fitted(model, record)) for model in larger]

    stuck = tests(20, NoThrust())[0]  # of the two records, the noise of one asks for thrust
    loose = tests(24, NoThrust(), Drag())
    assert loose[0].p_value == pytest.approx(0.5 * loose[1].p_value, rel=0.01)
    assert stuck.p_value == 1  # at the bound, the two models are the same


def test_of_responses_the_ratio_of_squared_errors_is_the_f_test_and_others_agree_with_it(
    monkeypatch,
):
    monkeypatch.setattr(
        ResponsePart, "neighbors", lambda *_: None
    )  # the F test is that of independent errors
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    tested = {}
    for criterion in (gb.SquaredRelativeError(), gb.RelativeError()):
        large = gb.fit(gb.Problem(LagLagDelay(), data, criterion), starts=10)
        value = large.estimate["tau"] + 2.5 * large.standard_error["tau"]
        small = gb.fit(gb.Problem(LagLagDelay(), data, criterion, fixed={"tau": value}), starts=10)
        tested[criterion.name] = gb.validation.nested_test(small, large)
        if criterion == gb.SquaredRelativeError():
            statistic = (small.cost - large.cost) / (large.cost / large.dof)
            # Up to what noise of 2 % makes of a relative criterion.
            assert tested[criterion.name].statistic == pytest.approx(statistic, rel=5e-3)
            assert tested[criterion.name].p_value == pytest.approx(
                f.sf(statistic, 1, large.dof), rel=2e-2
            )
            # The cost is quadratic: the root of the ratio is the distance in standard errors.
            assert statistic == pytest.approx(2.5**2, rel=0.15)
    assert tested["relative-error"].p_value < 0.05
    compared = gb.compare(small, large, labels=("held", "free"))
    assert compared.statements[0].startswith(
        "free contains held, and tau is needed: held is rejected"
    )


def test_a_tied_parameter_is_tested_along_what_leaves_the_tie():
    record = flight({"a5": 0.2, "C_x": 0.05}, 8)
    large = fitted(Drag(), record)
    for factor, needed in ((0.25, False), (0.3, True)):
        small = fitted(Drag(), record, tied={"C_x": lambda p, factor=factor: factor * p.a5})
        found = gb.validation.nested_test(small, large)
        assert (found.p_value < 0.05) == needed
        # The distance from the tie in standard errors, squared, is nearly the ratio.
        along = np.array([-factor, 1.0])
        distance = along @ [large.estimate["a5"], large.estimate["C_x"]]
        t = distance / np.sqrt(along @ large.covariance_of(["a5", "C_x"]) @ along)
        assert found.statistic == pytest.approx(t**2, rel=0.05)
        assert found.dof[0] == 1


def test_a_worse_fit_of_the_larger_model_is_told():
    record = flight(LINEAR, 3, duration=6.0)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    with pytest.raises(ValueError, match="Drag costs more than LinearDrag, which it contains"):
        gb.validation.nested_test(small, replace(large, cost=small.cost + 1))
    said = gb.compare(small, replace(large, cost=small.cost + 1)).verdict
    assert said.startswith(
        "The data do not show which of LinearDrag and Drag fits them better: Drag costs more"
    )


def quick(problem):
    start = {name: TWO_LAGS[name] for name, p in problem.parameters.items() if not p.fixed}
    return gb.fit(problem, starts=[start], progress=False, profiles=False)


def test_of_two_terms_the_ratio_is_divided_by_the_mean_scale(monkeypatch):
    monkeypatch.setattr(ResponsePart, "neighbors", lambda *_: None)  # as above
    data = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)
    both = [
        gb.Problem(LagLagDelay(), data, gb.SquaredRelativeError(), fixed=f)
        for f in ({"T2": 0.19, "tau": 0.06}, {})
    ]
    small, large = map(quick, both)
    found = gb.validation.nested_test(small, large)
    rows = np.ix_(*[[large.free.index(name) for name in ("T2", "tau")]] * 2)
    white, real = large.white[rows], large.covariance_of(large.free)[rows]
    assert found.terms == ("T2", "tau")
    assert found.dof == (2, large.dof)
    assert found.scale == pytest.approx(np.trace(np.linalg.inv(white) @ real) / 2, rel=1e-6)
    assert found.statistic == pytest.approx(2 * (small.cost - large.cost) / (2 * found.scale))
    assert found.p_value == pytest.approx(f.sf(found.statistic, 2, large.dof))


def test_of_other_data_nothing_is_tested():
    data = [
        measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02, seed=seed) for seed in (0, 1)
    ]
    both = zip(data, ({"tau": 0.06}, {}), strict=True)
    small, large = (quick(gb.Problem(LagLagDelay(), d, fixed=fixed)) for d, fixed in both)
    with pytest.raises(
        ValueError,
        match=r"was fitted to other data .* than .*: a nested test needs fits of the same data\.$",
    ):
        gb.validation.nested_test(small, large)


@pytest.mark.parametrize(
    ("dof", "verdict"), [(2.4, "may be needed"), (3.0, "is not shown to be needed")]
)
def test_below_three_degrees_of_freedom_nothing_is_called_needless(dof, verdict):
    test = NestedTest("small", "large", ("c",), 4.0, 3.0, 1.1, (1, dof), 0.4)
    assert str(test).startswith(f"c {verdict}")
