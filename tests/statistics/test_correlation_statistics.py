"""Tests of residuals against the distribution that they promise."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import chi2, kstest, norm

from greybox.statistics.correlation_statistics import (
    cross_correlation,
    mean_test,
    whiteness,
    whiteness_of_means,
)
from greybox.statistics.residual_autocorrelation import autoregression


def colored(values, random, count=400):
    return lfilter([1], [1, -values], random.normal(size=count + 50))[50:]


def test_whiteness_of_white_noise_is_rejected_as_often_as_said():
    """p values of white residuals are uniform; those of colored ones are not."""
    p_values = []
    for seed in range(300):
        e = np.random.default_rng(seed).standard_normal(400)
        e[::7] = np.nan
        p_values.append(whiteness([e[:150], e[150:]], lags=10).p_value)
    assert kstest(p_values, "uniform").pvalue > 0.01
    colored = lfilter([1], [1, -0.5], np.random.default_rng(0).standard_normal(400))
    tested = whiteness([colored])
    assert tested.p_value < 1e-6
    assert tested.correlations[0] == pytest.approx(0.5, abs=0.1)


def test_means_show_slow_errors_that_noise_hides_from_sample_to_sample():
    random = np.random.default_rng(0)
    slow = lfilter([0.1], [1, -(0.99**0.5)], random.normal(size=4000))
    series = 0.2 * slow + random.normal(size=4000)
    tests = whiteness_of_means([series[:1000], series[1000:]], lags=12)
    assert [count for count, _ in tests] == [1, 4, 16]
    by_sample = whiteness([series[:1000], series[1000:]], lags=12)
    assert_allclose(tests[0][1].statistic, by_sample.statistic)
    assert np.all(tests[0][1].correlations < 0.1)
    assert tests[-1][1].correlations[0] > 0.2

    # By hand: the means of 16 samples, without one that lacks more than half of them.
    holes = series.copy()
    holes[32:41] = np.nan
    means = series.reshape(-1, 16).mean(axis=1)
    means[2] = np.nan
    assert_allclose(
        whiteness_of_means([holes], lags=12)[-1][1].statistic,
        whiteness([means], lags=12).statistic,
    )


def test_means_of_white_noise_are_rejected_as_often_as_said():
    random = np.random.default_rng(1)
    least = []
    for _ in range(1000):
        tests = whiteness_of_means([random.normal(size=3000)], lags=12)
        least.append(len(tests) * min(test.p_value for _, test in tests))
    # A share of 0.01, with a standard deviation of 0.003.
    assert np.mean(np.array(least) < 0.01) < 0.022


def test_the_statistic_is_that_of_ljung_and_box():
    e = np.random.default_rng(1).standard_normal(300)
    tested = whiteness([e], lags=5)
    centered = e - e.mean()
    r = np.array([centered[k:] @ centered[: e.size - k] for k in range(1, 6)]) / (
        centered @ centered
    )
    assert_allclose(tested.correlations, r)
    assert tested.statistic == pytest.approx(300 * 302 * np.sum(r**2 / (300 - np.arange(1, 6))))
    assert tested.dof == 5


def test_cross_correlation_is_rejected_as_often_as_said_for_colored_inputs_and_residuals():
    p_values = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u = lfilter([1], [1, -0.9], rng.standard_normal(600))
        e = lfilter([1], [1, -0.6], rng.standard_normal(600))
        p_values.append(cross_correlation([e], [u], lags=8).p_value)
    assert np.mean(np.array(p_values) < 0.05) < 0.1
    u = np.random.default_rng(0).standard_normal(600)
    e = np.random.default_rng(1).standard_normal(600) + 0.3 * np.roll(u, 2)
    tested = cross_correlation([e], [u], lags=8)
    assert tested.p_value < 1e-6
    assert np.abs(tested.correlations).argmax() == 1


def test_feedback_is_found_and_the_color_of_either_signal_is_not_taken_for_it():
    p_values = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u = lfilter([1], [1, -0.9], rng.standard_normal(600))
        # What a model without dynamics from u would leave, besides errors of their own.
        e = lfilter([1], [1, -0.6], rng.standard_normal(600)) + lfilter([0, 0.5], [1, -0.8], u)
        p_values.append(cross_correlation([u[:350], u[350:]], [e[:350], e[350:]], lags=8).p_value)
    assert 0.01 < np.mean(np.array(p_values) < 0.05) < 0.1

    rng = np.random.default_rng(0)
    e = lfilter([1], [1, -0.9], rng.standard_normal(600))
    command = np.repeat(rng.standard_normal(60), 10)
    found = cross_correlation([command - 0.3 * np.roll(e, 2)], [e], lags=8)
    assert found.p_value < 1e-6
    assert np.abs(found.correlations).argmax() == 1
    e[50:90] = np.nan
    assert (
        cross_correlation([command - 0.3 * np.roll(np.nan_to_num(e), 2)], [e], lags=8).p_value
        < 1e-6
    )
    assert math.isnan(cross_correlation([np.ones(600)], [e]).p_value)


def test_a_mean_of_correlated_values_has_the_error_of_their_spectrum_at_zero():
    """An autoregression of 0.8 multiplies the variance of the mean by (1 + 0.8) / (1 - 0.8) = 9."""
    means = []
    errors = []
    for seed in range(200):
        e = lfilter([1], [1, -0.8], np.random.default_rng(seed).standard_normal(1100))[100:]
        mean, error = mean_test([e[:500], e[500:]])
        means.append(mean)
        errors.append(error)
    assert np.mean(errors) == pytest.approx(np.std(means), rel=0.15)
    assert np.mean(errors) == pytest.approx(3 * math.sqrt(1 / 0.36 / 1000), rel=0.1)


@pytest.mark.parametrize("values", [[], [1.0], [1.0, 2.0]])
def test_too_few_values_are_not_tested(values):
    assert math.isnan(whiteness([np.array(values)]).p_value)
    assert math.isnan(cross_correlation([np.array(values)], [np.array(values)]).p_value)
    assert math.isnan(mean_test([np.array(values)])[1])


def test_whiteness_has_its_nominal_size_and_finds_color():
    random = np.random.default_rng(0)
    holes = [random.normal(size=400) for _ in range(400)]
    for e in holes[::2]:
        e[random.uniform(size=400) < 0.2] = np.nan
    assert 0.02 < np.mean([whiteness([e]).p_value < 0.05 for e in holes]) < 0.085
    assert np.mean([whiteness([colored(0.3, random)]).p_value < 0.05 for _ in range(50)]) > 0.9
    # Two stretches tell of correlations within them alone.
    step = np.repeat([5.0, -5.0], 200)
    halves = np.split(random.normal(size=400) + 0 * step, 2)
    assert whiteness(halves).dof == 25
    assert np.isnan(whiteness([np.full(9, np.nan)]).p_value)


def test_correlation_with_the_input_has_its_nominal_size_and_finds_what_was_missed():
    random = np.random.default_rng(1)
    for color in (0.0, 0.7):
        p = [
            cross_correlation([colored(color, random)], [colored(0.9, random)]).p_value
            for _ in range(300)
        ]
        assert 0.015 < np.mean(np.array(p) < 0.05) < 0.10, color
    missed = []
    for _ in range(100):  # 95 of 100 are expected
        u = colored(0.9, random)
        missed.append(
            cross_correlation([random.normal(size=400) + 0.15 * np.roll(u, 3)], [u]).p_value < 0.05
        )
    assert np.mean(missed) > 0.9


@pytest.mark.parametrize("kind", ["step", "drift"])
def test_an_input_that_hardly_changes_is_no_alarm(kind):
    """White errors and an input that is independent of them: as many alarms as the level says."""
    random = np.random.default_rng(2)
    step = (np.arange(400) > 200).astype(float)
    p = []
    for _ in range(300):
        u = step if kind == "step" else np.cumsum(random.normal(size=400))
        p.append(cross_correlation([random.normal(size=400)], [u]).p_value)
    assert 0.015 < np.mean(np.array(p) < 0.05) < 0.10


@pytest.mark.parametrize("kind", ["sweep", "sine"])
def test_no_feedback_is_seen_in_sweeps_beside_colored_errors(kind):
    """Their samples follow from earlier ones, so that correlations at many lags are one number."""
    random = np.random.default_rng(2)
    time = 0.05 * np.arange(300)
    p, back = [], []
    for phase in random.uniform(0, 2 * np.pi, 200):
        angle = 2 * time if kind == "sine" else 0.3 * time + 0.12 * time**2
        u, e = np.sin(angle + phase), lfilter([1], [1, -0.8], random.normal(size=300))
        p.append(cross_correlation([u], [e]).p_value)
        back.append(cross_correlation([u - 0.02 * np.roll(e, 2)], [e]).p_value)
    assert np.mean(np.array(p) < 0.01) < 0.04
    assert np.mean(np.array(back) < 0.01) > 0.9


def test_the_error_of_a_mean_takes_the_correlation_into_account():
    random = np.random.default_rng(2)
    z = [np.divide(*mean_test([colored(0.7, random)])) for _ in range(300)]
    assert 0.85 < np.std(z) < 1.25


def test_the_bound_is_that_of_99_percent_of_a_normal_distribution_and_its_crossings_are_counted():
    random = np.random.default_rng(3)
    e, u = random.normal(size=(2, 500))
    for tested, used in (
        (whiteness([e]), 500),
        (cross_correlation([u], [e]), 499),
    ):
        assert tested.bound == pytest.approx(norm.ppf(0.995) / math.sqrt(used), rel=2e-4)


def test_fitted_parameters_of_the_noise_are_no_degrees_of_freedom():
    e = np.random.default_rng(1).normal(size=60)
    found = [whiteness([e], lags=5, fitted=k) for k in (0, 2, 4, 9)]
    assert [tested.dof for tested in found] == [5, 3, 1, 1]
    for tested in found:
        assert tested.p_value == pytest.approx(chi2.sf(found[0].statistic, tested.dof))


def test_three_values_are_tested():
    three = np.array([1.0, 3.0, -2.0])
    assert math.isfinite(whiteness([three], lags=1).p_value)
    assert math.isfinite(cross_correlation([three], [three[::-1]], lags=1).p_value)
    mean, error = mean_test([three])
    assert (mean, error) == pytest.approx((2 / 3, np.std(three) / math.sqrt(3)))


def test_correlations_of_white_signals_are_those_of_products():
    """Without color nothing is filtered."""
    random = np.random.default_rng(6)
    e, u = random.normal(size=(2, 300))
    e, u = e - e.mean(), u - u.mean()
    assert autoregression([e]).size == autoregression([u]).size == 1
    back = cross_correlation([u], [e], lags=4)
    r = [u[k:] @ e[:-k] / (300 - k) / math.sqrt(np.mean(e**2) * np.mean(u**2)) for k in range(1, 5)]
    assert 3.9 < back.dof <= 4
    assert_allclose(back.correlations, r)
    squares = np.sum((300 - np.arange(1, 5)) * np.square(r))
    assert back.statistic == pytest.approx(squares * back.dof / 4)


def test_lags_without_a_pair_are_not_tested_and_one_pair_is():
    random = np.random.default_rng(4)
    e, u = random.normal(size=(2, 40))
    e[1::2] = np.nan  # every second lag has no pair
    odd = whiteness([e], lags=6)
    assert odd.dof == 3
    assert_allclose(odd.correlations[::2], 0)
    back = cross_correlation([u[:5]], [e[:5]], lags=4)
    assert back.dof == 4  # of u at 4 and e at 0 there is one pair
    assert back.correlations[3] != 0


def test_constants_in_residuals_and_inputs_change_no_test():
    random = np.random.default_rng(5)
    e, u = lfilter([1], [1, -0.5], random.normal(size=(2, 300)))
    found = cross_correlation([e + 7], [u - 400])
    alone = cross_correlation([e], [u])
    assert_allclose([found.statistic, *found.correlations], [alone.statistic, *alone.correlations])
    assert whiteness([e + 7]).statistic == pytest.approx(whiteness([e]).statistic)


def test_what_is_not_tested_has_no_degrees_of_freedom():
    nothing = whiteness([[1.0, 2.0]], lags=4)
    assert nothing.dof == 0
    assert nothing.correlations.shape == (4,)
    assert all(math.isnan(value) for value in (nothing.statistic, nothing.p_value, nothing.bound))
