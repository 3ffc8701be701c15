"""The sentences of a comparison, and the tests behind them, against brute force and a known truth."""

from dataclasses import replace

import numpy as np
import pytest
from drag_flights import QUADRATIC, LinearDrag, QuadraticDrag, fitted, flight
from scipy.stats import ttest_1samp

import greybox as gb
from greybox.assessment.validation import significance
from greybox.data.files.numbers_in_text import p_text


@pytest.fixture(scope="module")
def fits():
    record = flight(QUADRATIC, 1, duration=15.0)
    return fitted(LinearDrag(), record), fitted(QuadraticDrag(), record)


def test_squares_of_windows_are_those_of_the_residuals(fits):
    one, other = (gb.predict(fit, horizon=2.0) for fit in fits)
    first, second, rounding = significance.mean_squares(one, other)
    noise = min(one.noise[0, 0], other.noise[0, 0])
    assert first == pytest.approx(np.mean(one.residual("v") ** 2, axis=1) / noise)
    assert second == pytest.approx(np.mean(other.residual("v") ** 2, axis=1) / noise)
    assert np.all(rounding < 1e-6 * second)


def verdict(first, second, kind="held-out", labels=("a", "b")):
    """The sentence on two predictions of one record."""
    return significance.prediction_verdict(labels, ((first,), (second,)), kind)


def test_the_winner_does_not_depend_on_the_order(fits):
    wrong, right = (gb.predict(fit) for fit in fits)
    sentence = verdict(wrong, right, labels=("wrong", "right"))
    assert sentence.startswith("right predicts held-out data better than wrong, in ")
    assert sentence == verdict(right, wrong, labels=("right", "wrong"))


def test_too_few_windows_are_no_verdict_and_equal_ones_a_tie(fits):
    few = [gb.predict(fit, horizon=7.0) for fit in fits]
    assert verdict(*few).startswith("2 windows cannot show")
    same = gb.predict(fits[1])
    assert verdict(same, same, "identification").startswith(
        "a and b predict the identification data equally"
    )


def shifted(prediction, errors):
    """The same prediction with these errors (w,) throughout every window."""
    return replace(
        prediction, predicted=prediction.measured("v")[None] - np.asarray(errors)[None, :, None]
    )


def test_few_windows_have_the_p_value_of_students_t(fits):
    made = gb.predict(fits[1], horizon=2.0)
    errors = np.linspace(1.0, 2.0, len(made))
    worse = np.sqrt(errors**2 + np.array([1.0, 0.2, 0.6, 0.9, 0.3, 0.5, 1.1])[: len(made)])
    p = ttest_1samp(worse**2 - errors**2, 0).pvalue
    sentence = verdict(shifted(made, errors), shifted(made, worse))
    assert sentence.startswith("a predicts held-out data better than b")
    assert f"100 % of {len(made)} windows ({p_text(p)})" in sentence


def test_a_few_large_errors_do_not_hide_which_model_is_better_in_nearly_all_windows(fits):
    made = gb.predict(fits[1], horizon=0.4)
    random = np.random.default_rng(0)
    errors = 1 + 0.1 * random.normal(size=len(made))
    worse = errors + 0.5
    worse[3] = 300.0
    sentence = verdict(shifted(made, errors), shifted(made, worse))
    assert sentence.startswith("a predicts held-out data better than b, in 100 % of")
    assert "by the ratios of their squared errors" in sentence
    # As many windows of either sign show nothing, however large the largest is.
    mixed = errors + np.where(np.arange(len(made)) % 2, 0.5, -0.5)
    mixed[3] = 300.0
    assert verdict(shifted(made, errors), shifted(made, mixed)).startswith("The data do not show")


