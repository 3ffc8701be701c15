"""Complex amplitudes of signals that are known."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampled_sines import irregular, sine

from greybox.spectral.demodulation import (
    UnusableSegmentError,
    demodulate,
    least_squares,
    quadrature,
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
@settings(max_examples=60, deadline=None)
def test_least_squares_is_exact_on_any_sampling(seed, omega, alpha, beta, offset, trend):
    t = irregular(seed, max(6.0, 20 / omega))
    amplitude = complex(alpha, beta)
    values = sine(t - t[0], omega, amplitude) + offset + trend * t
    assert abs(demodulate(t, values, omega) - amplitude) < 1e-9


@given(
    samples=st.integers(8, 300), periods=st.integers(1, 8), alpha=uneven(-3, 3), beta=uneven(-3, 3)
)
@settings(max_examples=60, deadline=None)
def test_quadrature_is_exact_when_a_period_is_a_whole_number_of_samples(
    samples, periods, alpha, beta
):
    t = np.arange(samples * periods) * STEP
    omega = 2 * math.pi / (samples * STEP)
    values = sine(t, omega, complex(alpha, beta)) + 7
    assert abs(demodulate(t, values, omega, method="quadrature") - complex(alpha, beta)) < 1e-9


def test_quadrature_is_not_exact_otherwise_but_near():
    t = np.arange(4000) * STEP
    values = np.sin(20.11 * t) + 0.3
    assert 1e-6 < abs(demodulate(t, values, 20.11, method="quadrature") - 1) < 0.01
    assert abs(demodulate(t, values, 20.11) - 1) < 1e-12


def test_the_last_whole_periods_after_the_settling_time_are_used():
    t = np.arange(4000) * STEP
    omega = 4.0
    values = np.where(t < 2.0, 100.0, np.sin(omega * t))
    assert abs(demodulate(t, values, omega, settle=2.0) - 1) < 1e-9
    assert abs(demodulate(t, values, omega, periods=3) - 1) < 1e-9
    assert (
        abs(
            demodulate(t, np.where(np.arange(4000) % 7 == 0, np.nan, values), omega, settle=2.0) - 1
        )
        < 1e-9
    )
    with pytest.raises(ValueError, match=r"10 s are too short for 2 s of settling and 6 periods"):
        demodulate(t, values, omega, settle=2.0, periods=6)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            {"omega": 0.1},
            "cannot be demodulated at 0.1 rad/s: 10 s are too short for 0 s of settling and 1 periods",
        ),
        ({"omega": -1.0}, "the frequency is -1 rad/s: it must be above 0"),
        ({"omega": 1000.0}, "has fewer than four samples"),
        (
            {"omega": 5.0, "method": "fft"},
            "the method is 'fft': it must be 'least-squares' or 'quadrature'",
        ),
        ({"omega": 5.0, "periods": 0}, "0 periods"),
        ({"omega": 5.0, "values": np.zeros(3)}, "time has 4000 samples but values has 3"),
        ({"omega": 5.0, "values": np.full(4000, np.nan)}, "only 0 samples"),
    ],
)
def test_what_demodulate_refuses(words, sentence):
    t = np.arange(4000) * STEP
    with pytest.raises(ValueError, match=sentence):
        demodulate(t, **{"values": np.sin(t), **words})


def test_a_spectral_line_is_that_of_the_discrete_fourier_transform():
    """Over whole periods sine, cosine and constant are orthogonal: x̂ = 2j/n Σ x exp(-jωt) in sines and cosines."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((2, 500))
    t = np.arange(500) * STEP
    for k in (3, 10):
        expected = 2j / 500 * np.fft.fft(x)[:, k]
        got = spectral_line(t, x, 2 * math.pi * k / (500 * STEP), 0.0)
        np.testing.assert_allclose(got, expected.real + 1j * expected.imag, atol=1e-12)


@pytest.mark.parametrize("start", [0.0, 100.0, -7.0])
def test_the_drift_is_the_change_of_the_trend_over_the_window_wherever_it_begins(start):
    t = start + np.arange(4000) * STEP
    values = sine(t - start, 4.0, 1 - 2j) + 5 + 0.3 * (t - start)
    amplitudes, drift, residual = least_squares(t, values[None, :], 4.0, start, 2)
    assert drift == pytest.approx([0.3 * (t[-1] - t[0])])
    assert abs(amplitudes[0, 0] - (1 - 2j)) < 1e-9
    assert np.abs(residual).max() < 1e-9


