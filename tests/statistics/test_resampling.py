"""Intervals from replicates against scipy's, and blocks against the theory of an autoregression."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import bootstrap, norm
from scipy.stats import t as student

from greybox.statistics.resampling import (
    acceleration,
    bca_interval,
    block_length,
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
    # Normal replicates of deviation 1 about the estimate, which are what a bootstrap of a mean gives.
    values = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
    for found in (percentile_interval(values, 0.95, 5), bca_interval(values, 0.0, 0.0, 0.95, 5)):
        assert_allclose(found, np.array([-1, 1]) * student.ppf(0.975, 5), rtol=2e-3)


def test_an_estimate_beyond_all_replicates_has_no_bca_interval():
    assert np.isnan(bca_interval(np.arange(10.0), 20.0, 0.0, 0.95)).all()


@pytest.mark.parametrize("fade", [0.5, 0.8, 0.95])
def test_blocks_have_the_length_that_is_best_for_an_autoregression(fade):
    # Politis and White (2004): b = (2 G² / D n)^(1/3), of an AR(1) G / g(0) = 2 φ / (1 - φ²) and D = 4/3 g(0)².
    n = 20_000
    random = np.random.default_rng(0)
    lengths = [block_length([lfilter([1], [1, -fade], random.normal(size=n))]) for _ in range(9)]
    best = (1.5 * (2 * fade / (1 - fade**2)) ** 2 * n) ** (1 / 3)
    assert_allclose(np.median(lengths), best, rtol=0.2)


def test_white_residuals_are_drawn_one_by_one():
    lengths = [block_length([np.random.default_rng(seed).normal(size=300)]) for seed in range(40)]
    assert np.median(lengths) == 1


def test_blocks_follow_each_other_on_a_circle():
    places = drawn_blocks(np.random.default_rng(0), 100, 30, 7)
    assert len(places) == 100
    assert np.all((np.diff(places) % 30 == 1) | (np.arange(1, 100) % 7 == 0))


def test_no_block_is_longer_than_a_third_of_the_series():
    walks = np.random.default_rng(0).normal(size=(20, 30)).cumsum(axis=1)
    assert max(block_length([walk]) for walk in walks) == 10
    assert block_length(list(walks[:, :5])) == 1


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


@pytest.mark.parametrize(("count", "blocks"), [(9, False), (10, True)])
def test_a_series_of_fewer_than_ten_is_drawn_one_by_one(count, blocks):
    assert (block_length([np.arange(count) - (count - 1) / 2]) > 1) is blocks


@pytest.mark.parametrize("seed", range(4))
def test_the_length_of_a_block_is_that_of_politis_and_white_step_by_step(seed):
    """Flat-top window of twice the first lag after which K correlations in a row are small; circular blocks."""
    e = lfilter([1], [1, -0.7], np.random.default_rng(seed).normal(size=400))
    n, K = 400, 5  # √(log10 400) is less than five
    R = np.array([e[k:] @ e[: n - k] / n for k in range(41)])
    small = np.abs(R / R[0]) < 2 * np.sqrt(np.log10(n) / n)
    m = next(k for k in range(30) if small[k + 1 : k + 1 + K].all())
    M = min(2 * m, 20 + K)

    def window(t):
        return 1.0 if t <= 0.5 else 2 * (1 - t)

    weights = np.array([window(k / (2 * m)) for k in range(1, M + 1)])
    G = 2 * np.sum(weights * np.arange(1, M + 1) * R[1 : M + 1])
    g = R[0] + 2 * np.sum(weights * R[1 : M + 1])
    assert block_length([e]) == round((2 * G**2 / (4 / 3 * g**2)) ** (1 / 3) * n ** (1 / 3))
