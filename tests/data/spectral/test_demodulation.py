"""Complex amplitudes of signals that are known."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from sampled_sines import amplitude, irregular, sine

from greybox.data.spectral.demodulation import (
    UnusableSegmentError,
    least_squares,
    spectral_line,
    whole_periods,
)

STEP = 1 / 400  # s

uneven = functools.partial(st.floats, allow_nan=False, allow_infinity=False)


@given(
    seed=st.integers(0, 10_000),
    omega=uneven(0.5, 30),
    alpha=uneven(-3, 3),
    beta=uneven(-3, 3),
    offset=uneven(-50, 50),
    trend=uneven(-5, 5),
)
@settings(max_examples=20, deadline=None)
def test_least_squares_is_exact_on_any_sampling(seed, omega, alpha, beta, offset, trend):
    t = irregular(seed, max(6.0, 20 / omega))
    truth = complex(alpha, beta)
    values = sine(t - t[0], omega, truth) + offset + trend * t
    assert abs(amplitude(t, values, omega) - truth) < 1e-9


def test_a_spectral_line_is_that_of_the_discrete_fourier_transform():
    """Over whole periods sine, cosine and constant are orthogonal: x̂ = 2j/n Σ x exp(-jωt) in sines and cosines."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 500))
    t = np.arange(500) * STEP
    for k in (3, 10):
        expected = 2j / 500 * np.fft.fft(x)[:, k]
        got = spectral_line(t, x, 2 * math.pi * k / (500 * STEP))
        np.testing.assert_allclose(got, expected.real + 1j * expected.imag, atol=1e-12)


@pytest.mark.parametrize("start", [0.0, 100.0, -7.0])
def test_the_drift_is_the_change_of_the_trend_over_the_window_wherever_it_begins(start):
    t = start + np.arange(4000) * STEP
    values = sine(t - start, 4.0, 1 - 2j) + 5 + 0.3 * (t - start)
    amplitudes, drift, residual = least_squares(t, values[None, :], 4.0, start, 2)
    assert drift == pytest.approx([0.3 * (t[-1] - t[0])])
    assert abs(amplitudes[0, 0] - (1 - 2j)) < 1e-9
    assert np.abs(residual).max() < 1e-9


def samples(count, step=0.1):
    return 3 + step * np.arange(count)


@pytest.mark.parametrize(
    ("count", "settle", "periods"), [(40, 0.0, 4), (39, 0.0, 3), (40, 1.0, 3), (40, 1.05, 2)]
)
def test_whole_periods_reach_from_the_last_sample_back(count, settle, periods):
    """Of ten samples each: the last sample ends its own interval."""
    rows, found = whole_periods(samples(count), 2 * math.pi, settle)
    assert found == periods
    assert np.flatnonzero(rows).tolist() == list(range(count - 10 * periods, count))


def test_windows_have_eight_samples_four_in_a_period_and_a_third_of_each():
    assert whole_periods(samples(8), 2 * math.pi / 0.8, 0.0)[1] == 1
    with pytest.raises(UnusableSegmentError, match=r"^only 7 samples$"):
        whole_periods(samples(7), 2 * math.pi / 0.7, 0.0)
    assert whole_periods(samples(20, 0.25), 2 * math.pi, 0.0)[1] == 5
    with pytest.raises(
        UnusableSegmentError, match=r"a period of 0\.99 s has fewer than four samples of 0.25 s"
    ):
        whole_periods(samples(20, 0.25), 2 * math.pi / 0.99, 0.0)
    for left, usable in ((4, True), (2, False)):
        kept = np.r_[0:50, 50 : 50 + left, 60:100]
        if usable:
            assert whole_periods(samples(100)[kept], 2 * math.pi, 0.0)[1] == 10
        else:
            with pytest.raises(
                UnusableSegmentError, match=r"a whole period is missing after 3\.0 s"
            ):
                whole_periods(samples(100)[kept], 2 * math.pi, 0.0)
    for omega in (0.0, math.inf):
        with pytest.raises(
            UnusableSegmentError, match=f"the frequency is {omega:g} rad/s: it must be above 0"
        ):
            whole_periods(samples(100), omega, 0.0)


@pytest.mark.parametrize(
    ("per_period", "expected"), [(5.1, 2), (4.9, 1), (7.6, 3), (7.4, 2), (2.2, 1), (100, 4)]
)
def test_harmonics_are_fitted_up_to_four_fifths_of_half_the_sampling_rate(per_period, expected):
    """Of the k-th there are so many samples a period over k, and 2.5 are the fewest."""
    t = samples(200)
    amplitudes, _, _ = least_squares(t, np.sin(t)[None], 2 * math.pi / (0.1 * per_period), 3.0, 4)
    assert amplitudes.shape == (1, expected)


def test_harmonics_matter_on_uneven_sampling():
    t = irregular(3, 12.0)
    values = sine(t - t[0], 4.0, 1 - 2j) + 0.5 * np.sin(8.0 * (t - t[0]))
    one, two = (least_squares(t, values[None], 4.0, t[0], k)[0][0, 0] for k in (1, 2))
    assert abs(one - (1 - 2j)) > 1e-5
    assert abs(two - (1 - 2j)) < 1e-9
