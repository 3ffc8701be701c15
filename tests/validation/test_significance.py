"""The sentences of a comparison, and the tests behind them, against brute force and a known truth."""

import numpy as np
import pytest
from drag_flights import LINEAR, QUADRATIC, Drag, LinearDrag, QuadraticDrag, fitted, flight
from scipy.stats import multivariate_normal, norm

import greybox as gb
from greybox.validation import significance
from greybox.validation.held_out import Predictions


@pytest.fixture(scope="module")
def fits():
    record = flight(QUADRATIC, 1, duration=15.0)
    return fitted(LinearDrag(), record), fitted(QuadraticDrag(), record)


def test_log_likelihoods_are_those_of_the_normal_distribution(fits):
    part = fits[1].records[0]
    expected = norm.logpdf(part.residual("v"), scale=np.sqrt(part.noise[0, 0]))
    assert significance._log_likelihoods(part) == pytest.approx(expected)
    assert np.sum(significance._log_likelihoods(part)) == pytest.approx(-fits[1].cost, rel=1e-6)


class TwoOutputs:
    """A part with correlated residuals of two outputs, of which one sample lacks one."""

    outputs = ("a", "b")

    def __init__(self, noise):
        self.noise = np.array(noise)
        self.e = np.random.default_rng(0).normal(size=(2, 5))
        self.e[1, 2] = np.nan

    def residual(self, name):
        return self.e[self.outputs.index(name)]


def test_a_missing_output_leaves_out_a_sample_only_where_outputs_are_correlated():
    part = TwoOutputs([[1.0, 0.3], [0.3, 0.5]])
    expected = [multivariate_normal.logpdf(e, cov=part.noise) if np.isfinite(e).all() else np.nan for e in part.e.T]
    assert significance._log_likelihoods(part) == pytest.approx(expected, nan_ok=True)
    part = TwoOutputs([[1.0, 0.0], [0.0, 0.5]])
    alone = norm.logpdf(part.e, scale=np.sqrt(np.diag(part.noise))[:, None])
    assert significance._log_likelihoods(part) == pytest.approx(np.nansum(alone, axis=0))


def test_squares_of_windows_are_those_of_the_residuals(fits):
    one, other = (gb.predict(fit, horizon=2.0) for fit in fits)
    first, second, rounding = significance._mean_squares(one, other)
    noise = min(one.noise[0, 0], other.noise[0, 0])
    assert first == pytest.approx(np.mean(one.residual("v") ** 2, axis=1) / noise)
    assert second == pytest.approx(np.mean(other.residual("v") ** 2, axis=1) / noise)
    assert np.all(rounding < 1e-6 * second)


def test_the_winner_does_not_depend_on_the_order(fits):
    predictions: Predictions = tuple((gb.predict(fit),) for fit in fits)
    z, sentence = significance._errors_window_by_window(("wrong", "right"), predictions, (0, 1), "held-out")
    back, same = significance._errors_window_by_window(("wrong", "right"), predictions, (1, 0), "held-out")
    assert z == pytest.approx(-back)
    assert z < -2
    assert sentence == same
    assert sentence.startswith("right predicts held-out data better than wrong, in ")


def test_too_few_windows_and_equal_ones_are_no_verdict(fits):
    few = tuple((gb.predict(fit, horizon=7.0),) for fit in fits)
    z, sentence = significance._errors_window_by_window(("a", "b"), few, (0, 1), "identification")
    assert (z, sentence[:33]) == (0, "2 windows cannot show whether a o")
    same = tuple((gb.predict(fits[1]),) for _ in range(2))
    z, sentence = significance._errors_window_by_window(("a", "b"), same, (0, 1), "identification")
    assert z == 0
    assert sentence.startswith("a and b predict their own data equally well: their mean squared errors differ by 0 %")


def test_one_model_fitted_twice_fits_equally_well(fits):
    found = significance._likelihoods_sample_by_sample((fits[1], fits[1]), ("a", "b"), (0, 1))
    assert found == "a and b fit the data equally well (AIC differs by 0; below 2 neither is preferred)."


def test_a_term_is_judged_against_zero_and_by_predictions():
    linear = fitted(Drag(), flight(LINEAR, 3, duration=15.0))
    without = fitted(LinearDrag(), linear.parts[0].data)
    said = list(significance._terms((linear, without), ("Drag", "LinearDrag"), 0, {}))
    (term,) = said
    assert term.startswith("C_x = ")
    assert term.endswith("(Drag): not distinguishable from zero.")
    assert (
        significance._by_predictions([("a", -3.0), ("b", 0.0)])
        == "not zero, but a, without it, explains the data better."
    )
    assert (
        significance._by_predictions([("a", 3.0), ("b", 0.0)])
        == "not zero, but b, without it, explains the data as well."
    )
    assert significance._by_predictions([("a", 3.0)]) == "determined by these data."
