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
            sentences += [sentence] if sentence else []
            tests += [test] if test else []
        sentences += [
            prediction_verdict(names, (of_fits[a], of_fits[b]), kind)
            for kind, of_fits in predictions.items()
        ]
    return sentences, tests


def fit_verdict(
    fits: tuple[Fit, Fit], labels: tuple[str, str], difference: float | None
) -> tuple[str, NestedTest | None]:
    """Say which of two fits describes the data of both better.

    Nested models are compared by the ratio of their costs if these are of one criterion. Other fits
    of responses are compared by the `difference` of AIC, second less first; other models of records
    only by their predictions.
    """
    # Only the fit with more free parameters may contain the other one.
    order = sorted((0, 1), key=lambda k: len(fits[k].free))
    (small, large), names = (fits[k] for k in order), (labels[order[0]], labels[order[1]])
    try:
        if not other_samples(fits, labels):
            test = nested_test_at(nested_values(small, large, names), small, large, names)
            return f"{names[1]} contains {names[0]}, and {test}", test
    except (NotNestedError, LookupError):
        pass  # without the equations of a loaded fit, AIC and predictions are what there is
    except ValueError as error:
        return f"{_undecided(labels)}: {error}", None
    return "" if difference is None else verdict_by_aic(labels, difference), None


def verdict_by_aic(labels: tuple[str, str], difference: float) -> str:
    """Compare structures that are not nested by AIC: Burnham and Anderson (2002), section 2.6."""
    by = f"AIC differs by {number(abs(difference), 3)}"
    if abs(difference) < EQUAL_AIC:
        return f"{labels[0]} and {labels[1]} fit the data equally well ({by})."
    if abs(difference) < 10:  # above that, the model with the larger AIC has essentially no support
        return f"{_undecided(labels)} ({by}, which is less than 10)."
    better, worse = labels if difference > 0 else labels[::-1]
    return f"{better} fits the data better than {worse} ({by})."


def _undecided(labels: tuple[str, str]) -> str:
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
    first_predictions = predictions[0]
    squares = list(map(mean_squares, *predictions))
    differences = [second - first for first, second, _ in squares]
    ratios = [np.log((second + least) / (first + least)) for first, second, least in squares]
    first, second, rounding = (
        float(np.mean(np.concatenate(values))) for values in zip(*squares, strict=True)
    )
    every = np.concatenate(differences)
    windows = counted(every.size, first_predictions[0].window)
    models = " and ".join(labels)
    data = "the identification data" if kind == IDENTIFICATION else "held-out data"
    if every.size < 3:  # with two windows the threshold of Student's t would be 12.7
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
    share = 100 * float(np.mean(np.sign(every) == np.sign(mean)))
    test = p_text(p)
    if not p < SIGNIFICANT:
        # A few windows with large errors, or errors that swell slowly, hide a difference that
        # nearly all windows have, but not in the logarithms of the ratios. At a tenth of the level,
        # the second test adds little to the share of false verdicts.
        mean_ratio, _, of_ratios = _mean_of_windows(ratios, first_predictions)
        if np.sign(mean_ratio) == np.sign(mean) and of_ratios < SIGNIFICANT / 10:
            p = of_ratios
            test = f"by the ratios of their squared errors, {p_text(p)}"
    if not p < SIGNIFICANT:
        # Absence of evidence is not evidence of absence: models are called equal only if their
        # difference is small even at the end of its interval.
        widest = abs(mean) + t_quantile(1 - SIGNIFICANT, every.size - 1) * error
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
    independent = [
        part
        for v, prediction in zip(values, predictions, strict=True)
        for part in ([v] if prediction.data.has_time else [*v[:, None]])
    ]
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
    totals = np.zeros((2, len(first)))
    rounding = np.zeros(len(first))
    numbers = sum(int(np.isfinite(first.measured(output)).sum()) for output in first.outputs)
    shares = [numbers / max(numbers - len(p.own), 1) for p in (first, second)]
    for k, output in enumerate(first.outputs):
        noise = min(first.noise[k, k], second.noise[k, k])
        errors = np.array([first.residual(output), second.residual(output)])
        present = np.all(np.isfinite(errors), axis=0)
        count = np.maximum(present.sum(axis=1), 1)
        sums = np.where(present, errors**2, 0.0).sum(axis=2) / (count * noise)
        totals += sums * np.array(shares)[:, None]
        # 1e-6 of the spread: ten times the local error that the simulator allows itself.
        rounding += (1e-6 * float(np.nanstd(first.data[output]))) ** 2 / noise
    return totals[0], totals[1], rounding


def residuals_not_white(fits: Fits, labels: Sequence[str]) -> Iterator[str]:
    """Warn of information criteria that assume white residuals where they are not."""
    colored = []
    for fit, label in zip(fits, labels, strict=True):
        in_time = [part for part in fit.records if part.data.has_time]
        tests = [whiteness([part.residual(name)]) for part in in_time for name in part.outputs]
        # 1 %, since every output of every fit is tested.
        if any(test.p_value < 0.01 for test in tests):
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
