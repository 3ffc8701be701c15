"""Intervals from replicates against scipy's, and blocks."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import bootstrap, norm
from scipy.stats import t as student

from greybox.study.resampling import (
    acceleration,
    bca_interval,
    drawn_blocks,
    percentile_interval,
    tail,
)


def test_intervals_are_those_of_scipy():
    sample = np.random.default_rng(3).gamma(1.5, size=25)
    spread = {"n_resamples": 999, "vectorized": True, "random_state": 0}
    bca = bootstrap((sample,), np.std, method="BCa", **spread)
    values, estimate = bca.bootstrap_distribution, float(np.std(sample))
    left_out = np.array([[np.std(np.delete(sample, k))] for k in range(sample.size)])
    found = bca_interval(values, estimate, float(acceleration(left_out)[0]), 0.95)
    assert_allclose(found, [bca.confidence_interval.low, bca.confidence_interval.high], rtol=1e-6)
    plain = bootstrap((sample,), np.std, method="percentile", **spread).confidence_interval
    assert_allclose(percentile_interval(values, 0.95), [plain.low, plain.high], rtol=1e-6)


def test_few_degrees_of_freedom_widen_to_students_t():
    # Normal replicates of deviation 1 about the estimate, which are what a bootstrap of a mean
    # gives.
    values = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
    for found in (percentile_interval(values, 0.95, 5), bca_interval(values, 0.0, 0.0, 0.95, 5)):
        assert_allclose(found, np.array([-1, 1]) * student.ppf(0.975, 5), rtol=2e-3)


def test_an_estimate_beyond_all_replicates_has_no_bca_interval():
    assert np.isnan(bca_interval(np.arange(10.0), 20.0, 0.0, 0.95)).all()


def test_blocks_follow_each_other_on_a_circle():
    places = drawn_blocks(np.random.default_rng(0), 100, 30, 7)
    assert len(places) == 100
    assert np.all((np.diff(places) % 30 == 1) | (np.arange(1, 100) % 7 == 0))


def test_accelerations_need_two_estimates_that_differ():
    left_out = np.array([[1.0, 3.0], [2.0, 3.0], [4.0, 3.0], [np.nan, 5.0]])
    away = 7 / 3 - np.array([1.0, 2.0, 4.0])
    assert_allclose(acceleration(left_out), [np.sum(away**3) / (6 * np.sum(away**2) ** 1.5), 0.0])
    assert_allclose(acceleration(left_out[2:]), [0.0, 0.0])


@pytest.mark.parametrize("level", [0.8, 0.95])
def test_the_share_beyond_an_end_is_that_of_students_t_among_normal_replicates(level):
    assert tail(level) == pytest.approx(0.5 - level / 2)
    assert tail(level, 4) == pytest.approx(norm.sf(student.ppf(0.5 + level / 2, 4)))


def test_replicates_that_equal_the_estimate_count_half_below_it():
    """So many on either side: no bias, and without acceleration the interval is that of percentiles."""
    values = np.concatenate([np.arange(40.0), np.full(20, 40.0), np.arange(41.0, 81.0)])
    assert bca_interval(values, 40.0, 0.0, 0.9) == pytest.approx(percentile_interval(values, 0.9))


@pytest.mark.parametrize("estimate", [-3.0, 3.0])
def test_an_estimate_on_one_side_of_all_replicates_has_no_corrected_interval(estimate):
    values = np.linspace(-2, 2, 41)
    assert np.isnan(bca_interval(values, estimate, 0.0, 0.9)).all()
    assert np.isfinite(bca_interval(values, 0.9 * estimate / 1.5, 0.0, 0.9)).all()


def test_two_estimates_are_enough_and_one_or_none_tells_nothing():
    left_out = np.array([[1.0, 3.0], [2.0, 9.0], [np.nan, 5.0]])
    assert_allclose(acceleration(left_out), [0.0, 0.0], atol=1e-15)  # symmetric
    assert_allclose(acceleration(np.array([[0.0], [0.0], [3.0]])), [(1 + 1 - 8) / (6 * 6**1.5)])
    assert acceleration(np.full((2, 3), np.nan)).tolist() == [0, 0, 0]


def test_without_replicates_there_is_no_interval():
    for found in (
        percentile_interval([], 0.9),
        bca_interval([], 0.0, 0.1, 0.9),
        percentile_interval([1.0, 2.0], 0.9, np.nan),
    ):
        assert np.isnan(found).all()


@pytest.mark.parametrize(
    ("count", "size", "length"), [(12, 5, 4), (13, 30, 4), (3, 30, 7), (4, 4, 1)]
)
def test_blocks_are_as_many_as_needed(count, size, length):
    places = drawn_blocks(np.random.default_rng(1), count, size, length)
    assert len(places) == count
    assert places.min() >= 0
    assert places.max() < size
    first = np.random.default_rng(1).integers(0, size, int(np.ceil(count / length)))
    assert places.tolist() == [(first[k // length] + k % length) % size for k in range(count)]


@pytest.mark.parametrize("a", [-0.1, 0.0, 0.08])
def test_accelerated_ends_are_those_of_efron(a):
    """Φ(z + (z + u) / (1 - a (z + u))) among replicates, z from the share below the estimate."""
    values = np.sort(np.random.default_rng(0).gamma(2.0, size=4000))
    estimate = values[1700] + 1e-9
    z = norm.ppf(1701 / 4000)
    ends = [norm.cdf(z + (z + u) / (1 - a * (z + u))) for u in norm.ppf([0.1, 0.9])]
    assert_allclose(bca_interval(values, estimate, a, 0.8), np.quantile(values, ends), rtol=1e-7)
