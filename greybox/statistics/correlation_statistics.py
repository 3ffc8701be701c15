"""Correlations of residuals in time, and with inputs: statistics, and their chance.

Series are stretches with NaN for missing samples.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.metrics import rms
from greybox.statistics.residual_autocorrelation import autoregression

LAGS = 25  # Ljung (1999), section 16.6, takes 20 to 30
# Means are of ever more samples, each time by this factor: correlations at 12 of its multiples
# overlap. Fewer means than these hardly have correlations at 12 lags.
COARSER, FEWEST_MEANS = 4, 150
NORMAL_99 = 2.576  # standard deviations within which 99 % of normal values lie


@frozen
class CorrelationTest:
    """A statistic with its degrees of freedom, and the probability of a larger one by chance.

    `correlations` (lags,) are those tested. By chance, 99 % of them lie within ± `bound`.
    """

    statistic: float
    dof: float
    p_value: float
    correlations: Array
    bound: float


def whiteness(stretches: Sequence[ArrayLike], lags: int = LAGS, fitted: int = 0) -> CorrelationTest:
    """Test whether residuals are white, by the statistic of Ljung and Box.

    Parameters
    ----------
    stretches : sequence of (n,) arrays
        Uniformly sampled, NaN for missing samples.
    lags : int
        Correlations at 1 to `lags` samples are tested.
    fitted : int
        Parameters of the noise that were estimated (gains of the innovations); those of the model
        do not count.

    Source: Ljung and Box (1978), Biometrika 65; Box and Pierce (1970), JASA 65; Ljung (1999),
    System Identification, 2nd ed., section 16.6.
    """
    series = [_present(s) for s in stretches]
    n = sum(np.isfinite(s).sum() for s in series)
    mean = float(np.nanmean(np.concatenate(series))) if n else 0.0
    centered = [s - mean for s in series]
    sums, pairs = _lagged(centered, centered, lags)
    if n < 3 or not sums[0] > 0:
        return _unknown(lags)

    r = sums[1:] / sums[0]
    pairs = pairs[1:]
    # Under the hypothesis r has the variance (pairs)/(n (n + 2)), which is (n - k)/(n (n + 2))
    # without a gap.
    used = pairs > 0
    statistic = float(np.sum(r[used] ** 2 * n * (n + 2) / pairs[used]))

    return _tested(statistic, max(int(used.sum()) - fitted, 1), r, NORMAL_99 / math.sqrt(n))


def whiteness_of_means(
    stretches: Sequence[ArrayLike], lags: int = LAGS, fitted: int = 0
) -> list[tuple[int, CorrelationTest]]:
    """Test residuals and their means over ever more samples, see `whiteness`.

    Noise of a sensor that is sampled fast hides slow errors from one sample to the next, and
    averages out of means. Every test is a pair of the number of samples in a mean and the result;
    whoever takes the least probability divides the level by their number.
    """
    series = [_present(s) for s in stretches]
    present = sum(np.isfinite(s).sum() for s in series)
    tests = [(1, whiteness(series, lags, fitted))]
    count = COARSER
    while present >= FEWEST_MEANS * count:
        tests.append((count, whiteness([_means(s, count) for s in series], lags)))
        count *= COARSER
    return tests


def _means(values: Array, count: int) -> Array:
    """Return the means of every `count` values (n,), NaN where half of them are missing."""
    blocks = values[: len(values) // count * count].reshape(-1, count)
    present = np.isfinite(blocks)
    numbers = present.sum(axis=1)
    sums = np.where(present, blocks, 0.0).sum(axis=1)
    return np.where(2 * numbers > count, sums / np.maximum(numbers, 1), np.nan)


def cross_correlation(
    later: Sequence[ArrayLike], earlier: Sequence[ArrayLike], lags: int = LAGS
) -> CorrelationTest:
    """Test whether a signal follows another one of 1 to `lags` samples before.

    Residuals that follow an input show that the model lacks dynamics; an input that follows
    residuals shows feedback. The same sample is not tested, since feedback may act within it. Both
    are made white first, each by an autoregression of its own, so that the color of neither looks
    like a response. No autoregression makes a sweep or a sine white: its correlations at many lags
    are nearly one, and count as few degrees of freedom.

    Source: Haugh (1976), Checking the independence of two covariance-stationary time series, JASA
    71; Ljung (1999), System Identification, 2nd ed., section 16.6; Satterthwaite (1946), Biometrics
    Bulletin 2, for a sum of squares of correlated numbers.
    """
    e, u = ([_present(s) for s in group] for group in (later, earlier))
    if sum(np.isfinite(x * y).sum() for x, y in zip(e, u, strict=True)) < 3:
        return _unknown(lags)

    a, b = (_whitened(group)[0] for group in (e, u))
    sums, pairs = _lagged(a, b, lags)
    sizes = [rms(np.concatenate(group)) for group in (a, b)]
    used = pairs[1:] > 0

    if not (sizes[0] > 0 and sizes[1] > 0 and used.any()):
        return _unknown(lags)
    r = sums[1:] / np.maximum(pairs[1:], 1) / (sizes[0] * sizes[1])
    alike = max(_alike(group, int(used.sum())) for group in (a, b))
    statistic = float(np.sum(pairs[1:] * r**2)) / alike
    return _tested(statistic, used.sum() / alike, r, NORMAL_99 / math.sqrt(pairs[1]))


def _alike(series: Sequence[Array], shifts: int) -> float:
    """Return how many of these shifts of a series count as one: 1 for a white series."""
    sums, pairs = _lagged(series, series, shifts - 1)
    # By chance, a squared correlation is the inverse of the number of samples.
    squares = (sums[1:] / sums[0]) ** 2 - 1 / pairs[0]
    return 1 + max(2 * float((1 - np.arange(1, shifts) / shifts) @ squares), 0.0)


def mean_test(stretches: Sequence[ArrayLike]) -> tuple[float, float]:
    """Return the mean of a correlated series and its standard error.

    Source: Box, Jenkins, Reinsel, Ljung, Time Series Analysis, 5th ed., section 2.2; for
    differences of forecasts Diebold and Mariano (1995), Journal of Business and Economic Statistics
    13.
    """
    series = [_present(s) for s in stretches]
    n = sum(np.isfinite(s).sum() for s in series)
    if n < 3:
        return math.nan, math.nan

    white, a = _whitened(series)
    # The spectrum at zero gives the variance of the mean: samples like their neighbors count less.
    variance = rms(np.concatenate(white)) ** 2 / float(a.sum()) ** 2
    return float(np.nanmean(np.concatenate(series))), math.sqrt(variance / n)


def _whitened(series: list[Array]) -> tuple[list[Array], Array]:
    """Return series less their common mean, filtered by their autoregression, and its filter."""
    mean = float(np.nanmean(np.concatenate(series)))
    a = autoregression([np.nan_to_num(s - mean) for s in series])
    # Σ a_k e(t - k) is NaN where a term is missing, as before the first sample.
    missing = np.full(a.size - 1, np.nan)
    return [np.convolve(np.append(missing, s - mean), a, mode="valid") for s in series], a


def _present(values: ArrayLike) -> Array:
    """Return the values as floats, NaN where they are not finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values, np.nan)


def _lagged(e: Sequence[Array], u: Sequence[Array], lags: int) -> tuple[Array, Array]:
    """Return Σ e(t) u(t - k) for k = 0 ... lags over all stretches, and the numbers of pairs."""
    sums = np.zeros((2, lags + 1))
    for pair in zip(e, u, strict=True):
        if not pair[0].size:
            continue
        present = [np.isfinite(values) for values in pair]
        values = map(np.nan_to_num, pair)
        for k, (later, earlier) in enumerate((values, present)):
            sums[k] += np.correlate(np.append(later, np.zeros(lags)), earlier)
    return sums[0], sums[1]


def _tested(statistic: float, dof: float, correlations: Array, bound: float) -> CorrelationTest:
    from scipy.special import chdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    return CorrelationTest(statistic, dof, float(chdtrc(dof, statistic)), correlations, bound)


def _unknown(lags: int) -> CorrelationTest:
    return CorrelationTest(math.nan, 0, math.nan, np.full(lags, np.nan), math.nan)
