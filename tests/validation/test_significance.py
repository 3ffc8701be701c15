"""The sentences of a comparison, and the tests behind them, against brute force and a known truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drag_flights import LINEAR, QUADRATIC, Drag, LinearDrag, QuadraticDrag, fitted, flight
from scipy.stats import multivariate_normal, norm, ttest_1samp

import greybox as gb
from greybox.files.text_table import number
from greybox.validation import significance
from greybox.validation.comparison import p_text
from greybox.validation.held_out import Predictions
from greybox.validation.nested_models import NestedTest


@pytest.fixture(scope="module")
def fits():
    record = flight(QUADRATIC, 1, duration=15.0)
    return fitted(LinearDrag(), record), fitted(QuadraticDrag(), record)


def test_log_likelihoods_are_those_of_the_normal_distribution(fits):
    part = fits[1].records[0]
    expected = norm.logpdf(part.residual("v"), scale=np.sqrt(part.noise[0, 0]))
    assert significance._log_likelihoods(part) == pytest.approx(expected)
    assert np.sum(significance._log_likelihoods(part)) == pytest.approx(-fits[1].cost, rel=1e-6)


def test_where_nothing_is_tested_both_aic_are_told(fits):
    compared = gb.compare(*fits, labels=("a", "b"))
    values = [number(compared.value("AIC", label), 6) for label in ("a", "b")]
    assert significance._aic_text(fits) == f" (AIC {values[0]} and {values[1]})"


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
    expected = [
        multivariate_normal.logpdf(e, cov=part.noise) if np.isfinite(e).all() else np.nan
        for e in part.e.T
    ]
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
    better, sentence = significance._errors_window_by_window(
        ("wrong", "right"), predictions, (0, 1), "held-out"
    )
    back, same = significance._errors_window_by_window(
        ("wrong", "right"), predictions, (1, 0), "held-out"
    )
    assert (better, back) == (-1, 1)
    assert sentence == same
    assert sentence.startswith("right predicts held-out data better than wrong, in ")


def test_too_few_windows_are_no_verdict_and_equal_ones_a_tie(fits):
    few = tuple((gb.predict(fit, horizon=7.0),) for fit in fits)
    better, sentence = significance._errors_window_by_window(
        ("a", "b"), few, (0, 1), "identification"
    )
    assert (better, sentence[:33]) == (None, "2 windows cannot show whether a o")
    same = tuple((gb.predict(fits[1]),) for _ in range(2))
    better, sentence = significance._errors_window_by_window(
        ("a", "b"), same, (0, 1), "identification"
    )
    assert better == 0
    assert sentence.startswith(
        "a and b predict their own data equally well: their mean squared errors differ by 0 %"
    )


def shifted(prediction, errors):
    """The same prediction with these errors (w,) throughout every window."""
    return replace(
        prediction, predicted=prediction.measured("v")[None] - np.asarray(errors)[None, :, None]
    )


def test_no_difference_found_is_a_tie_only_where_its_interval_is_narrow(fits):
    made = gb.predict(fits[1])
    random = np.random.default_rng(0)
    w = len(made)
    sizes = 1 + 0.3 * random.normal(size=w)
    close = sizes * (1 + 0.02 * random.normal(size=w))
    wide = sizes * (1 + 0.5 * random.normal(size=w))
    for other, expected, said in (
        (close, 0, "equally well: their mean squared errors differ by less than 10 %"),
        (
            wide,
            None,
            "It cannot be told which of a and b predicts held-out data better: their mean squared errors differ by ",
        ),
    ):
        pair = ((shifted(made, sizes),), (shifted(made, other),))
        difference = other**2 - sizes**2
        assert ttest_1samp(difference, 0).pvalue > 0.05
        better, sentence = significance._errors_window_by_window(
            ("a", "b"), pair, (0, 1), "held-out"
        )
        assert better == expected
        assert said in sentence


def test_few_windows_have_the_p_value_of_students_t(fits):
    made = gb.predict(fits[1], horizon=2.0)
    errors = np.linspace(1.0, 2.0, len(made))
    worse = np.sqrt(errors**2 + np.array([1.0, 0.2, 0.6, 0.9, 0.3, 0.5, 1.1])[: len(made)])
    pair = ((shifted(made, errors),), (shifted(made, worse),))
    p = ttest_1samp(worse**2 - errors**2, 0).pvalue
    better, sentence = significance._errors_window_by_window(("a", "b"), pair, (0, 1), "held-out")
    assert better == 1
    assert (
        sentence
        == f"a predicts held-out data better than b, in 100 % of {len(made)} windows ({p_text(p)})."
    )


def test_one_model_fitted_twice_fits_equally_well(fits):
    found = significance._likelihoods_sample_by_sample((fits[1], fits[1]), ("a", "b"), (0, 1))
    assert found == (
        0,
        "a and b fit the data equally well (AIC differs by 0; below 2 neither is preferred).",
    )


class Spring(gb.StateSpace):
    """Position and velocity of a mass on a spring, both measured."""

    states, inputs, outputs = ("x", "v"), ("force",), ("x", "v")
    stiffness = gb.Parameter(3.0, bounds=(0.1, 20))
    damping = gb.Parameter(0.5, bounds=(0, 5))

    def derivative(self, x, u, p):
        return (x.v, u.force - p.stiffness * x.x - p.damping * x.v)

    def output(self, x, u, p):
        return (x.x, x.v)


class DrySpring(Spring):
    """The same with another kind of damping."""

    def derivative(self, x, u, p):
        return (x.v, u.force - p.stiffness * x.x - p.damping * gb.tanh(4 * x.v))


def test_vuongs_test_of_correlated_outputs_is_that_of_their_joint_density():
    time = np.arange(400) / 20
    random = np.random.default_rng(4)
    force = 2 * np.sign(np.sin(0.9 * time))
    clean = gb.simulate(
        Spring(), {"stiffness": 4.0, "damping": 0.6}, gb.Record(time, {"force": force})
    )
    error = 0.1 * random.multivariate_normal([0, 0], [[1.0, 0.7], [0.7, 1.0]], size=time.size).T
    record = gb.Record(
        time, {"force": force, "x": clean["x"] + error[0], "v": clean["v"] + error[1]}
    )
    full = gb.OutputError(noise="full")
    fits = [fitted(model, record, criterion=full) for model in (Spring(), DrySpring())]
    densities = []
    for fit in fits:
        part = fit.records[0]
        assert part.noise[0, 1] > 0.3 * part.noise[0, 0]
        errors = np.array([part.residual(name) for name in part.outputs])
        densities.append(multivariate_normal.logpdf(errors.T, cov=part.noise))
        assert significance._log_likelihoods(part) == pytest.approx(densities[-1])
        assert np.sum(densities[-1]) == pytest.approx(-fit.cost, rel=1e-6)
    better, sentence = significance._likelihoods_sample_by_sample(fits, ("viscous", "dry"), (0, 1))
    difference = densities[0] - densities[1]
    assert np.sum(difference) > 10
    assert better == 1
    assert sentence.startswith("viscous fits the data better than dry (Vuong, p")
    other, same = significance._likelihoods_sample_by_sample(fits, ("viscous", "dry"), (1, 0))
    assert (other, same) == (-1, sentence)


def test_a_term_is_judged_against_zero_and_by_the_models_without_it():
    linear = fitted(Drag(), flight(LINEAR, 3, duration=15.0))
    without = fitted(LinearDrag(), linear.parts[0].data)
    said = list(significance._terms((linear, without), ("Drag", "LinearDrag"), 0, {}))
    (term,) = said
    assert term.startswith("C_x = ")
    assert term.endswith("(Drag): not distinguishable from zero.")


@pytest.mark.parametrize(
    ("estimation", "held_out", "said"),
    [
        ((1, 1), (None, 1), "determined by these data."),
        (
            (1, 1),
            (None, -1),
            "determined by these data, but b, without it, predicts held-out data better.",
        ),
        ((-1, 0), (1, 1), "not zero, but a, without it, explains the data better."),
        (
            (1, None),
            (1, 1),
            "not zero, but it cannot be told whether b, without it, explains the data as well.",
        ),
        ((1, 0), (1, 1), "not zero, but b, without it, explains the data as well."),
        (
            None,
            (1, None),
            "not zero, but it cannot be told whether b, without it, predicts held-out data as well.",
        ),
        (None, (-1, 1), "not zero, but a, without it, predicts held-out data better."),
        (None, (1, 1), "determined by these data."),
    ],
)
def test_held_out_evidence_stands_beside_that_of_the_fits(estimation, held_out, said):
    def evidence(verdicts):
        return {(2, i): significance.Evidence(v, "said") for i, v in enumerate(verdicts or ())}

    found = {
        "estimation": evidence(estimation),
        "identification": {},
        "held-out": evidence(held_out),
    }
    assert significance._by_evidence(("a", "b", "c"), 2, (0, 1), found, "zero") == said


@pytest.mark.parametrize(
    ("aic", "better", "said"),
    [
        (
            1.9,
            0,
            "a and b fit the data equally well (AIC differs by 1.9; below 2 neither is preferred).",
        ),
        (
            2.1,
            None,
            "It cannot be told which of a and b fits the data better (AIC differs by 2.1; from 10 on one ",
        ),
        (
            9.9,
            None,
            "It cannot be told which of a and b fits the data better (AIC differs by 9.9; from 10 on one ",
        ),
        (10.1, 1, "a fits the data better than b (AIC differs by 10.1)."),
        (-10.1, -1, "b fits the data better than a (AIC differs by 10.1)."),
    ],
)
def test_support_by_aic_is_that_of_burnham_and_anderson(aic, better, said):
    found, sentence = significance._by_aic(("a", "b"), (0, 1), (100.0, 100.0 + aic))
    assert found == better
    assert sentence.startswith(said)


@pytest.mark.parametrize(("t", "p_values", "not_found"), [
    (1.99, (), True), (2.01, (), False), (9.0, (0.051,), True), (0.1, (0.049,), False), (9.0, (0.01, 0.2), True),
])  # fmt: skip
def test_a_term_is_found_beyond_two_errors_or_by_its_own_test_where_there_is_one(
    t, p_values, not_found
):
    def nested(p, terms):
        return NestedTest("b", "a", terms, 4.0, 1.0, 4.0, (1, 50.0), p)

    tests = {
        (0, k + 1): significance.Evidence(1, "said", nested(p, ("C",)))
        for k, p in enumerate(p_values)
    }
    tests[0, 5] = significance.Evidence(
        1, "said", nested(0.9, ("C", "D"))
    )  # of two terms: says nothing of one
    without = [*range(1, len(p_values) + 1), 5]
    assert significance._not_found("C", t, 0, without, {"estimation": tests}) is not_found


def test_differences_below_a_thousandth_are_a_tie_and_their_percentage_is_that_of_the_mean_squares(
    fits,
):
    """The second predicts a little worse in every window: significant, and no matter below 0.1 %."""
    made = gb.predict(fits[1], horizon=2.0)
    errors = np.linspace(1.0, 2.0, len(made))
    for more, better in ((0.0009, 0), (0.0011, 1)):
        pair = ((shifted(made, errors),), (shifted(made, errors * np.sqrt(1 + more)),))
        found, sentence = significance._errors_window_by_window(
            ("a", "b"), pair, (0, 1), "held-out"
        )
        assert found == better
        if not better:
            assert (
                f"differ by {100 * more / (1 + more):.2g} % ({len(made)} windows), and below 0.1 %"
                in sentence
            )


def test_three_windows_are_tested_by_students_t(fits):
    made = gb.predict(fits[1], horizon=4.5)
    assert len(made) == 3
    errors, worse = np.array([1.0, 1.1, 1.2]), np.array([1.5, 1.45, 1.7])
    pair = ((shifted(made, errors),), (shifted(made, worse),))
    p = ttest_1samp(worse**2 - errors**2, 0).pvalue
    better, sentence = significance._errors_window_by_window(
        ("a", "b"), pair, (0, 1), "identification"
    )
    assert 0.01 < p < 0.05
    assert (better, sentence) == (
        1,
        f"a predicts its own data better than b, in 100 % of 3 windows ({p_text(p)}).",
    )


def test_values_from_the_record_itself_make_its_errors_smaller_by_their_share(fits):
    one = gb.predict(fits[1], horizon=2.0)
    other = replace(one, own={"v_bias": (0.1, 0.01), "theta_bias": (0.0, 0.01)})
    n = int(np.isfinite(one.measured("v")).sum())
    first, second, rounding = significance._mean_squares(one, other)
    assert second / first == pytest.approx(np.full(len(one), n / (n - 2)))
    spread = np.nanstd(one.data["v"])
    assert rounding == pytest.approx(np.full(len(one), (1e-6 * spread) ** 2 / one.noise[0, 0]))


@pytest.mark.parametrize(("share", "better"), [(0.098, 0), (0.102, None)])
def test_equally_good_is_an_interval_of_the_difference_within_a_tenth(fits, share, better):
    """The wider end of Student's interval of 95 %, as scipy has it, over the smaller mean square."""
    made = gb.predict(fits[1], horizon=2.0)
    z = np.array([1.0, -0.7, 0.2, -0.9, 0.8, -0.6, 0.5])
    assert len(made) == len(z)
    test = ttest_1samp(z, 0)
    widest = test.confidence_interval(0.95).high
    assert test.pvalue > 0.05
    errors = np.linspace(1.0, 2.0, len(z))
    other = np.sqrt(errors**2 + z * share * np.mean(errors**2) / widest)
    pair = ((shifted(made, errors),), (shifted(made, other),))
    assert significance._errors_window_by_window(("a", "b"), pair, (0, 1), "held-out")[0] == better


