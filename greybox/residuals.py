"""The correlation of residuals in time, as an autoregression; what it does to the errors of an estimate."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LONGEST = 50  # order of an autoregression


def autocovariance(stretches: list[Array], lags: int) -> Array:
    """Return the mean products of samples 0 to `lags` apart, within stretches (n,): (lags + 1,). Zeros are no data."""
    total, count = np.zeros(lags + 1), 0
    for e in stretches:
        size = 1 << int(2 * e.size - 1).bit_length()
        spectrum = np.abs(np.fft.rfft(e, size)) ** 2
        products = np.fft.irfft(spectrum, size)[: lags + 1]
        total[: min(lags + 1, e.size)] += products[: min(lags + 1, e.size)]
        count += int(np.count_nonzero(e))
    return total / max(count, 1)


def autoregression(stretches: list[Array]) -> Array:
    """Return the coefficients 1, a_1 ... a_n with white e + Σ a_k e(t - k), of the order that BIC chooses.

    Yule-Walker equations by the recursion of Levinson and Durbin. Source: Box, Jenkins, Reinsel, Ljung, Time Series
    Analysis, 5th ed., section 6.2 and appendix A3.2; Schwarz (1978), Annals of Statistics 6.
    """
    count = sum(int(np.count_nonzero(e)) for e in stretches)
    order = int(min(LONGEST, count // 20))
    r = autocovariance(stretches, order)
    if not r[0] > 0:
        return np.ones(1)
    a, variance = np.ones(1), r[0]
    best, least = a, count * np.log(variance)
    for k in range(1, order + 1):
        reflection = -(a @ r[k:0:-1]) / variance
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        variance *= 1 - reflection**2
        if not variance > 1e-12 * r[0]:
            break
        score = count * np.log(variance) + k * np.log(count)
        if score < least:
            best, least = a.copy(), score
    return best


def filtered(coefficients: Array, signal: Array) -> Array:
    """Return Σ c_k x(t - k), (n,), zero before the first sample."""
    if len(coefficients) == 1:
        return coefficients[0] * signal
    size = 1 << int(len(signal) + len(coefficients) - 1).bit_length()
    spectrum = np.fft.rfft(signal, size) * np.fft.rfft(coefficients, size)
    return np.fft.irfft(spectrum, size)[: len(signal)]


def inverse(coefficients: Array, longest: int = 5000) -> Array:
    """Return the impulse response of 1 / (1 + Σ a_k q⁻ᵏ), until it has died away."""
    order = len(coefficients) - 1
    if order == 0:
        return np.ones(1)
    response = np.zeros(longest + order)
    response[order] = 1.0
    backward = coefficients[:0:-1]
    for t in range(order + 1, longest + order):
        response[t] = -backward @ response[t - order : t]
        if t % 50 == 0 and np.abs(response[t - order + 1 : t + 1]).max() < 1e-9:
            return response[order : t + 1]
    return response[order:]


def colored_information(weighted: list[Array], residuals: list[Array]) -> Array:
    """Return Σ J' Σ_e J (p, p) for sensitivities over noise covariance, and residuals with their own autocorrelation.

    `weighted` holds one array (k, p, n) per stretch, R⁻¹ dy/dθ; `residuals` one (k, n). This is the middle of the
    sandwich. Source: Morelli and Klein (1997), Accuracy of aerodynamic model parameters estimated from flight test
    data, Journal of Guidance, Control, and Dynamics 20(1); here with an autoregression in place of the truncated
    autocorrelation, so that it is positive semidefinite.
    """
    k, p = weighted[0].shape[:2]
    models = [autoregression([e[j] for e in residuals]) for j in range(k)]
    inverses = [inverse(a) for a in models]
    total = np.zeros((p, p))
    white = np.concatenate([np.array([filtered(models[j], e[j]) for j in range(k)]) for e in residuals], axis=1)
    present = np.concatenate([e != 0 for e in residuals], axis=1)
    together = (present.astype(float) @ present.T).clip(1)
    covariance = np.where(present, white, 0.0) @ np.where(present, white, 0.0).T / together
    for J in weighted:
        # The transposed inverse of the whitening filter runs backward in time.
        colored = [np.array([filtered(inverses[j], row[::-1]) for row in J[j]]) for j in range(k)]
        for i in range(k):
            for j in range(k):
                total += covariance[i, j] * colored[i] @ colored[j].T
    return total
