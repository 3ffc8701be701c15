"""The ratio of von Neumann against its moments for white noise, and against movements of known size."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.statistics.noise_ratio import NoiseRatio, noise_ratio


@pytest.mark.parametrize("samples", [10, 40, 400])
def test_white_noise_has_the_ratio_two_and_the_spread_told(samples):
    found = [noise_ratio([np.random.default_rng(k).normal(size=samples)]) for k in range(2000)]
    ratios = np.array([f.ratio for f in found])
    assert_allclose(ratios.mean(), 2, atol=4 * ratios.std() / np.sqrt(2000))
    assert_allclose(ratios.std(), found[0].spread, rtol=0.08)
    assert np.mean([f.noisy for f in found]) > 0.99


def test_the_fit_that_noise_allows():
    """Of y = s + e the best model leaves e, of which the fit is 1 - |e| / |y - mean y|."""
    time = np.linspace(0, 20, 4000)
    for sigma in (0.1, 0.5, 1.0, 3.0):
        e = sigma * np.random.default_rng(0).normal(size=4000)
        y = np.sin(time) + e
        best = 100 * (1 - np.linalg.norm(e) / np.linalg.norm(y - y.mean()))
        found = noise_ratio([y])
        assert_allclose(found.attainable_fit_percent, best, atol=1.5)
        assert not found.noisy


def test_stretches_and_missing_samples():
    """Each stretch moves about its own mean, and what is missing is skipped."""
    random = np.random.default_rng(1)
    pieces = [random.normal(size=200), 100 + random.normal(size=200)]
    assert noise_ratio(pieces).noisy
    assert not noise_ratio([np.concatenate(pieces)]).noisy
    slow = np.full(1000, np.nan)
    slow[::10] = np.sin(np.arange(100) / 10)
    assert_allclose(noise_ratio([slow]).ratio, noise_ratio([slow[::10]]).ratio)


def test_the_ratio_of_stretches_is_that_of_their_squares():
    """Also in small units; a sample alone and values that are none tell nothing."""
    stretches = [0, 0.1, np.nan, 0.2], [5, 5.3], [7.0], [np.inf]
    found = noise_ratio([*map(np.array, stretches)])
    assert_allclose(found.ratio, (0.1**2 + 0.1**2 + 0.3**2) / (2 * 0.1**2 + 2 * 0.15**2))
    assert found.samples == 4
    assert_allclose(found.spread, 2 * np.sqrt(2 / 15))
    assert_allclose(found.attainable_fit_percent, 100 * (1 - np.sqrt(found.ratio / 2)))
    assert_allclose(noise_ratio([np.arange(4.0)]).ratio, 3 / 5)
    assert np.isnan(noise_ratio([np.arange(3.0)]).ratio)
    few = noise_ratio([np.array([1.0, 2.0])])
    assert (few.samples, few.spread) == (2, np.inf)
    assert noise_ratio([np.resize([-1.0, 1.0], 9)]).attainable_fit_percent == 0


def test_the_spread_of_few_samples():
    """Of three it is 2 √(1/8); of two there is none."""
    assert_allclose(NoiseRatio(0.1, 3).spread, 2 * np.sqrt(1 / 8))
    assert NoiseRatio(0.0, 2).spread == np.inf
    limit = 2 - 6 * np.sqrt(48 / 2499)
    assert NoiseRatio(limit + 1e-6, 50).noisy
    assert not NoiseRatio(limit - 1e-6, 50).noisy
    assert not NoiseRatio(np.nan, 50).noisy