def test_quadrature_weighs_a_sample_by_half_the_distance_of_its_neighbors():
    t = np.array([0.0, 0.1, 0.4, 0.5, 0.9])
    x = np.array([[1.0, -2.0, 0.5, 3.0, 1.5]])
    weight = [0.1, 0.2, 0.2, 0.25, 0.4]  # at the ends, the whole distance of the one that there is
    sums = [
        2
        / sum(weight)
        * sum(w * v * f(3 * (s - 0.2)) for w, v, s in zip(weight, x[0], t, strict=True))
        for f in (math.sin, math.cos)
    ]
    assert quadrature(t, x, 3.0, 0.2) == pytest.approx([sums[0] + 1j * sums[1]])


def samples(count, step=0.1):
    return 3 + step * np.arange(count)


@pytest.mark.parametrize(
    ("count", "settle", "periods"), [(40, 0.0, 4), (39, 0.0, 3), (40, 1.0, 3), (40, 1.05, 2)]
)
def test_whole_periods_reach_from_the_last_sample_back(count, settle, periods):
    """Of ten samples each: the last sample ends its own interval."""
    rows, found = whole_periods(samples(count), 2 * math.pi, settle, None)
    assert found == periods
    assert np.flatnonzero(rows).tolist() == list(range(count - 10 * periods, count))
    rows, found = whole_periods(samples(count), 2 * math.pi, settle, periods - 1)
    assert (rows.sum(), found) == (10 * (periods - 1), periods - 1)


def test_windows_have_eight_samples_four_in_a_period_and_a_third_of_each():
    assert whole_periods(samples(8), 2 * math.pi / 0.8, 0.0, None)[1] == 1
    with pytest.raises(UnusableSegmentError, match=r"^only 7 samples$"):
        whole_periods(samples(7), 2 * math.pi / 0.7, 0.0, None)
    assert whole_periods(samples(20, 0.25), 2 * math.pi, 0.0, None)[1] == 5
    with pytest.raises(
        UnusableSegmentError, match=r"a period of 0\.99 s has fewer than four samples of 0.25 s"
    ):
        whole_periods(samples(20, 0.25), 2 * math.pi / 0.99, 0.0, None)
    for left, usable in ((4, True), (2, False)):
        kept = np.r_[0:50, 50 : 50 + left, 60:100]
        if usable:
            assert whole_periods(samples(100)[kept], 2 * math.pi, 0.0, None)[1] == 10
        else:
            with pytest.raises(
                UnusableSegmentError, match=r"a whole period is missing after 3\.0 s"
            ):
                whole_periods(samples(100)[kept], 2 * math.pi, 0.0, None)
    for omega in (0.0, math.inf):
        with pytest.raises(
            UnusableSegmentError, match=f"the frequency is {omega:g} rad/s: it must be above 0"
        ):
            whole_periods(samples(100), omega, 0.0, None)


@pytest.mark.parametrize(
    ("per_period", "expected"), [(5.1, 2), (4.9, 1), (7.6, 3), (7.4, 2), (2.2, 1), (100, 4)]
)
def test_harmonics_are_fitted_up_to_four_fifths_of_half_the_sampling_rate(per_period, expected):
    """Of the k-th there are so many samples a period over k, and 2.5 are the fewest."""
    t = samples(200)
    amplitudes, _, _ = least_squares(t, np.sin(t)[None], 2 * math.pi / (0.1 * per_period), 3.0, 4)
    assert amplitudes.shape == (1, expected)


def test_one_harmonic_is_fitted_unless_more_are_asked_for():
    t = irregular(3, 12.0)
    values = sine(t - t[0], 4.0, 1 - 2j) + 0.5 * np.sin(8.0 * (t - t[0]))
    assert abs(demodulate(t, values, 4.0) - (1 - 2j)) > 1e-5
    assert abs(demodulate(t, values, 4.0, harmonics=2) - (1 - 2j)) < 1e-9
