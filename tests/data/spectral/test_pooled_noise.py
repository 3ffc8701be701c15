"""Noise levels of several tests, against levels that are known and differ as much as is known."""

import numpy as np
import pytest
from scipy import optimize, special, stats

from greybox.data.spectral.pooled_noise import _inverse_trigamma, pooled_levels

OMEGA = np.geomspace(1, 20, 10)
DOF = np.array([8.0] * 6 + [16.0] * 4)
FLIGHTS = 150


def flights(differing):
    """True levels on a bent curve, and their estimates; levels themselves differ by χ² of `differing` degrees."""
    rng = np.random.default_rng(1)
    true = OMEGA**1.5 * np.exp(0.2 * np.log(OMEGA) ** 2) * np.ones((FLIGHTS, 1))
    if differing:
        true = true * differing / rng.chisquare(differing, true.shape)
    return true, true * rng.chisquare(DOF, true.shape) / DOF, rng


@pytest.mark.parametrize("differing", [0, 6])
def test_what_is_judged_by_pooled_levels_is_covered(differing):
    """|e|² over the level is F with 2 and the stated degrees of freedom, whether the levels differ or not."""
    true, estimates, rng = flights(differing)
    level, dof = np.swapaxes([pooled_levels(OMEGA, one, DOF) for one in estimates], 0, 1)
    error = true * rng.chisquare(2, true.shape) / 2
    assert np.mean(error < level * stats.f.ppf(0.95, 2, dof)) == pytest.approx(0.95, abs=0.015)


def test_levels_of_one_smooth_spectrum_are_known_better_together():
    true, estimates, _ = flights(0)
    pooled = np.array([pooled_levels(OMEGA, one, DOF)[0] for one in estimates])
    assert np.std(np.log(pooled / true)) < 0.65 * np.std(np.log(estimates / true))
    assert np.mean(pooled / true) == pytest.approx(1, abs=0.04)


def test_levels_that_have_nothing_in_common_are_kept():
    levels = 10.0 ** np.array([0, 4, 1, 6, 0, 5, 1, 6, 2, 5])
    kept, dof = pooled_levels(OMEGA, levels, DOF)
    assert np.abs(np.log(kept / levels)).max() < 1
    assert dof == pytest.approx(DOF, abs=1)


def test_few_tests_and_unknown_levels_are_left_alone():
    few = pooled_levels(OMEGA[:4], OMEGA[:4], DOF[:4])
    assert few[0].tolist() == OMEGA[:4].tolist()
    assert few[1].tolist() == DOF[:4].tolist()
    unknown = np.where(OMEGA < 2, np.nan, OMEGA)
    assert np.isnan(pooled_levels(OMEGA, unknown, DOF)[0]).tolist() == np.isnan(unknown).tolist()


def test_five_levels_on_one_curve_are_known_as_well_as_all_together():
    line = np.geomspace(1, 10, 5)
    level, dof = pooled_levels(line, line, np.full(5, 8.0))
    assert dof.tolist() == [40.0] * 5
    assert level / line == pytest.approx(level[0] / line[0])


@pytest.mark.parametrize(("count", "bends"), [(7, False), (8, True)])
def test_from_eight_tests_on_the_curve_may_bend(count, bends):
    """Levels on a parabola are on a curve that bends, which leaves them as they are but for one factor."""
    omega = np.geomspace(1, 20, count)
    levels = omega**1.5 * np.exp(0.5 * np.log(omega / 4) ** 2)
    level, _ = pooled_levels(omega, levels, np.full(count, 40.0))
    assert (np.ptp(np.log(level / levels)) < 1e-6) == bends


def test_levels_are_weighted_by_their_freedom_against_what_they_differ():
    """Smyth's formulas, written out."""
    random = np.random.default_rng(2)
    dof = np.array([8.0, 8.0, 20.0, 8.0, 12.0, 8.0])
    omega = np.geomspace(1, 20, 6)
    levels = omega * np.exp(0.9 * random.normal(size=6))
    logs = np.log(levels) - special.digamma(dof / 2) + np.log(dof / 2)
    line = np.polyval(np.polyfit(np.log(omega), logs, 1), np.log(omega))
    spread = np.sum((logs - line) ** 2) / 4 - np.mean(special.polygamma(1, dof / 2))
    assert spread > 0.1
    prior = 2 * optimize.brentq(lambda x: special.polygamma(1, x) - spread, 1e-3, 1e3)
    center = np.exp(line + special.digamma(prior / 2) - np.log(prior / 2))
    level, freedom = pooled_levels(omega, levels, dof)
    assert level == pytest.approx((dof * levels + prior * center) / (dof + prior), rel=1e-6)
    assert freedom == pytest.approx(np.minimum(dof + prior, dof.sum()), rel=1e-6)


@pytest.mark.parametrize("value", [1e-3, 0.3, 2.0, 50.0])
def test_the_inverse_of_the_trigamma_function(value):
    assert special.polygamma(1, _inverse_trigamma(value)) == pytest.approx(value, rel=1e-8)
