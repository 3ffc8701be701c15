"""The correlation of a series in time, as an autoregression."""

import numpy as np

from greybox.data.files.arrays import Array

HIGHEST_ORDER = 50  # of an autoregression: the longest lag of interest


def autocovariance(stretches: list[Array], lags: int) -> Array:
    """Return mean products (lags + 1,) of samples in stretches (n,); zeros are gaps."""
    rows = (np.correlate(np.append(e, np.zeros(lags)), e) for e in stretches if e.size)
    count = sum(map(np.count_nonzero, stretches))
    return sum(rows, np.zeros(lags + 1)) / max(count, 1)


def levinson(r: Array) -> tuple[Array, Array]:
    """Return the autoregressions of order 0, 1, 2 ... from autocovariances r (lags + 1,).

    They are rows of coefficients (orders, lags + 1), filled up with zeros, and variances: with
    coefficients 1, a_1 ... a_n, e + Σ a_k e(t - k) is white with this variance. The recursion of
    Levinson and Durbin solves the Yule-Walker equations, so that all are stable, up to the order at
    which the series is predictable. Source: Box, Jenkins, Reinsel, Ljung, Time Series Analysis, 5th
    ed., appendix A3.2.
    """
    rows, variances = [np.eye(1, len(r))[0]], [r[0]]
    for k in range(1, len(r)):
        a = rows[-1].copy()
        reflection = -(a[:k] @ r[k:0:-1]) / variances[-1]
        a[: k + 1] += reflection * a[k::-1]
        variance = variances[-1] * (1 - reflection**2)
        # Innovations of less relative variance are rounding.
        if not variance > 1e-12 * r[0]:
            break
        rows.append(a)
        variances.append(variance)

    return np.array(rows), np.array(variances)


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
    rows, variances = levinson(r)
    best = np.argmin(count * np.log(variances) + np.arange(len(variances)) * np.log(count))
    return rows[best, : best + 1]
