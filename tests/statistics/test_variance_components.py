"""Variances of parts of known spectra, against the ones that made the periodogram."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from greybox.statistics.variance_components import variance_components, whittle_score

TRUTH = np.array([0.4, 0.9, 0.3])


def parts(bands):
    """White noise of two outputs, and one that reaches both through a resonance; (c, b, k, k)."""
    omega = np.linspace(0, np.pi, bands)
    through = np.array(
        [1 / (0.3**2 - omega**2 + 0.05j * omega), 1j * omega / (0.3**2 - omega**2 + 0.05j * omega)]
    )
    resonance = np.einsum("ib,jb->bij", through, through.conj())
    resonance /= np.einsum("bii->b", resonance).real.mean() / 2
    white = np.eye(2)[:, None, :, None] * np.eye(2)[:, None, None, :] * np.ones((2, bands, 1, 1))
    return np.concatenate([white, resonance[None]])


def drawn(spectrum, random):
    root = np.linalg.cholesky(spectrum)
    z = (
        random.normal(size=(*root.shape[:2], 1)) + 1j * random.normal(size=(*root.shape[:2], 1))
    ) / np.sqrt(2)
    return (root @ z) @ (root @ z).conj().transpose(0, 2, 1)


def test_the_expected_periodogram_has_the_variances_that_made_it():
    expected = parts(200)
    variance, *_ = variance_components(
        expected, np.tensordot(TRUTH, expected, 1), np.full((2, 200), 2.0), sensors=2
    )
    assert_allclose(variance, TRUTH, rtol=2e-3)


def test_the_minimum_is_that_of_another_minimizer():
    expected, numbers = parts(60), np.full((2, 60), 2.0)
    periodogram = drawn(np.tensordot(TRUTH, expected, 1), np.random.default_rng(0))
    variance, _, least = variance_components(expected, periodogram, numbers, sensors=2)
    other = minimize(
        lambda logs: whittle_score(np.tensordot(np.exp(logs), expected, 1), periodogram, numbers)[
            0
        ],
        np.log(TRUTH),
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-9, "maxiter": 2000},
    )
    assert least == pytest.approx(other.fun, abs=2e-3)
    assert_allclose(variance, np.exp(other.x), rtol=0.02)


def test_the_covariance_is_that_of_repeated_periodograms():
    expected, random = parts(60), np.random.default_rng(1)
    spectrum = np.tensordot(TRUTH, expected, 1)
    every = [
        variance_components(expected, drawn(spectrum, random), np.full((2, 60), 2.0), sensors=2)
        for _ in range(150)
    ]
    logs = np.log([variance for variance, *_ in every])
    covariance = np.mean([covariance for _, covariance, _ in every], axis=0)
    assert_allclose(covariance.diagonal(), logs.var(axis=0), rtol=0.35)


def test_a_part_that_is_not_there_has_no_variance():
    expected = parts(200)
    white = np.tensordot(TRUTH * [1, 1, 0], expected, 1)
    variance, *_ = variance_components(expected, white, np.full((2, 200), 2.0), sensors=2)
    assert variance[2] < 1e-3
    assert_allclose(variance[:2], TRUTH[:2], rtol=5e-3)


def test_scores_are_those_of_complex_normal_numbers():
    """-2 log likelihood of independent complex vectors, up to a constant: log det S + z* S⁻¹ z, for every number."""
    random = np.random.default_rng(4)
    spectrum = np.tensordot(TRUTH, parts(5), 1)
    z = random.normal(size=(5, 2)) + 1j * random.normal(size=(5, 2))
    numbers = np.array([1.0, 2.0, 0.5, 3.0, 1.5])
    ridged = spectrum + 1e-4 * np.eye(2)
    wanted = sum(
        n * (np.log(np.linalg.det(s).real) + (x.conj() @ np.linalg.solve(s, x)).real)
        for n, s, x in zip(numbers, ridged, z, strict=True)
    )
    periodogram = z[:, :, None] * z[:, None].conj()
    both = np.tile(numbers, (2, 1))
    assert whittle_score(spectrum, periodogram, both)[0] == pytest.approx(wanted)


def test_an_output_with_fewer_numbers_counts_less_by_itself():
    """The transform of an output at a quarter of the rate repeats itself: independent outputs have
    the scores of each, by their own numbers."""
    random, bands = np.random.default_rng(5), 40
    expected = parts(bands)[:2]
    power = random.chisquare(2, size=(bands, 2)) / 2
    periodogram = power[:, :, None] * np.eye(2)
    numbers = np.array([np.full(bands, 2.0), np.full(bands, 0.5)])
    variance, _, least = variance_components(expected, periodogram, numbers, sensors=2)
    assert_allclose(variance, power.mean(axis=0), rtol=1e-3)
    mean = variance + 1e-4
    wanted = np.sum(numbers.T * (np.log(mean) + power / mean))
    assert least == pytest.approx(wanted)


def test_the_covariance_is_twice_the_inverse_of_the_information_by_differences():
    """At the expected periodogram the second derivatives of the score by the logarithms are the information."""
    expected, numbers = parts(60), np.tile(np.linspace(1.0, 3.0, 60), (2, 1))
    periodogram = np.tensordot(TRUTH, expected, 1)
    variance, covariance, least = variance_components(expected, periodogram, numbers, sensors=2)

    def score(logs):
        return whittle_score(np.tensordot(np.exp(logs), expected, 1), periodogram, numbers)[0]

    at, h = np.log(variance), 1e-3 * np.eye(3)
    curvature = np.array(
        [
            [
                score(at + a + b) - score(at + a - b) - score(at - a + b) + score(at - a - b)
                for a in h
            ]
            for b in h
        ]
    ) / (4e-6)
    assert_allclose(covariance, 2 * np.linalg.inv(curvature), rtol=5e-3)
    assert least == pytest.approx(score(at))


def test_parts_that_look_the_same_share_a_variance_and_have_finite_errors():
    """Of two equal parts the sum is known; what cannot be told has no part in the covariance."""
    expected = parts(60)
    twice = np.concatenate([expected, expected[2:]])
    periodogram = np.tensordot(TRUTH, expected, 1)
    variance, covariance, _ = variance_components(
        twice, periodogram, np.full((2, 60), 2.0), sensors=2
    )
    assert variance[2:].sum() == pytest.approx(TRUTH[2], rel=5e-3)
    assert np.abs(covariance).max() < 1


def test_a_periodogram_far_from_the_beginning_is_reached():
    """By variances of a hundredth and of thirty times those at the beginning."""
    expected = parts(200)
    truth = np.array([0.007, 20.0, 9.0])
    variance, *_ = variance_components(
        expected, np.tensordot(truth, expected, 1), np.full((2, 200), 2.0), sensors=2
    )
    assert_allclose(variance, truth, rtol=0.02)


@pytest.mark.parametrize("absent", [1, 2])
def test_the_variance_of_what_is_not_there_is_positive_and_far_below_all_others(absent):
    """Its logarithm is a number; a hundred-thousandth of an output's power is a tenth of what counts as none."""
    expected = parts(200)
    periodogram = np.tensordot(np.where(np.arange(3) == absent, 0.0, TRUTH), expected, 1)
    variance, covariance, _ = variance_components(
        expected, periodogram, np.full((2, 200), 2.0), sensors=2
    )
    assert 0 < variance[absent] < 1e-5
    assert np.isfinite(covariance).all()
