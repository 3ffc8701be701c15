"""The correlation of a series in time, as an autoregression."""

import numpy as np

from greybox.files.arrays import Array

HIGHEST_ORDER = 50  # of an autoregression: the longest lag of interest


def autocovariance(stretches: list[Array], lags: int) -> Array:
    """Return mean products (lags + 1,) of samples in stretches (n,); zeros are gaps."""
    rows = (np.correlate(np.append(e, np.zeros(lags)), e) for e in stretches if e.size)
    count = sum(map(np.count_nonzero, stretches))
    return sum(rows, np.zeros(lags + 1)) / max(count, 1)


def levinson(r: Array) -> list[tuple[Array, float]]:
    """Return the autoregressions of order 0, 1, 2 ... from autocovariances r (lags + 1,).

    Each is a pair of coefficients and variance: with coefficients 1, a_1 ... a_n, e + Σ a_k e(t -
    k) is white with this variance. The recursion of Levinson and Durbin solves the Yule-Walker
    equations, so that all are stable, up to the order at which the series is predictable. Source:
    Box, Jenkins, Reinsel, Ljung, Time Series Analysis, 5th ed., appendix A3.2.
    """
    a: Array = np.ones(1)
    variance = float(r[0])
    steps: list[tuple[Array, float]] = [(a, variance)]
    for k in range(1, len(r)):
        reflection = -float(a @ r[k:0:-1]) / variance
        longer = np.append(a, 0.0)
        a = longer + reflection * longer[::-1]
        variance *= 1 - reflection**2
        # Innovations of less relative variance are rounding.
        if not variance > 1e-12 * r[0]:
            break
        steps.append((a, variance))

    return steps


def autoregression(stretches: list[Array]) -> Array:
    """Return 1, a_1 ... a_n such that e + Σ a_k e(t - k) is white; BIC chooses the order.

    Source: Box, Jenkins, Reinsel, Ljung, Time Series Analysis, 5th ed., section 6.2; Schwarz
    (1978), Annals of Statistics 6.
    """
    count = sum(map(np.count_nonzero, stretches))
    # Every term needs at least 20 samples.
    order = int(min(HIGHEST_ORDER, count // 20))
    r = autocovariance(stretches, order)
    if not r[0] > 0:
        return np.ones(1)
    steps = levinson(r)
    scores = [count * np.log(variance) + (len(a) - 1) * np.log(count) for a, variance in steps]
    return steps[np.argmin(scores)][0]
