"""The correlation of residuals in time, as an autoregression, and its effect on the covariance of an estimate."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HIGHEST_ORDER = 50  # of an autoregression
ORDERS = (*range(1, 13), 14, 16, 20, 25, 32, 40, HIGHEST_ORDER)  # that are tried for a vector, about log spaced
SAMPLES_PER_TERM = 20  # at least

COLUMNS = 65536  # frequencies at once in memory: 25 MB for three outputs and eight parameters

# Share of the products of samples some lag apart that must remain for missing samples to be ignored: below it, the
# covariances at all lags but zero are more than 5 % too small.
NEARLY_ALL = 0.95

# Of the response to an innovation, and its length in samples: what is left out is below rounding errors, or a slower
# decay than that of errors correlated over thousands of samples.
DIED_AWAY = 1e-9
LONGEST_RESPONSE = 5000


def autocovariance(stretches: list[Array], lags: int) -> Array:
    """Return the mean products of samples 0 to `lags` apart, within stretches (n,): (lags + 1,). Zeros are no data."""
    total = np.zeros(lags + 1)
    count = 0
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
    order = int(min(HIGHEST_ORDER, count // SAMPLES_PER_TERM))
    r = autocovariance(stretches, order)
    if not r[0] > 0:
        return np.ones(1)

    a = np.ones(1)
    variance = r[0]
    best = a
    least = count * np.log(variance)  # BIC
    for k in range(1, order + 1):
        reflection = -(a @ r[k:0:-1]) / variance
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        variance *= 1 - reflection**2
        if not variance > 1e-12 * r[0]:  # rounding errors: the series is predictable
            break
        score = count * np.log(variance) + k * np.log(count)
        if score < least:
            best = a.copy()
            least = score
    return best


@dataclass(frozen=True, eq=False)
class VectorAutoregression:
    """A vector autoregression e(t) + Σ A_j e(t - j) = w(t): A (order, k, k), and the covariance (k, k) of w, white."""

    coefficients: Array
    innovation: Array

    def response(self, longest: int = LONGEST_RESPONSE) -> Array:
        """Return how errors follow from w, e(t) = Σ h(τ) w(t - τ), until it has died away: (m, k, k)."""
        order, k = self.coefficients.shape[:2]
        if order == 0:
            return np.eye(k)[None]
        across = np.concatenate(self.coefficients[::-1], axis=1)
        result = np.zeros((longest + order, k, k))
        result[order] = np.eye(k)
        for t in range(order + 1, longest + order):
            result[t] = -across @ result[t - order : t].reshape(order * k, k)
            if t % 50 == 0 and np.abs(result[t - order + 1 : t + 1]).max() < DIED_AWAY:
                return result[order : t + 1]
        return result[order:]


def vector_autoregression(stretches: list[Array]) -> VectorAutoregression:
    """Return the vector autoregression of errors (k, n), of the order that BIC chooses; zeros are no data.

    Yule-Walker equations, so that it is stable. Source: Lütkepohl (2005), New Introduction to Multiple Time Series
    Analysis, sections 3.3.4 and 4.3.2.
    """
    k = len(stretches[0])
    counts = np.maximum(sum(np.count_nonzero(e, axis=1) for e in stretches), 1)
    count = int(counts.max())
    longest = int(min(HIGHEST_ORDER, count // (SAMPLES_PER_TERM * k)))
    r = _covariances(stretches, longest) / np.sqrt(counts * counts[:, None])

    # Outputs in units of their own deviation, with a ridge for those that are constant or combinations of others.
    deviation = np.sqrt(np.diag(r[0]))
    size = np.where(deviation > 0, deviation, 1.0)
    r = r / (size * size[:, None])
    r[0] += np.diag(np.where(deviation > 0, 1e-9, 1.0))
    best = VectorAutoregression(np.zeros((0, k, k)), r[0])
    least = count * np.linalg.slogdet(r[0])[1]

    both = np.concatenate([r[:0:-1].transpose(0, 2, 1), r])  # of lags -longest ... longest
    for order in (n for n in ORDERS if n <= longest):
        # Σ_j A_j r(i - j) = -r(i) for i = 1 ... order, with r(l) = E e(t + l) e(t)ᵀ and r(-l) = r(l)ᵀ.
        lags = longest + np.arange(order) - np.arange(order)[:, None]
        matrix = both[lags].transpose(0, 2, 1, 3).reshape(order * k, order * k)
        right = np.concatenate(r[1 : order + 1], axis=1)
        across = -np.linalg.solve(matrix.T, right.T).T
        innovation = r[0] + across @ right.T
        sign, logarithm = np.linalg.slogdet(innovation)
        if sign <= 0:
            break
        score = count * logarithm + order * k**2 * np.log(count)
        if score < least:
            coefficients = across.reshape(k, order, k).transpose(1, 0, 2)
            best = VectorAutoregression(coefficients, (innovation + innovation.T) / 2)
            least = score
    return VectorAutoregression(
        best.coefficients * size[:, None] / size, best.innovation * deviation * deviation[:, None]
    )


def _covariances(stretches: list[Array], lags: int) -> Array:
    """Return the summed products e(t + l) e(t)ᵀ, (lags + 1, k, k)."""
    k = len(stretches[0])
    total = np.zeros((lags + 1, k, k))
    for e in stretches:
        for lag in range(min(lags + 1, e.shape[1])):
            total[lag] += e[:, lag:] @ e[:, : e.shape[1] - lag].T
    return total


def colored_information(weighted: list[Array], residuals: list[Array]) -> Array:
    """Return Σ J' Σ_e J (p, p) for sensitivities over noise covariance, and residuals with their own correlation.

    `weighted` holds one array (k, p, n) per stretch, R⁻¹ dy/dθ; `residuals` one (k, n). This is the middle of the
    sandwich. Source: Morelli and Klein (1997), Accuracy of aerodynamic model parameters estimated from flight test
    data, Journal of Guidance, Control, and Dynamics 20(1); here with a vector autoregression in place of the truncated
    autocorrelations, so that it is positive semidefinite and includes correlations between outputs.
    """
    p = weighted[0].shape[1]
    found = vector_autoregression(residuals)
    values, vectors = np.linalg.eigh(found.innovation)
    response = found.response() @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    seen = _seen(residuals)
    total = np.zeros((p, p))
    for J in weighted:
        size = _fast(J.shape[2] + len(response))
        # A root of the errors' spectrum, (frequencies, k, k).
        root = np.fft.rfft(response, size, axis=0)
        weight = np.where(np.arange(len(root)) % (size // 2) == 0, 1.0, 2.0) / size
        if seen.min() < NEARLY_ALL:
            root = _unmasked(root, weight, seen)
        spectra = np.fft.rfft(J.transpose(1, 0, 2), size).transpose(2, 0, 1)
        for start in range(0, len(root), COLUMNS):
            part = slice(start, start + COLUMNS)
            rows = (spectra[part] @ root[part].conj() * np.sqrt(weight[part])[:, None, None]).transpose(1, 0, 2)
            rows = rows.reshape(p, -1)
            total += (rows @ rows.conj().T).real
    return total


def _fast(count: int) -> int:
    """Return an even length of at least `count` whose Fourier transform is fast."""
    return min(m << max((-(-count // m) - 1).bit_length(), 1) for m in (1, 3, 5, 9, 15))


def _seen(stretches: list[Array]) -> Array:
    """Return the share (k,) of the products of samples some lag apart that missing ones leave, at the best such lag.

    Near 1 where blocks are missing, or every n-th sample is present; less where samples are missing at random.
    """
    present = [(e != 0).astype(float) for e in stretches]
    if all(np.all(e) for e in present):
        return np.ones(len(present[0]))
    pairs = _covariances(present, HIGHEST_ORDER).diagonal(axis1=1, axis2=2)
    whole = _covariances([np.ones((1, e.shape[1])) for e in stretches], HIGHEST_ORDER)[:, 0, 0]
    taper = np.maximum(whole / whole[0], 1e-12)
    return np.clip((pairs[1:] / taper[1:, None]).max(axis=0) / np.maximum(pairs[0], 1), 1e-3, 1.0)


def _unmasked(root: NDArray[np.complex128], weight: Array, seen: Array) -> Array:
    """Return the root of the spectrum of errors of which a share `seen` (k,) was present, at random.

    Missing samples multiply covariances at all lags but zero by the share, as if part of the errors were white.
    """
    spectrum = root @ root.conj().transpose(0, 2, 1)
    variance = (weight[:, None, None] * spectrum).sum(axis=0).real.diagonal()
    spectrum = (spectrum - np.diag((1 - seen) * variance)) / np.sqrt(seen * seen[:, None])
    values, vectors = np.linalg.eigh(spectrum)
    return vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
