"""The state at the beginning of every window, estimated from its lead-in, all at once.

Each is the maximum a posteriori estimate, by Gauss-Newton steps, under the noise of the outputs and
a prior that the windows share. The prior's mean and spread of each state are those of all windows
(empirical Bayes by expectation and maximization), so that a state on which a short lead-in carries
little information stays near its mean over the record. Formulas need not be finite everywhere (a
root of a level): a window begins with the first of several guesses from which its lead-in is
finite, or else where the others are on average, and no step leaves the values with finite outputs.
Source: Jazwinski (1970), Stochastic Processes and Filtering Theory, section 5.3; Dempster, Laird
and Rubin (1977), Maximum likelihood from incomplete data via the EM algorithm, Journal of the Royal
Statistical Society B 39.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array, BoolArray

Outputs = Callable[[Array], Array]  # initial states (w, n) -> outputs (w, samples, k)
# Initial states (w, n) -> outputs' derivatives by them (w, samples, k, n).
Sensitivities = Callable[[Array], Array]

ROUNDING = 1e-9  # share of an output's spread: smaller noise would make the information singular
TINY = 1e-300  # instead of a division by zero


@dataclass(frozen=True, eq=False)
class StateEstimates:
    """States of all windows at the first sample of their lead-ins, and what is known of them.

    Attributes
    ----------
    states : (w, n) array
    covariance : (w, n, n) array
        Of their errors, given the parameters.
    noise : (k, k) array
        Covariance of the outputs' errors, given or estimated from the lead-ins.
    mean, precision : (n,) arrays
        Of the prior.
    not_finite : (w,) bool array
        Windows for which no states with finite outputs were found; their states mean nothing.
    """

    states: Array
    covariance: Array
    noise: Array
    mean: Array
    precision: Array
    not_finite: BoolArray


def estimate_states(
    outputs: Outputs,
    sensitivities: Sensitivities,
    measured: Array,
    guesses: Sequence[Array],
    noise: Array | None,
    spread: Array,
) -> StateEstimates:
    """Estimate the states (w, n) from `measured` (w, samples, k), NaN where missing.

    Every window begins with the first of the `guesses` from which its lead-in is finite.

    `noise` (k, k) is None where it is to be estimated; `spread` (k,) is that of the outputs over
    the record.
    """
    w, n = guesses[0].shape
    lead_ins = _LeadIns(outputs, sensitivities, measured)
    floor = np.diag((ROUNDING * spread) ** 2)
    R = np.diag((0.1 * spread) ** 2) + floor if noise is None else noise + floor
    x = guesses[0]
    e, S, finite = lead_ins.linearized(x)
    for guess in guesses[1:]:
        if finite.all():
            break
        x = np.where(finite[:, None], x, guess)
        e, S, finite = lead_ins.linearized(x)
    if not finite.any():
        unknown = np.full(n, np.nan)
        return StateEstimates(x, np.full((w, n, n), np.nan), R, unknown, unknown, ~finite)
    if not finite.all():
        # Begin the other windows where these are on average.
        x = np.where(finite[:, None], x, x[finite].mean(axis=0))
        e, S, finite = lead_ins.linearized(x)

    mean = x[finite].mean(axis=0)
    precision = np.zeros(n)
    posterior = np.zeros((w, n, n))
    # Most settle in 5 or 6 iterations; tanks that drain within a lead-in took 23.
    for iteration in range(30):
        # The prior, and a noise that is not known, are estimated again at first, then held: the
        # iterations minimize one function and settle.
        adapting = iteration < 4
        if noise is None and adapting and iteration:
            present = np.isfinite(measured) & finite[:, None, None]
            R = residual_noise(e, S, present, posterior, R) + floor
        H, b = information_of(e, S, R)
        if adapting:
            states = np.einsum("wij,wj->wi", H, x) + b
            mean, precision = shared_prior(
                H[finite], states[finite], mean, measured[finite], R, spread
            )
        posterior = _inverse(H, precision)
        step = np.einsum("wij,wj->wi", posterior, b - precision * (x - mean))
        step = np.where(finite[:, None], step, 0.0)
        step = _halved(step, x, e, lead_ins, R, mean, precision)
        x = x + step
        e, S, finite = lead_ins.linearized(x)
        deviation = np.sqrt(np.maximum(np.diagonal(posterior, axis1=1, axis2=2), TINY))
        if not adapting and np.all(np.abs(step) <= 1e-3 * deviation):
            break

    H, _ = information_of(e, S, R)
    return StateEstimates(x, _inverse(H, precision), R, mean, precision, ~finite)


def _halved(
    step: Array, x: Array, e: Array, lead_ins: "_LeadIns", R: Array, mean: Array, precision: Array
) -> Array:
    """Halve the step (w, n) of every window until it does not cost more, by more than rounding."""
    weight = np.linalg.inv(np.linalg.cholesky(R))

    def cost(e: Array, x: Array) -> Array:
        with np.errstate(invalid="ignore", over="ignore"):
            squares = (np.einsum("ij,wtj->wti", weight, e) ** 2).sum(axis=(1, 2))
        squares = np.where(np.isfinite(squares), squares, np.inf)
        return squares + (precision * (x - mean) ** 2).sum(axis=1)

    limit = cost(e, x) * (1 + 1e-9) + 1e-9
    worse = np.any(step != 0, axis=1)
    for _ in range(20):  # to a millionth
        worse &= ~(cost(lead_ins.residual(x + step), x + step) <= limit)
        if not worse.any():
            break
        step = np.where(worse[:, None], step / 2, step)
    return np.where(worse[:, None], 0.0, step)


def without_states(errors: Array, noise: Array | None, spread: Array) -> StateEstimates:
    """Return estimates without states: the noise, given or that of the errors (w, samples, k)."""
    w, k = len(errors), errors.shape[-1]
    if noise is None:
        squares = np.nansum(errors.reshape(-1, k) ** 2, axis=0)
        noise = np.diag(squares / np.maximum(np.isfinite(errors.reshape(-1, k)).sum(axis=0), 1))
    R = noise + np.diag((ROUNDING * spread) ** 2)
    return StateEstimates(
        np.zeros((w, 0)), np.zeros((w, 0, 0)), R, np.zeros(0), np.zeros(0), np.zeros(w, dtype=bool)
    )


def one_step_errors(
    e: Array, sensitivities: Array, offset: Array, precision: Array, noise: Array
) -> Array:
    """Return the errors one sample ahead in standard deviations, (w, samples, k), NaN if missing.

    Each output is predicted from all that was measured before it in the window, and the prior: a
    Kalman filter of the initial state, linear about a trajectory with residuals `e` (w, samples, k)
    and `sensitivities` (w, samples, k, n), from which the prior's mean is `offset` (w, n). For the
    right model they are white with unit variance. Source: Brown, Durbin and Evans (1975),
    Techniques for testing the constancy of regression relationships over time, Journal of the Royal
    Statistical Society B 37 (recursive residuals).
    """
    w, samples, k = e.shape
    variance = np.diag(noise)
    x = offset.copy()
    P = np.broadcast_to(np.diag(1 / precision), (w, len(precision), len(precision))).copy()
    result = np.full(e.shape, np.nan)
    for t in range(samples):
        for j in range(k):
            h = sensitivities[:, t, j]
            present = np.isfinite(e[:, t, j])
            s = np.einsum("wij,wj->wi", P, h)
            total = np.einsum("wi,wi->w", s, h) + variance[j]
            error = e[:, t, j] - np.einsum("wi,wi->w", h, x)
            result[:, t, j] = error / np.sqrt(total)

            gain = np.where(present[:, None], s / total[:, None], 0.0)
            x = x + gain * np.where(present, error, 0.0)[:, None]
            P = P - gain[:, :, None] * s[:, None, :]
    return result


@dataclass(frozen=True, eq=False)
class _LeadIns:
    """Residuals e and sensitivities S of the lead-ins as functions of the first states (w, n)."""

    outputs: Outputs
    sensitivities: Sensitivities
    measured: Array

    def residual(self, x: Array) -> Array:
        """Return measured less simulated: zero if nothing was measured, infinite if not finite."""
        e = self.measured - self.outputs(x)
        return np.where(np.isfinite(self.measured), np.where(np.isfinite(e), e, np.inf), 0.0)

    def linearized(self, x: Array) -> tuple[Array, Array, BoolArray]:
        """Return e, S and which windows are finite; e and S are zero in the others."""
        e = self.residual(x)
        S = self.sensitivities(x)
        finite = np.all(np.isfinite(e), axis=(1, 2)) & np.all(np.isfinite(S), axis=(1, 2, 3))
        usable = finite[:, None, None]
        return (
            np.where(usable, e, 0.0).astype(float),
            np.where(usable[..., None], S, 0.0).astype(float),
            finite,
        )


def information_of(e: Array, S: Array, R: Array) -> tuple[Array, Array]:
    """Return SᵀR⁻¹S (w, n, n) and SᵀR⁻¹e (w, n); S must be zero where nothing was measured."""
    weight = np.linalg.inv(np.linalg.cholesky(R))
    w, samples, k, n = S.shape
    J = np.einsum("ij,wtjn->wtin", weight, S).reshape(w, samples * k, n)
    r = np.einsum("ij,wtj->wti", weight, e).reshape(w, -1)
    return np.matmul(J.transpose(0, 2, 1), J), np.einsum("wmn,wm->wn", J, r)


def _inverse(H: Array, precision: Array) -> Array:
    return np.asarray(np.linalg.inv(H + np.diag(precision)), dtype=np.float64)


def shared_prior(
    H: Array, information: Array, mean: Array, measured: Array, R: Array, spread: Array
) -> tuple[Array, Array]:
    """Return the prior's mean and precision (n,) from H (w, n, n) and H x̂ (w, n) of every window.

    It begins so weak that a state must change the outputs by their spread. Fewer than ten windows
    do not determine the spread of their states.
    """
    w = len(H)
    counts = np.isfinite(measured).sum(axis=(0, 1)) / w
    signal = max(float(counts @ (spread**2 / np.diag(R))), TINY)
    seen = np.mean(np.diagonal(H, axis1=1, axis2=2), axis=0)
    precision = np.where(seen > 0, seen / signal, 1.0)
    if w < 10:
        return mean, precision
    # Expectation and maximization, which cost no simulation.
    for _ in range(50):
        covariance = _inverse(H, precision)
        x = np.einsum("wij,wj->wi", covariance, information + precision * mean)
        mean = x.mean(axis=0)
        variance = np.diagonal(covariance, axis1=1, axis2=2).sum(axis=0)
        variance = variance + ((x - mean) ** 2).sum(axis=0)
        # A least precision keeps states that no output shows in place.
        precision = np.maximum((w - 1) / variance, 1e-12 * seen + TINY)
    return mean, precision


def residual_noise(e: Array, S: Array, present: BoolArray, posterior: Array, R: Array) -> Array:
    """Return the variances of the residuals as a diagonal (k, k), corrected for the fitted states.

    `present` (w, samples, k) tells which residuals there are.
    """
    H, _ = information_of(e, S, R)
    count = np.maximum(present.sum(axis=(0, 1)), 1)
    fitted = float(np.einsum("wij,wji->", H, posterior)) / count.sum()
    # Estimated states leave a tenth of the residuals free, at least.
    return np.diag((e**2).sum(axis=(0, 1)) / (count * max(1 - fitted, 0.1)))
