"""Terms beside autoregressive errors: right in level, and not blinded by what is missing."""

import numpy as np
import pytest
from scipy.signal import lfilter

from greybox.statistics.autoregressive_likelihood import autoregressive_p_values, whitened

N = 300
OUTPUTS = [[np.arange(N)]]
T = np.arange(N) / N
FITTED = np.column_stack([np.sin(7 * T), T])
TERM = np.sin(11 * T)[:, None]


def errors(rng, pole):
    return lfilter([1.0], [1.0, -pole], rng.standard_normal(N + 500))[500:]


def test_whitened_rows_are_what_the_samples_before_them_do_not_predict():
    shocks = np.random.default_rng(2).standard_normal((N, 1))
    denominator = np.array([1.0, -1.2, 0.5])
    values = lfilter([1.0], denominator, shocks, axis=0)
    np.testing.assert_allclose(whitened(values, [denominator], OUTPUTS), shocks[2:], atol=1e-12)


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.99, 1.0])
def test_noise_of_any_color_is_rarely_called_a_term(pole):
    rng = np.random.default_rng(3)
    p_values = [
        autoregressive_p_values(errors(rng, pole), FITTED, TERM, OUTPUTS)[0] for _ in range(60)
    ]
    # Of 60, a share of 5 % is exceeded by 11 with a probability of 4e-5.
    assert np.sum(np.array(p_values) < 0.05) <= 11


def test_slow_errors_beneath_white_noise_are_no_faster_term():
    """Gusts that a lightly damped motion turns into errors with a period of 100 samples."""
    rng = np.random.default_rng(0)
    motion = [1.0, -2 * 0.982 * np.cos(0.06), 0.982**2]
    fitted = np.column_stack([np.ones(600), np.arange(600.0)])
    p_values = []
    for _ in range(16):
        gusts = lfilter([1.0], [1.0, -0.96], rng.standard_normal(1100))
        errors = np.asarray(lfilter([1.0], motion, gusts))[500:]
        inputs = np.repeat(rng.choice([-1.0, 1.0], (60, 10)), 10, axis=0)
        effects = np.asarray(lfilter([1.0], motion, inputs, axis=0))
        terms = effects / effects.std(axis=0) + 0.3 * inputs
        residuals = errors / errors.std() + 0.1 * rng.standard_normal(600)
        p_values.extend(autoregressive_p_values(residuals, fitted, terms, [[np.arange(600)]]))
    # Differences of samples alone, with which such terms were tested, had 21 below.
    assert np.sum(np.array(p_values) < 0.1) <= 16


def test_a_slow_term_is_seen_although_it_colors_the_residuals():
    rng = np.random.default_rng(4)
    residuals = 20 * TERM[:, 0] + rng.standard_normal(N)
    wrong = np.sin(17 * T)[:, None]
    p_right, p_wrong = autoregressive_p_values(residuals, FITTED, np.hstack([TERM, wrong]), OUTPUTS)
    assert p_right < 1e-6
    assert p_wrong > 1e-4


def test_two_outputs_with_gaps_have_errors_of_their_own():
    rng = np.random.default_rng(5)
    slow, white = errors(rng, 0.95), 0.01 * rng.standard_normal(N)
    term = np.concatenate([np.zeros(N), np.cos(40 * T)])[:, None]
    fitted = np.vstack([FITTED, FITTED])
    outputs = [[np.arange(100), np.arange(120, N)], [np.arange(N, N + 5), np.arange(N + 10, 2 * N)]]
    together = np.concatenate([slow, white])
    (p_absent,) = autoregressive_p_values(together, fitted, term, outputs)
    (p_present,) = autoregressive_p_values(together + 0.01 * term[:, 0], fitted, term, outputs)
    assert p_present < 1e-6
    assert p_absent > 1e-3


def test_a_constant_offset_is_never_told_from_a_drift():
    rng = np.random.default_rng(6)
    (p_value,) = autoregressive_p_values(
        5 + rng.standard_normal(N), FITTED[:, :1], np.ones((N, 1)), OUTPUTS
    )
    assert p_value == 1.0


def test_a_term_that_is_nearly_an_effect_of_parameters_counts_by_what_remains():
    # As in an unstable model, where both grow alike: a billionth of the term is its own.
    residuals = 0.5 * TERM[:, 0] + np.random.default_rng(7).standard_normal(N)
    near = FITTED[:, 1:] + 1e-9 * TERM
    p_near, p_alone = autoregressive_p_values(residuals, FITTED, np.hstack([near, TERM]), OUTPUTS)
    assert p_alone < 0.1
    assert p_near == pytest.approx(p_alone, rel=1e-4)


def sharing(rng):
    """Return errors of two outputs in rows by turns: process noise through a lag and its integral."""
    noise = 0.3 * rng.standard_normal(N + 500)
    rate = lfilter([1.0], [1.0, -0.9], noise)
    angle = lfilter([0.1], [1.0, -0.98], rate)
    both = np.column_stack([rate, angle])[500:] + 0.02 * rng.standard_normal((N, 2))
    return both.ravel()


def test_process_noise_that_reaches_two_outputs_is_rarely_called_a_term():
    rng = np.random.default_rng(5)
    shape = lfilter([1.0], [1.0, -0.9], np.sign(np.sin(17 * T)))
    term = np.column_stack([shape, lfilter([0.1], [1.0, -0.98], shape)]).reshape(-1, 1)
    outputs = [[np.arange(0, 2 * N, 2)], [np.arange(1, 2 * N, 2)]]
    fitted = np.kron(FITTED, np.eye(2))
    p_values = [
        autoregressive_p_values(sharing(rng), fitted, term, outputs, 2)[0] for _ in range(60)
    ]
    assert np.sum(np.array(p_values) < 0.05) <= 11
    (present,) = autoregressive_p_values(sharing(rng) + term[:, 0], fitted, term, outputs, 2)
    assert present < 1e-6


@pytest.mark.parametrize("pole", [0.0, 0.9])
def test_terms_are_seen_together_that_none_of_them_shows(pole):
    rng = np.random.default_rng(9)
    terms = np.cos(np.pi * np.arange(5, 12) * T[:, None])

    def p_together(size):
        residuals = errors(rng, pole) + size * terms.sum(axis=1)
        (p_value,) = autoregressive_p_values(residuals, FITTED, terms, OUTPUTS, sizes=[7])
        return p_value

    absent = np.array([p_together(0.0) for _ in range(60)])
    # Estimated autoregressions make small probabilities up to five times as frequent.
    assert np.sum(absent < 0.003) <= 3
    assert p_together(1.0 / (1 - pole)) < 1e-6
