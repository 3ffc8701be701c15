"""Anything with an estimate and a covariance can stand for fixed values; numbers and texts cannot."""

import numpy as np
import pytest
from declared_models import TWO_LAGS, TWO_LAGS_OMEGA, LagLagDelay, measured

import greybox as gb
from greybox.modeling.formulation.held_estimate import HeldEstimate

DATA = measured(LagLagDelay(), TWO_LAGS_OMEGA, TWO_LAGS, noise=0.02)


class Calibration:
    """A gain from elsewhere, with its uncertainty."""

    dof = np.inf
    estimate = {"K": 5.0}

    def covariance_of(self, names):
        return np.diag([0.3**2 for _ in names])


def test_a_fit_is_a_held_estimate_and_numbers_are_not():
    fit = gb.fit(gb.Problem(LagLagDelay(), DATA), starts=3)
    assert isinstance(fit, HeldEstimate)
    assert isinstance(Calibration(), HeldEstimate)
    assert not isinstance(5.0, HeldEstimate)
    assert not isinstance({"K": 5.0}, HeldEstimate)


def test_a_value_from_elsewhere_brings_its_uncertainty():
    problem = gb.Problem(LagLagDelay(), DATA, fixed=Calibration())
    assert set(problem.held_estimates) == {"K"}
    assert problem.parameters["K"].fixed
    found = gb.fit(problem, starts=10)
    exact = gb.fit(gb.Problem(LagLagDelay(), DATA, fixed={"K": 5.0}), starts=10)
    assert found.estimate == pytest.approx(exact.estimate, rel=1e-5)
    assert found.standard_error["K"] == pytest.approx(0.3)
    assert exact.standard_error["K"] == 0
    slow = max(("T1", "T2"), key=lambda name: found.estimate[name])  # the two may change places
    assert found.standard_error[slow] > 3 * exact.standard_error[slow]
