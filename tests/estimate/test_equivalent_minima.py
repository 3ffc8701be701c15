"""Parameter vectors of one response, and the constraint that chooses one of them."""

import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.03, seed=6)


def same_response(fit):
    return [warning for warning in fit.warnings if "same response" in warning]


def test_lags_that_swap_are_shown_and_a_constraint_chooses_one():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), progress=False)
    (text,) = same_response(fit)
    assert "T1 and T2 differ" in text or "T2 and T1 differ" in text
    high, low = ("T1", "T2") if fit.estimate["T1"] > fit.estimate["T2"] else ("T2", "T1")
    ordered = gb.fit(
        gb.Problem(LagLagDelay(), DATA, constraints=[lambda p: p[high] - p[low]]),
        starts=4,
        progress=False,
    )
    assert not same_response(ordered)
    assert ordered.estimate[high] == pytest.approx(fit.estimate[high], rel=1e-3)
