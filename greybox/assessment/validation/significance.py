"""The sentences of a comparison: which model is closer to the data, and which predicts better."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from greybox.assessment.response_band import t_quantile
from greybox.assessment.result import Fit, Fits
from greybox.assessment.simulation.prediction import Prediction
from greybox.assessment.validation.comparison import EQUAL_AIC, IDENTIFICATION, SIGNIFICANT
from greybox.assessment.validation.held_out import Predictions
from greybox.assessment.validation.measures import Likelihoods
from greybox.assessment.validation.nested_models import NestedTest, nested_test_at
from greybox.assessment.validation.nesting import NotNestedError, nested_values
from greybox.assessment.validation.same_data import other_samples
from greybox.data.files.arrays import Array
from greybox.data.files.numbers_in_text import number, p_text
from greybox.data.files.wording import counted, listed
from greybox.statistics.correlation_statistics import mean_test, whiteness


def verdicts(
    fits: Fits,
    labels: Sequence[str],
    predictions: Mapping[str, Predictions],
    *,
    same_data: bool,
    aic: Sequence[float],
) -> tuple[list[str], list[NestedTest]]:
    """Return the sentences of a comparison, and the tests of nested models.

    `predictions` are by kind of data, `aic` is the information criterion, empty if not known.
    """
    sentences: list[str] = []
    tests: list[NestedTest] = []
    for a, b in combinations(range(len(fits)), 2):
        names = (labels[a], labels[b])
        if same_data:
            difference = aic[b] - aic[a] if aic else None
            sentence, test = fit_verdict((fits[a], fits[b]), names, difference)
            if sentence:
                sentences.append(sentence)
            if test:
                tests.append(test)
        for kind, by_fit in predictions.items():
            sentences.append(prediction_verdict(names, (by_fit[a], by_fit[b]), kind))
    return sentences, tests


def fit_verdict(
    fits: tuple[Fit, Fit], labels: tuple[str, str], difference: float | None
) -> tuple[str, NestedTest | None]:
    """Say which of two fits describes the data of both better; return the test of nested models.

    Nested models are compared by the ratio of their costs if both fits have one criterion. Other
    fits of responses are compared by the `difference` of AIC, second less first; other models of
    records only by their predictions.
    """
    # Only the fit with more free parameters may contain the other one.
    small, large = fits
    small_label, large_label = labels
    if len(large.free) < len(small.free):
        small, large = large, small
        small_label, large_label = large_label, small_label
    names = (small_label, large_label)
    try:
        if not other_samples(fits, labels):
            test = nested_test_at(nested_values(small, large, names), small, large, names)
            return f"{large_label} contains {small_label}, and {test}", test
    except (NotNestedError, LookupError):
        pass  # a loaded fit may lack its equations: AIC and predictions remain
    except ValueError as error:
        return f"{_undecided(labels)}: {error}", None
    return "" if difference is None else verdict_by_aic(labels, difference), None


def verdict_by_aic(labels: tuple[str, str], difference: float) -> str:
    """Compare structures that are not nested by AIC: Burnham and Anderson (2002), section 2.6."""
    by = f"AIC differs by {number(abs(difference), 3)}"
    if abs(difference) < EQUAL_AIC:
        return f"{labels[0]} and {labels[1]} fit the data equally well ({by})."
    # Above 10, the model with the larger AIC has essentially no support.
    if abs(difference) < 10:
        return f"{_undecided(labels)} ({by}, which is less than 10)."
    better, worse = labels if difference > 0 else labels[::-1]
    return f"{better} fits the data better than {worse} ({by})."


def _undecided(labels: tuple[str, str]) -> str:
    """Say that the data do not prefer either model."""
    return f"The data do not show which of {labels[0]} and {labels[1]} fits them better"


def prediction_verdict(
    labels: tuple[str, str],
    predictions: tuple[Sequence[Prediction], Sequence[Prediction]],
    kind: str,
) -> str:
    """Compare two models by their mean squared errors of prediction, window by window.

    Sources: Diebold and Mariano (1995), Journal of Business and Economic Statistics 13; for few
    windows Harvey, Leybourne and Newbold (1997), International Journal of Forecasting 13.
    """
    first_predictions, second_predictions = predictions
    # A record has a row for each window: mean squares of both models, and their rounding.
    records = list(map(mean_squares, first_predictions, second_predictions))
    differences = [second - first for first, second, _ in records]
    ratios = [
        np.log((second + rounding) / (first + rounding)) for first, second, rounding in records
    ]
    first = float(np.mean(np.concatenate([first for first, _, _ in records])))
    second = float(np.mean(np.concatenate([second for _, second, _ in records])))
    rounding = float(np.mean(np.concatenate([rounding for _, _, rounding in records])))
    all_differences = np.concatenate(differences)
    count = all_differences.size
    windows = counted(count, first_predictions[0].window)
    models = " and ".join(labels)
    data = "the identification data" if kind == IDENTIFICATION else "held-out data"
    # With two windows the threshold of Student's t would be 12.7.
    if count < 3:
        return (
            f"{windows} cannot show which of {models} predicts {data} better: give a shorter "
            "window, or more data."
        )
    equal = f"{models} predict {data} equally well: their mean squared errors differ by"
    percent = f"{number(100 * abs(second - first) / max(first, second, 1e-300), 2)} %"
    # In a long record any difference is significant. One of 0.1 % (0.05 % in rms), or below the
    # accuracy of the simulations, makes no difference in use.
    if abs(second - first) <= max(1e-3 * min(first, second), rounding):
        return f"{equal} {percent} ({windows})."

    mean, error, p = _mean_of_windows(differences, first_predictions)
    share = 100 * float(np.mean(np.sign(all_differences) == np.sign(mean)))
    test = p_text(p)
    # The negated comparisons are also true for NaN.
    if not p < SIGNIFICANT:
        # A few windows with large errors, or errors that swell slowly, hide a difference that
        # nearly all windows have, but not in the logarithms of the ratios. At a tenth of the level,
        # the second test adds little to the share of false verdicts.
        mean_ratio, _, p_of_ratios = _mean_of_windows(ratios, first_predictions)
        if np.sign(mean_ratio) == np.sign(mean) and p_of_ratios < SIGNIFICANT / 10:
            p = p_of_ratios
            test = f"by the ratios of their squared errors, {p_text(p)}"
    if not p < SIGNIFICANT:
        # Absence of evidence is not evidence of absence: models are called equal only if their
        # difference is small even at the end of its interval.
        widest = abs(mean) + t_quantile(1 - SIGNIFICANT, count - 1) * error
        if widest <= 0.1 * min(first, second):
            return f"{equal} less than 10 % ({windows}, {test})."
        return (
            f"The data do not show which of {models} predicts {data} better: their mean squared "
            f"errors differ by {percent} ({windows}, {test})."
        )
    better, worse = labels if mean > 0 else labels[::-1]
    return f"{better} predicts {data} better than {worse}, in {share:.0f} % of {windows} ({test})."


def _mean_of_windows(
    values: Sequence[Array], predictions: Sequence[Prediction]
) -> tuple[float, float, float]:
    """Return the mean of values (w,) of the windows, its error, and the p-value of zero."""
    from scipy.special import stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    # Windows of one record follow one another, so that their errors are correlated; rows without a
    # time are independent.
    independent: list[Array] = []
    for of_record, prediction in zip(values, predictions, strict=True):
        if prediction.data.has_time:
            independent.append(of_record)
        else:
            independent += [*of_record[:, None]]

    mean, error = mean_test(independent)
    count = sum(map(len, values))
    # Harvey, Leybourne and Newbold: with few windows the error is too small, and Student's t holds.
    error *= math.sqrt(count / (count - 1))
    p = float(2 * stdtr(count - 1, -abs(mean / error))) if error > 0 else float(mean == 0)
    return mean, error, p


def mean_squares(first: Prediction, second: Prediction) -> tuple[Array, Array, Array]:
    """Return the mean squared errors of both in every window (w,), and their rounding.

    Errors are in multiples of the smaller noise of the two models.
    """
    # Biases and other values that were estimated from this record itself make its errors smaller,
    # by their share of its numbers. Without the correction a model with more of them would win.
    numbers = sum(int(np.isfinite(first.measured(output)).sum()) for output in first.outputs)
    corrections = [numbers / max(numbers - len(p.own), 1) for p in (first, second)]
    totals = np.zeros((2, len(first)))
    rounding = np.zeros(len(first))
    for k, output in enumerate(first.outputs):
        noise = min(first.noise[k, k], second.noise[k, k])
        errors = np.array([first.residual(output), second.residual(output)])
        present = np.all(np.isfinite(errors), axis=0)
        count = np.maximum(present.sum(axis=1), 1)
        means = np.where(present, errors**2, 0.0).sum(axis=2) / (count * noise)
        totals += means * np.array(corrections)[:, None]
        # 1e-6 of the spread: ten times the local error that the simulator allows itself.
        rounding += (1e-6 * float(np.nanstd(first.data[output]))) ** 2 / noise
    first_total, second_total = totals
    return first_total, second_total, rounding


def residuals_not_white(fits: Fits, labels: Sequence[str]) -> Iterator[str]:
    """Warn of information criteria that assume white residuals where the residuals are colored."""
    colored = []
    for fit, label in zip(fits, labels, strict=True):
        p_values = []
        for part in fit.records:
            if part.data.has_time:
                p_values += [whiteness([part.residual(name)]).p_value for name in part.outputs]
        # The level is 1 %, since every output of every fit is tested.
        if any(p < 0.01 for p in p_values):
            colored.append(label)
    if colored:
        yield (
            f"AIC and BIC assume white residuals, but the residuals of {listed(colored)} are not "
            "white: differences overstate the evidence."
        )


def which_likelihood(labels: Sequence[str], likelihoods: Likelihoods) -> str:
    """Say which likelihood AIC, AICc and BIC are based on, and where it is not at its maximum."""
    criterion = likelihoods.criterion
    name = f"{type(criterion).__name__} ({criterion.description})"
    text = f"AIC, AICc and BIC are those of {name}, maximized from each estimate"
    pairs = zip(labels, likelihoods.least, strict=True)
    elsewhere = [label for label, cost in pairs if cost is None]
    if elsewhere:
        text += f"; for {listed(elsewhere)} they are not at the maximum and therefore too high"
    return f"{text}."