def test_errors_that_swell_slowly_do_not_hide_a_difference_of_a_factor_of_thirty(fits):
    """A mean of few independent swellings shows little, while the smallest error is ten times that of the other."""
    made = gb.predict(fits[1], horizon=0.2)
    random = np.random.default_rng(0)
    errors = 0.00098 * np.exp(0.3 * random.normal(size=len(made)))
    swelling = 2.0 * np.exp(-(((np.arange(len(made)) - 0.5 * len(made)) / 8) ** 2))
    worse = 0.0085 * np.exp(0.3 * random.normal(size=len(made)) + swelling)
    sentence = verdict(shifted(made, errors), shifted(made, worse))
    assert sentence.startswith("a predicts held-out data better than b, in 100 % of")
    # Errors of the same size that swell at other times show nothing.
    later = 0.0085 * np.exp(0.3 * random.normal(size=len(made)) + np.roll(swelling, 12))
    assert verdict(shifted(made, worse), shifted(made, later)).startswith("The data do not show")


@pytest.mark.parametrize(
    ("aic", "words"),
    [
        (1.9, "a and b fit the data equally well"),
        (2.1, "The data do not show"),
        (9.9, "The data do not show"),
        (10.1, "a fits the data better than b (AIC differs by 10.1)."),
        (-10.1, "b fits the data better than a (AIC differs by 10.1)."),
    ],
)
def test_support_by_aic_is_that_of_burnham_and_anderson(aic, words):
    assert significance.verdict_by_aic(("a", "b"), aic).startswith(words)


def test_differences_below_a_thousandth_are_a_tie(fits):
    """The second predicts a little worse in every window: significant, and no matter below 0.1 %."""
    made = gb.predict(fits[1], horizon=2.0)
    errors = np.linspace(1.0, 2.0, len(made))
    for more, words in ((0.0009, "equally well"), (0.0011, "better than")):
        assert words in verdict(shifted(made, errors), shifted(made, errors * np.sqrt(1 + more)))


def test_values_from_the_record_itself_make_its_errors_smaller_by_their_share(fits):
    one = gb.predict(fits[1], horizon=2.0)
    other = replace(one, own={"v_bias": (0.1, 0.01), "theta_bias": (0.0, 0.01)})
    n = int(np.isfinite(one.measured("v")).sum())
    first, second, rounding = significance.mean_squares(one, other)
    assert second / first == pytest.approx(np.full(len(one), n / (n - 2)))
    spread = np.nanstd(one.data["v"])
    assert rounding == pytest.approx(np.full(len(one), (1e-6 * spread) ** 2 / one.noise[0, 0]))


@pytest.mark.parametrize(("share", "words"), [(0.098, "equally well"), (0.1003, "do not show")])
def test_equally_good_is_an_interval_of_the_difference_within_a_tenth(fits, share, words):
    """The wider end of Student's interval of 95 %, as scipy has it, over the smaller mean square."""
    made = gb.predict(fits[1], horizon=2.0)
    z = np.array([1.0, -0.7, 0.2, -0.9, 0.8, -0.6, 0.5])
    assert len(made) == len(z)
    test = ttest_1samp(z, 0)
    widest = test.confidence_interval(0.95).high
    assert test.pvalue > 0.05
    errors = np.linspace(1.0, 2.0, len(z))
    other = np.sqrt(errors**2 + z * share * np.mean(errors**2) / widest)
    for first, second in ((errors, other), (other, errors)):
        assert words in verdict(shifted(made, first), shifted(made, second))


def test_samples_that_one_of_two_predictions_lacks_count_in_neither(fits):
    one, other = (gb.predict(fit, horizon=2.0) for fit in fits)
    lacking = one.predicted.copy()
    lacking[:, 1, 1:] = np.nan
    first, second, _ = significance.mean_squares(replace(one, predicted=lacking), other)
    errors = [p.residual("v").copy() for p in (one, other)]
    noise = min(one.noise[0, 0], other.noise[0, 0])
    for found, e in zip((first, second), errors, strict=True):
        e[1, 1:] = np.nan
        assert found == pytest.approx(np.nanmean(e**2, axis=1) / noise)
