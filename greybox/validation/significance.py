"""What a comparison of fits means, in sentences: which model is closer to the data, and which terms these determine."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from greybox.data.text_table import counted, listed, number, with_error
from greybox.estimate.result import Fit, FittedRecord
from greybox.simulation.prediction import Prediction
from greybox.statistics.metrics import mean_test, whiteness
from greybox.validation.comparison import HELD_OUT, IDENTIFICATION, SIGNIFICANT, p_text
from greybox.validation.held_out import Predictions
from greybox.validation.same_data import count_unknowns

Array = NDArray[np.float64]

# Windows below which predictions are not tested: the fewest for which `mean_test` estimates a correlation, and with two
# the threshold of Student's t would be 12.7.
FEWEST_WINDOWS = 3

# Predictions whose mean squared errors differ by less than this share of the smaller one (0.05 % in rms) are equally
# good for any use, however significant the difference is in a long record.
EQUAL_SQUARES = 1e-3

# Of an output's spread: ten times the local error that the simulator allows itself. Differences below it are rounding.
SIMULATION_ACCURACY = 1e-6

# Difference of AIC below which two models have substantial support alike: Burnham and Anderson (2002), section 2.6.
EQUAL_AIC = 2.0

# Standard errors within which an estimate is not distinguishable from zero: 95 % of a normal distribution.
NOT_ZERO = 2.0

# p-value below which residuals are called not white: one test for every output of every fit, hence less than 5 %.
NOT_WHITE = 0.01

Pair = tuple[int, int]


def verdicts(
    fits: Sequence[Fit],
    labels: Sequence[str],
    predictions: Mapping[str, Predictions],
    *,
    same_data: bool,
    comparable: bool,
) -> tuple[str, ...]:
    """Return the sentences of a comparison.

    `predictions` are those on the data of the fits and on held-out records, as far as there are; `comparable` says
    whether the costs are.
    """
    sentences: list[str] = []
    advantage: dict[Pair, float] = {}  # z of the last test of predictions, positive where the first of the pair wins
    for a, b in combinations(range(len(fits)), 2):
        if same_data and all(len(fit.records) == len(fit.parts) for fit in (fits[a], fits[b])):
            sentences.append(_likelihoods_sample_by_sample(fits, labels, (a, b)))
        for kind in (IDENTIFICATION, HELD_OUT):
            if kind in predictions:
                z, sentence = _errors_window_by_window(labels, predictions[kind], (a, b), kind)
                sentences.append(sentence)
                advantage[a, b] = z
                advantage[b, a] = -z

    if comparable and predictions:
        sentences += _residuals_not_white(fits, labels)
    for k in range(len(fits)):
        sentences += _terms(fits, labels, k, advantage)
    if comparable:
        sentences += _no_likelihood(fits)
    return tuple(sentences)


def _likelihoods_sample_by_sample(fits: Sequence[Fit], labels: Sequence[str], pair: Pair) -> str:
    """Compare the likelihoods sample by sample, less half of the AIC's penalty.

    Where AIC differs by less than `EQUAL_AIC` nothing is tested: of one model fitted twice the differences are
    rounding. Sources: Vuong (1989), Econometrica 57; for errors that are correlated in time Rivers and Vuong (2002),
    Econometrics Journal 5; Burnham and Anderson (2002), section 2.6.
    """
    a, b = pair
    differences: list[Array] = []
    for one, other in zip(fits[a].records, fits[b].records, strict=True):
        along = _log_likelihoods(one) - _log_likelihoods(other)
        differences += np.split(along, np.cumsum([len(piece) for piece in one.data.pieces])[:-1])
    mean, error = mean_test(differences)
    count = sum(int(np.isfinite(d).sum()) for d in differences)
    mean -= (count_unknowns(fits[a]) - count_unknowns(fits[b])) / max(count, 1)

    equal = f"{labels[a]} and {labels[b]} fit the data equally well"
    aic = 2 * abs(mean) * count
    if aic < EQUAL_AIC:
        return f"{equal} (AIC differs by {number(aic, 2)}; below {EQUAL_AIC:g} neither is preferred)."
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z)
    if not p < SIGNIFICANT:
        return f"{equal} (Vuong, {p_text(p)})."
    better, worse = pair if z > 0 else pair[::-1]
    return f"{labels[better]} fits the data better than {labels[worse]} (Vuong, {p_text(p)})."


def _log_likelihoods(part: FittedRecord) -> Array:
    """Return the logarithm of the likelihood of every sample (n,), NaN where nothing was compared."""
    residuals = np.array([part.residual(name) for name in part.outputs])
    present = np.isfinite(residuals)
    variance = np.diag(part.noise)

    if np.count_nonzero(part.noise) == len(variance):  # uncorrelated outputs: samples may miss some of them
        squares = np.nan_to_num(residuals) ** 2 / variance[:, None]
        terms = np.where(present, -0.5 * (squares + np.log(2 * np.pi * variance)[:, None]), 0.0)
        return np.where(present.any(axis=0), terms.sum(axis=0), np.nan)

    squares = np.einsum("in,ij,jn->n", np.nan_to_num(residuals), np.linalg.inv(part.noise), np.nan_to_num(residuals))
    logarithm = float(np.linalg.slogdet(2 * np.pi * part.noise)[1])
    return np.where(present.all(axis=0), -0.5 * (squares + logarithm), np.nan)


def _errors_window_by_window(
    labels: Sequence[str], predictions: Predictions, pair: Pair, kind: str
) -> tuple[float, str]:
    """Compare the mean squared errors window by window, in units of the smaller noise; positive where the first wins.

    A mean difference below `EQUAL_SQUARES` of the smaller mean squared error, or below what simulations are accurate
    to, is a tie whatever the test says: it may have the same sign in every window and yet be rounding.
    Source: Diebold and Mariano (1995), Journal of Business and Economic Statistics 13.
    """
    a, b = pair
    squares = [_mean_squares(one, other) for one, other in zip(predictions[a], predictions[b], strict=True)]
    differences = [second - first for first, second, _ in squares]
    first, second, rounding = (float(np.mean(np.concatenate(values))) for values in zip(*squares, strict=True))
    every = np.concatenate(differences)
    windows = counted(every.size, "window")
    both = f"{labels[a]} and {labels[b]}"
    their_data = "their own data" if kind == IDENTIFICATION else "held-out data"

    if every.size < FEWEST_WINDOWS:
        return 0.0, (
            f"{windows} cannot show whether {labels[a]} or {labels[b]} predicts {their_data} better: give a shorter "
            "window, or longer records."
        )
    if abs(second - first) <= max(EQUAL_SQUARES * min(first, second), rounding):
        percent = 100 * abs(second - first) / max(first, second, 1e-300)
        return 0.0, (
            f"{both} predict {their_data} equally well: their mean squared errors differ by {number(percent, 2)} % "
            f"({windows}), and below {100 * EQUAL_SQUARES:g} % neither is better."
        )

    mean, error = mean_test(differences)
    z = mean / error if error > 0 else 0.0
    p = _two_sided(z, every.size - 1)
    if not p < SIGNIFICANT:
        return 0.0, f"{both} predict {their_data} equally well ({windows}, {p_text(p)})."
    better, worse = pair if z > 0 else pair[::-1]
    percent = 100 * float(np.mean(np.sign(every) == np.sign(z)))
    its_data = "its own data" if kind == IDENTIFICATION else "held-out data"
    return z, (
        f"{labels[better]} predicts {its_data} better than {labels[worse]}, in {percent:.0f} % of the windows "
        f"({p_text(p)})."
    )


def _mean_squares(one: Prediction, other: Prediction) -> tuple[Array, Array, Array]:
    """Return the mean squared errors of both in every window (w,), and what of them is rounding, in units of noise."""
    first, second, rounding = np.zeros((3, len(one)))
    for k, output in enumerate(one.outputs):
        noise = min(one.noise[k, k], other.noise[k, k])
        errors = np.array([one.residual(output), other.residual(output)])
        present = np.all(np.isfinite(errors), axis=0)
        sums = np.where(present, errors**2, 0.0).sum(axis=2) / (np.maximum(present.sum(axis=1), 1) * noise)
        first += sums[0]
        second += sums[1]
        rounding += (SIMULATION_ACCURACY * float(np.nanstd(one.data[output]))) ** 2 / noise
    return first, second, rounding


def _residuals_not_white(fits: Sequence[Fit], labels: Sequence[str]) -> Iterator[str]:
    """Warn of criteria that take residuals as white where they are not."""
    colored = []
    for fit, label in zip(fits, labels, strict=True):
        tests = [whiteness([part.residual(output)]) for part in fit.records for output in part.outputs]
        if any(test.p_value < NOT_WHITE for test in tests):
            colored.append(label)
    if colored:
        yield (
            f"AIC and BIC assume white residuals, and those of {listed(colored)} are not white: their differences "
            "overstate the evidence."
        )


def _terms(fits: Sequence[Fit], labels: Sequence[str], k: int, advantage: Mapping[Pair, float]) -> Iterator[str]:
    """Say of every parameter that another fit does not have whether these data determine it."""
    quantities = {quantity.name: quantity for quantity in fits[k].quantities}
    for name in fits[k].free:
        without = [i for i, other in enumerate(fits) if i != k and name not in other.free]
        if not without or name.startswith("K_") or name.endswith("_bias"):
            continue
        quantity = quantities[name]
        value, error = with_error(quantity.value, quantity.standard_error)
        stated = f"{name} = {value} ± {error} {quantity.unit}".rstrip() + f" ({labels[k]})"
        if quantity.at_bound:
            yield f"{stated}: ended at its bound, not determined."
        elif not math.isfinite(quantity.standard_error):
            yield f"{stated}: the data do not determine it."
        elif abs(quantity.value) < NOT_ZERO * quantity.standard_error:
            yield f"{stated}: not distinguishable from zero."
        elif not advantage:
            yield f"{stated}: distinguishable from zero."
        else:
            yield f"{stated}: {_by_predictions([(labels[i], advantage[k, i]) for i in without])}"


def _by_predictions(others: Sequence[tuple[str, float]]) -> str:
    """Say what predictions add to an estimate that is distinguishable from zero, given the z over the others."""
    better = [label for label, z in others if z < 0]
    if better:
        return f"not zero, but {listed(better)}, without it, explains the data better."
    equal = [label for label, z in others if z == 0]
    if equal:
        return f"not zero, but {listed(equal)}, without it, explains the data as well."
    return "determined by these data."


def _no_likelihood(fits: Sequence[Fit]) -> Iterator[str]:
    """Say which measures do not exist for fits of responses."""
    rules = {part.rule for fit in fits for part in fit.responses if not part.is_likelihood}
    if rules:
        yield (
            f"AIC and BIC do not exist for {' and '.join(sorted(rules))}, which is no likelihood: compare the costs; "
            "with the variance of every point, MaximumLikelihood() has them."
        )


def _two_sided(z: float, dof: float = math.inf) -> float:
    from scipy.special import ndtr, stdtr  # noqa: PLC0415  (takes a tenth of a second to import)

    return float(2 * (ndtr(-abs(z)) if math.isinf(dof) else stdtr(max(dof, 1), -abs(z))))
