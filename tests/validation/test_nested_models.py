"""Tests of terms that one model has more than another have their nominal size and find what is needed."""

from dataclasses import replace

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured
from drag_flights import LINEAR, Drag, LinearDrag, fitted, flight
from scipy.stats import f

import greybox as gb


def test_a_nested_test_says_what_is_needed():
    record = flight({"a5": 0.2, "C_x": 0.05}, 8)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    found = gb.validation.nested_test(small, large)
    assert found.terms == ("C_x",)
    assert found.p_value < 1e-6
    assert str(found).startswith("C_x is needed: LinearDrag is rejected by the test against Drag")
    held = gb.validation.nested_test(fitted(Drag(), record, fixed={"C_x": 0.05}), large)
    assert held.p_value > 0.01
    assert str(held).startswith("C_x is not needed: Drag with C_x fixed explains the data as well as Drag (F(1, ")
    # Of a term that changes little the scaled ratio is the squared t-value.
    record = flight({"a5": 0.2, "C_x": 0.03}, 8, noise=0.6)
    small, large = fitted(LinearDrag(), record), fitted(Drag(), record)
    t = large.estimate["C_x"] / large.standard_error["C_x"]
    assert 2 < t < 12
    assert gb.validation.nested_test(small, large).statistic == pytest.approx(t**2, rel=0.15)


def test_a_nested_test_keeps_its_size_where_residuals_are_correlated():
    scaled, bare = [], []
    for seed in range(30):
        record = flight(LINEAR, 100 + seed, duration=10.0, color=0.7)
        found = gb.validation.nested_test(fitted(LinearDrag(), record), fitted(Drag(), record))
        scaled.append(found.p_value < 0.05)
        bare.append(found.likelihood_ratio > 3.84)
    assert np.mean(bare) > 0.2  # as if the residuals were white
    assert np.sum(scaled) <= 4  # of 30, at 5 %: in 98.4 % of such experiments


def test_a_value_on_a_bound_has_half_of_the_distribution_at_one_degree_less():
    class NoThrust(Drag):
        """Drag that cannot push."""

        C_x = gb.Parameter(0.05, bounds=(0, 2))

    stuck = loose = None
    for seed in range(20, 40):
        record = flight(LINEAR, seed, duration=6.0)
        found = fitted(NoThrust(), record)
        two_sided = gb.validation.nested_test(fitted(LinearDrag(), record), fitted(Drag(), record))
        one_sided = gb.validation.nested_test(fitted(LinearDrag(), record), found)
        if found.estimate["C_x"] > 1e-3:
            loose = loose or (one_sided, two_sided)
        else:
            stuck = stuck or one_sided
        if stuck and loose:
            break
    assert loose[0].p_value == pytest.approx(0.5 * loose[1].p_value, rel=0.01)
    assert stuck.p_value > 0.5


def test_of_responses_the_ratio_of_squared_errors_is_the_f_test_and_others_agree_with_it():
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
            assert tested[criterion.name].p_value == pytest.approx(f.sf(statistic, 1, large.dof), rel=2e-2)
            # The cost is quadratic: the root of the ratio is the distance in standard errors.
            assert statistic == pytest.approx(2.5**2, rel=0.15)
    assert tested["relative-error"].p_value < 0.05
    compared = gb.compare(small, large, labels=("held", "free"))
    assert compared.statements[0].startswith("free contains held, and tau is needed: held is rejected")
    (said,) = [s for s in compared.statements if s.startswith("tau")]
    assert said.endswith("(free): determined by these data.")


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
    said = gb.compare(small, replace(large, cost=small.cost + 1)).statements[0]
    assert said.startswith("It cannot be told which of LinearDrag and Drag fits the data better: Drag costs more")
