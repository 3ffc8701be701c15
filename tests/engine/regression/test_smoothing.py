"""Smoothing: derivatives of known truths, gaps and missing samples, uneven sampling refused."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.fft import dst
from scipy.signal import savgol_filter

from greybox.engine.regression.smoothing import (
    differentiate,
    low_pass,
    reach,
    smooth,
    stretches,
    without_holes,
)

STEP = 0.02
TIME = np.arange(1500) * STEP
OMEGA = 2 * np.pi * np.array([0.1, 0.37, 0.9, 1.9])
PHASE = np.array([0.3, 1.7, 4.0, 2.2])


def truth(derivative=0):
    waves = OMEGA**derivative * np.sin(
        np.multiply.outer(TIME, OMEGA) + PHASE + derivative * np.pi / 2
    )
    return waves @ np.array([1.0, 0.8, 0.5, 0.2])


def noisy(size, seed=0):
    return truth() + size * np.random.default_rng(seed).normal(size=TIME.size)


def slope(values, time=TIME, **options):
    return differentiate(time, smooth(time, values, **options)[0])


def derivative_error(derivative):
    return float(np.sqrt(np.mean((derivative - truth(1))[75:-75] ** 2)) / np.std(truth(1)))


@pytest.mark.parametrize(("size", "limit"), [(0.0, 1e-4), (1e-3, 6e-3), (0.01, 0.03), (0.1, 0.15)])
def test_derivative_of_a_known_signal(size, limit):
    assert derivative_error(slope(noisy(size))) < limit


@pytest.mark.parametrize("size", [0.01, 0.1])
def test_no_window_of_savitzky_and_golay_does_better(size):
    ours = [derivative_error(slope(noisy(size, seed))) for seed in range(5)]
    windows = range(5, 151, 4)
    theirs = [
        min(
            derivative_error(savgol_filter(noisy(size, seed), w, 3, deriv=1, delta=STEP))
            for w in windows
        )
        for seed in range(5)
    ]
    assert np.mean(ours) < np.mean(theirs)


@pytest.mark.parametrize("size", [1e-3, 0.01, 0.1])
def test_the_cutoff_has_the_least_score_of_cross_validation(size):
    _, cutoff = smooth(TIME, noisy(size))
    # Generalized cross-validation: of what a cutoff removes, the square over that of the degrees of
    # freedom removed.
    values = noisy(size)
    amplitude = dst((values - np.linspace(values[0], values[-1], 1500))[1:-1], type=1, norm="ortho")
    omega = np.pi * np.arange(1, 1499) / TIME[-1]

    def score(cutoff):
        removed = 1 - 1 / (1 + (omega / cutoff) ** 8)
        return np.sum((removed * amplitude) ** 2) / np.sum(removed) ** 2

    # Among many, as low as any; one between them may be better.
    assert score(cutoff) <= min(map(score, np.geomspace(omega[2], omega[-1], 400))) * (1 + 1e-9)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_a_straight_line_passes_with_its_own_slope(unit):
    known, cutoff = smooth(TIME, unit * (3 - 0.5 * TIME))
    assert cutoff == pytest.approx(np.pi * 1498 / TIME[-1])  # all passes
    assert_allclose(differentiate(TIME, known), -0.5 * unit, rtol=1e-9)
    assert smooth(TIME, unit * noisy(0.01))[1] == pytest.approx(smooth(TIME, noisy(0.01))[1])


def test_the_filter_halves_its_cutoff_and_passes_a_line():
    line = 3 - 0.5 * TIME
    assert_allclose(low_pass(line, STEP, 2.0), line, atol=1e-12)
    omega = 10 * np.pi / TIME[-1]
    wave = np.sin(omega * TIME)
    assert_allclose(low_pass(wave, STEP, omega), wave / 2, atol=1e-12)
    columns = low_pass(np.column_stack([wave, line]), STEP, omega)
    assert_allclose(columns, np.column_stack([wave / 2, line]), atol=1e-12)


def test_the_reach_is_that_of_an_impulse():
    cutoff = 5.0
    impulse = np.zeros(TIME.size)
    impulse[750] = 1.0
    answer = np.abs(low_pass(impulse, STEP, cutoff))
    beyond = np.abs(TIME - TIME[750]) > 2 * reach(cutoff)
    assert answer[beyond].max() < 0.02 * answer.max()
    assert reach(cutoff) * cutoff == pytest.approx(np.log(10) / 0.38, rel=0.01)


def test_nothing_crosses_a_gap():
    time = np.where(TIME < 15, TIME, TIME + 7)
    jump = np.where(TIME < 15, 0.0, 100.0)
    known, _ = smooth(time, truth() + jump)
    assert np.abs(known - truth() - jump).max() < 0.01


def test_single_missing_samples_are_interpolated_and_longer_holes_are_not():
    values = noisy(0.001)
    values[[300, 700]] = np.nan
    values[1000:1010] = np.nan
    known, _ = smooth(TIME, values)
    assert np.flatnonzero(np.isnan(known)).tolist() == list(range(1000, 1010))
    assert known[[300, 700]] == pytest.approx(truth()[[300, 700]], abs=0.01)
    assert [rows.start for rows in stretches(TIME, known)] == [0, 1010]
    assert stretches(TIME, np.full(1500, np.nan)) == []


@pytest.mark.parametrize(("count", "is_filled"), [(3, False), (4, True)])
def test_a_cubic_through_four_samples_fills_a_hole(count, is_filled):
    cubic = 0.02 * np.arange(5.0) ** 3
    values = np.where(np.isin(np.arange(5), (2, *range(count + 1, 5))), np.nan, cubic)
    filled = without_holes(TIME[:5], values)
    assert np.isfinite(filled[2]) == is_filled
    if is_filled:
        assert filled[2] == pytest.approx(cubic[2])
    one = np.where(np.arange(5) == 2, 1.0, np.nan)
    np.testing.assert_array_equal(without_holes(TIME[:5], one), one)
    np.testing.assert_array_equal(without_holes(TIME[:5], np.full(5, np.nan)), np.full(5, np.nan))


@pytest.mark.parametrize(
    ("time", "values", "sentence"),
    [
        (
            TIME[:8],
            TIME[:8],
            "no stretch of 12 samples without a gap among its 8, of which 8 are finite",
        ),
        (
            TIME,
            np.where(np.arange(1500) % 10, np.nan, 1.0),
            "of which 150 are finite: put it on the time base",
        ),
    ],
)
def test_bad_input(time, values, sentence):
    with pytest.raises(ValueError, match=sentence):
        smooth(time, values)


def test_the_last_samples_of_a_stretch_are_filled_as_the_first_are():
    time = 0.1 * np.arange(12)
    truth = 1 + time - 0.3 * time**3
    for hole in (1, 5, 10):
        values = np.where(np.arange(12) == hole, np.nan, truth)
        assert_allclose(without_holes(time, values), truth, atol=1e-12)


def steps(*lengths):
    """Time from the steps between samples, each so many times 0.1 s."""
    return 0.1 * np.concatenate([[0.0], np.cumsum(lengths)])


def test_a_stretch_has_twelve_samples():
    values = np.arange(40.0) ** 2
    values[[12, 13, 25, 26]] = np.nan  # of 12, 11 and 13 samples
    known, _ = smooth(0.1 * np.arange(40), values)
    assert np.isnan(known[14:25]).all()
    assert np.isfinite(known[[0, 11, 27, 39]]).all()
    with pytest.raises(ValueError, match="no stretch of 12 samples"):
        smooth(0.1 * np.arange(11), np.arange(11.0) ** 2)


def test_a_cutoff_serves_all_stretches_and_is_weighed_by_both():
    """One alone has no noise, the other has: together they are judged as one signal."""
    random = np.random.default_rng(3)
    time = np.concatenate([TIME[:300], TIME[:500] + 40])
    values = np.sin(3 * time) + 0.05 * random.normal(size=800)
    _, cutoff = smooth(time, values)
    omega, power = [], []
    for part in (values[:300], values[300:]):
        n = len(part)
        power += [dst((part - np.linspace(part[0], part[-1], n))[1:-1], type=1, norm="ortho") ** 2]
        omega += [np.pi * np.arange(1, n - 1) / ((n - 1) * STEP)]
    omega, power = np.concatenate(omega), np.concatenate(power)

    def removed(cutoff):
        return 1 - 1 / (1 + (omega / cutoff) ** 8)

    scores = [removed(c) ** 2 @ power / removed(c).sum() ** 2 for c in (cutoff, 0.97 * cutoff)]
    assert scores[0] < scores[1]
    assert scores[0] < removed(1.03 * cutoff) ** 2 @ power / removed(1.03 * cutoff).sum() ** 2


def test_white_noise_alone_is_all_removed():
    """The least cutoff that is tried passes little more than the third sine of the record."""
    values = np.random.default_rng(5).normal(size=400)
    known, cutoff = smooth(TIME[:400], values)
    third = 3 * np.pi / TIME[399]
    assert third * (1 - 1e-9) <= cutoff < 40 * third
    assert np.std(known) < 0.5


def test_holes_are_filled_within_stretches_and_not_across_gaps():
    """Samples 0.1 s apart but for a gap of 5 s; cubics of each side, so that a spline through both would be off."""
    time = np.concatenate([steps(*[1] * 8), 6 + steps(*[1] * 8)])
    truth = np.where(time < 3, time**3 - time, 50 - 2 * time**3)
    values = truth.copy()
    values[[3, 12]] = np.nan
    assert_allclose(without_holes(time, values), truth, rtol=1e-9)
    values[[4, 13]] = (
        np.nan
    )  # two in a row are a gap, between stretches of three and four known samples
    filled = without_holes(time, values)
    assert np.flatnonzero(np.isnan(filled)).tolist() == [3, 4, 12, 13]
    assert [(rows.start, rows.stop) for rows in stretches(time, filled)] == [
        (0, 3),
        (5, 9),
        (9, 12),
        (14, 18),
    ]


def test_a_derivative_has_the_order_of_a_cubic_spline():
    """Halving the step divides its error by sixteen, away from the ends."""
    errors = []
    for count in (81, 161):
        time = np.linspace(0, 4, count)
        found = differentiate(time, np.sin(3 * time))
        errors.append(np.abs(found - 3 * np.cos(3 * time))[count // 4 : -(count // 4)].max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


@pytest.mark.parametrize(
    "curve", [lambda t: np.exp(-t), lambda t: t**3 - t, np.sin], ids=["decay", "cubic", "sine"]
)
def test_of_a_smooth_curve_without_noise_all_passes(curve):
    """No cutoff above the highest of the sines is tried: there is nothing beyond."""
    _, cutoff = smooth(TIME[:200], curve(TIME[:200]))
    assert cutoff == pytest.approx(np.pi * 198 / TIME[199], rel=1e-6)


def test_a_slower_clock_behind_a_hole_is_smoothed_at_its_own_step():
    """Its steps are 1.6 times the median one, and no rows are missing there."""
    time = np.r_[np.arange(1000) * 0.01, 12 + np.arange(400) * 0.016]
    wave = np.sin(2 * time)
    known, _ = smooth(time, wave + 1e-3 * np.random.default_rng(0).standard_normal(time.size))
    assert np.abs(known - wave).max() < 2e-3
    assert [rows.start for rows in stretches(time, known)] == [0, 1000]
    slope = differentiate(time, known)
    inside = np.r_[100:900, 1060:1340]
    assert np.abs(slope - 2 * np.cos(2 * time))[inside].max() < 0.05
