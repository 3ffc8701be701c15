"""Bounded errors against Huber's efficiency and the quantiles of the normal distribution."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from greybox.statistics.error_distribution import robust_deviation
from greybox.statistics.huber import HuberErrors

NORMAL = norm.ppf((np.arange(20000) + 0.5) / 20000)


def test_the_deviation_of_normal_errors_ignores_gaps_and_outliers():
    errors = np.array([3 * NORMAL, 0.2 * NORMAL, NORMAL, 0 * NORMAL])
    errors[1, ::3] = np.nan
    errors[2, ::1000] = 1e6
    deviation = robust_deviation(errors)
    assert deviation == pytest.approx(np.array([[3], [0.2], [1], [np.inf]]), rel=5e-3)


def test_bounded_errors_have_nineteen_twentieths_of_the_efficiency():
    """The mean of normal errors has the variance 1/n, that of Huber's bound 1/0.95 n."""
    first, second = HuberErrors().pseudo_errors([np.array([NORMAL[::2]]), np.array([NORMAL[1::2]])])
    psi = np.hstack([first, second])
    assert np.mean(psi**2) == pytest.approx(1 / 0.95, rel=1e-3)
    # All errors within the bound are divided by their share, and the others are at the bound.
    share = norm.cdf(1.345) - norm.cdf(-1.345)
    assert_allclose(np.sort(psi[0]), np.clip(NORMAL, -1.345, 1.345) / share, rtol=2e-3)


def test_gaps_do_not_count_and_errors_that_are_mostly_zero_have_no_bound():
    errors = np.array([NORMAL, 0 * NORMAL])
    errors[1, :100] = 5.0
    gaps = np.insert(errors, 7000, np.full((3000, 2), np.nan), axis=1)
    (with_gaps,), (without,) = (
        HuberErrors().pseudo_errors([gaps]),
        HuberErrors().pseudo_errors([errors]),
    )
    assert_allclose(np.delete(with_gaps, range(7000, 10000), axis=1), without)
    assert np.isnan(with_gaps[:, 7000:10000]).all()
    assert_allclose(without[1], errors[1])
