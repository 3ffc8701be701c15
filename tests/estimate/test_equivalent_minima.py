"""Parameter vectors of one response, and the constraint that chooses one of them."""

import re

import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)


def same_response(fit):
    return [warning for warning in fit.warnings if "same response" in warning]


def test_lags_that_swap_are_shown_and_a_constraint_chooses_one():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), progress=False)
    (text,) = same_response(fit)
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    other = {name: float(re.search(rf"{name} = ([\d.]+)", text)[1]) for name in ("T1", "T2")}
    assert other[low] == pytest.approx(fit.estimate[high], rel=1e-3)
    assert other[high] == pytest.approx(fit.estimate[low], rel=1e-3)
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=4,
        progress=False,
    )
    assert not same_response(ordered)
    assert ordered.estimate[high] == pytest.approx(fit.estimate[high], rel=1e-3)


@pytest.mark.parametrize(
    ("starts", "seed", "ascend"),
    [(12, 3, True), (12, 4, True), ([{"T1": 2.0}], None, False), ([{"T2": 2.0}], None, True)],
)
def test_lags_that_swap_have_the_order_of_the_first_start_else_ascend(starts, seed, ascend):
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), starts, seed=seed, progress=False)
    lags = [fit.estimate["T1"], fit.estimate["T2"]]
    assert sorted(lags) == pytest.approx([0.1, 1.0], rel=0.05)
    assert lags == sorted(lags, reverse=not ascend)


class Bounded(LagLagDelay):
    """The same with bounds that the shorter lag cannot have."""

    T1 = gb.Parameter(0.5, bounds=(0.5, 5), unit="s", about="first lag")


class Leading(LagLagDelay):
    """A lead over a lag: exchanged, they are another response."""

    def response(self, s, p):
        return p.K * (p.T1 * s + 1) / (p.T2 * s + 1)


def test_parameters_that_do_not_exchange_keep_their_values():
    bounded = gb.fit(gb.Problem(Bounded(), DATA), [{}], progress=False)
    assert bounded.estimate["T1"] > bounded.estimate["T2"]
    truth = {"K": 2.0, "T1": 1.0, "T2": 0.1}
    data = measured(Leading(), TWO_LAGS_OMEGA, truth, noise=0.01, seed=1)
    lead = gb.fit(gb.Problem(Leading(), data, fixed={"tau": 0.0}), [{}], progress=False)
    assert [lead.estimate[name] for name in truth] == pytest.approx([*truth.values()], rel=0.05)