def test_samples_that_one_of_two_predictions_lacks_count_in_neither(fits):
    one, other = (gb.predict(fit, horizon=2.0) for fit in fits)
    lacking = one.predicted.copy()
    lacking[:, 1, 1:] = np.nan
    first, second, _ = significance._mean_squares(replace(one, predicted=lacking), other)
    errors = [p.residual("v").copy() for p in (one, other)]
    noise = min(one.noise[0, 0], other.noise[0, 0])
    for found, e in zip((first, second), errors, strict=True):
        e[1, 1:] = np.nan
        assert found == pytest.approx(np.nanmean(e**2, axis=1) / noise)


@pytest.mark.parametrize(
    ("errors", "verdict"), [(1.9, "not distinguishable"), (2.1, "distinguishable")]
)
def test_a_term_is_told_from_the_value_at_which_others_hold_it_beyond_two_errors(
    fits, errors, verdict
):
    fit = fits[1]
    (name,) = fit.free
    held = fit.estimate[name] + errors * fit.standard_error[name]
    other = SimpleNamespace(free=(), estimate={name: held})
    (said,) = significance._terms((fit, other), ("a", "b"), 0, {})
    assert said.startswith(f"{name} = ")
    assert said.endswith(f"(a): {verdict} from {number(held)}.")


