"""Tests for autocorrelation of residuals, and for their correlation with inputs.

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

# Lags of a test by default: Ljung (1999), section 16.6, takes 20 to 30.
LAGS = 25
# Factor between the numbers of samples in the means of successive tests. The lags that two
# successive tests cover overlap, so that no correlation is missed between them.
COARSER = 4
# Fewest means of a test: with fewer, correlations at 12 lags are too uncertain.
FEWEST_MEANS = 150
# Standard deviations within which 99 % of normal values lie.
NORMAL_99 = 2.576


@frozen
class CorrelationTest:
    """A statistic with its degrees of freedom, and the probability of a larger one by chance.

    Attributes
    ----------
    statistic, dof : float
        The statistic has a chi-square distribution with these degrees of freedom if nothing is
        correlated.
    p_value : float
    correlations : (lags,) array
        The tested correlations.
    bound : float
        Without correlation, 99 % of `correlations` lie within ± `bound`.
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
    # For white residuals r has the variance (pairs)/(n (n + 2)), which is (n - k)/(n (n + 2))
    # without a gap.
    used = pairs > 0
    statistic = float(np.sum(r[used] ** 2 * n * (n + 2) / pairs[used]))

    return _chi_square_test(
        statistic, max(int(used.sum()) - fitted, 1), r, NORMAL_99 / math.sqrt(n)
    )


def whiteness_of_means(
    stretches: Sequence[ArrayLike], lags: int = LAGS, fitted: int = 0
) -> list[tuple[int, CorrelationTest]]:
    """Test residuals and their means over ever more samples, see `whiteness`.

    Noise of a sensor that is sampled fast hides slow errors from one sample to the next, and
    averages out of means. Every test is a pair of the number of samples in a mean and the result.
    With the smallest p-value of all tests, divide the level by their number (Bonferroni).
    """
    series = [_present(s) for s in stretches]
    present = sum(np.isfinite(s).sum() for s in series)
    tests = [(1, whiteness(series, lags, fitted))]
    count = COARSER
    while present >= FEWEST_MEANS * count:
        # Fitted gains null the correlations of neighboring samples, not those of means.
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
    """Test whether a signal follows another one with a delay of 1 to `lags` samples.

    Residuals that follow an input show that the model lacks dynamics; an input that follows
    residuals shows feedback. A delay of zero is not tested, since feedback may act within a sample.
    Both signals are whitened first, each by its own autoregression: the correlation of either in
    time would otherwise look like a response. No autoregression whitens a sweep or a sine: its
    correlations at many lags are nearly one, and count as few degrees of freedom.

    Source: Haugh (1976), Checking the independence of two covariance-stationary time series, JASA
    71; Ljung (1999), System Identification, 2nd ed., section 16.6; Satterthwaite (1946), Biometrics
    Bulletin 2, for a sum of squares of correlated numbers.
    """
    later_series = [_present(s) for s in later]
    earlier_series = [_present(s) for s in earlier]
    both = zip(later_series, earlier_series, strict=True)
    if sum(np.isfinite(e * u).sum() for e, u in both) < 3:
        return _unknown(lags)

    white_later, _ = _whitened(later_series)
    white_earlier, _ = _whitened(earlier_series)
    sums, pairs = _lagged(white_later, white_earlier, lags)
    later_size = rms(np.concatenate(white_later))
    earlier_size = rms(np.concatenate(white_earlier))
    used = pairs[1:] > 0
    # The negated comparison is also true for NaN.
    if not (later_size > 0 and earlier_size > 0 and used.any()):
        return _unknown(lags)

    r = sums[1:] / np.maximum(pairs[1:], 1) / (later_size * earlier_size)
    count = int(used.sum())
    inflation = max(
        _variance_inflation(white_later, count), _variance_inflation(white_earlier, count)
    )
    statistic = float(np.sum(pairs[1:] * r**2)) / inflation
    return _chi_square_test(statistic, count / inflation, r, NORMAL_99 / math.sqrt(pairs[1]))


def _variance_inflation(series: Sequence[Array], lags: int) -> float:
    """Return how many lags of a series count as one: 1 for a white series."""
    sums, pairs = _lagged(series, series, lags - 1)
    # By chance, a squared correlation is the inverse of the number of samples.
    squares = (sums[1:] / sums[0]) ** 2 - 1 / pairs[0]
    weights = 1 - np.arange(1, lags) / lags
    return 1 + max(2 * float(weights @ squares), 0.0)


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

    white, coefficients = _whitened(series)
    # The spectrum at zero frequency gives the variance of the mean: correlated samples count less.
    variance = rms(np.concatenate(white)) ** 2 / float(coefficients.sum()) ** 2
    return float(np.nanmean(np.concatenate(series))), math.sqrt(variance / n)


def _whitened(series: list[Array]) -> tuple[list[Array], Array]:
    """Return series less their common mean, filtered by their autoregression, and its filter."""
    mean = float(np.nanmean(np.concatenate(series)))
    coefficients = autoregression([np.nan_to_num(s - mean) for s in series])
    # Σ a_k e(t - k) is NaN where a term is missing, as before the first sample.
    missing = np.full(coefficients.size - 1, np.nan)
    white = []
    for values in series:
        centered = np.append(missing, values - mean)
        white.append(np.convolve(centered, coefficients, mode="valid"))
    return white, coefficients


def _present(values: ArrayLike) -> Array:
    """Return the values as floats, NaN where they are not finite."""
    values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(values), values, np.nan)


def _lagged(e: Sequence[Array], u: Sequence[Array], lags: int) -> tuple[Array, Array]:
    """Return Σ e(t) u(t - k) for k = 0 ... lags over all stretches, and the numbers of pairs."""
    sums = np.zeros(lags + 1)
    pairs = np.zeros(lags + 1)
    padding = np.zeros(lags)
    for later, earlier in zip(e, u, strict=True):
        if not later.size:
            continue
        sums += np.correlate(np.append(np.nan_to_num(later), padding), np.nan_to_num(earlier))
        pairs += np.correlate(np.append(np.isfinite(later), padding), np.isfinite(earlier))
    return sums, pairs


def _chi_square_test(
    statistic: float, dof: float, correlations: Array, bound: float
) -> CorrelationTest:
    """Return the test of a statistic that has a chi-square distribution."""
    from scipy.special import chdtrc  # noqa: PLC0415  (takes a tenth of a second to import)

    return CorrelationTest(statistic, dof, float(chdtrc(dof, statistic)), correlations, bound)


def _unknown(lags: int) -> CorrelationTest:
    """Return the test of series with too few values."""
    return CorrelationTest(
        statistic=math.nan,
        dof=0,
        p_value=math.nan,
        correlations=np.full(lags, np.nan),
        bound=math.nan,
    )