@pytest.mark.parametrize("more", [0, 3])
def test_the_difference_of_aic_is_that_of_the_likelihoods_and_of_the_numbers_that_were_estimated(
    more,
):
    """Of residuals that two models share but for a little, where Vuong's test finds nothing."""
    random = np.random.default_rng(5)
    e = random.normal(size=(2, 200))
    e[1] = np.roll(e[0], 7) + 0.2 * random.normal(size=200)

    def fit(residuals, free):
        data = SimpleNamespace(independent_pieces=[slice(None)])
        noise = np.array([[np.mean(residuals**2)]])
        part = SimpleNamespace(
            outputs=("y",), noise=noise, data=data, nuisances=1, residual=lambda _: residuals
        )
        return SimpleNamespace(records=[part], parts=[part], free=("p",) * free)

    logs = [-100 * (np.log(2 * np.pi * np.mean(r**2)) + 1) for r in e]
    aic = 2 * (2 + more - logs[0]) - 2 * (2 - logs[1])
    assert abs(aic) > 2
    _, sentence = significance._likelihoods_sample_by_sample(
        (fit(e[0], 1 + more), fit(e[1], 1)), ("a", "b"), (0, 1)
    )
    assert f"AIC differs by {number(abs(aic), 2)})" in sentence
    close = (fit(e[0], 1), fit(e[0], 3))
    assert (
        "AIC differs by 4)"
        in significance._likelihoods_sample_by_sample(close, ("a", "b"), (0, 1))[1]
    )
