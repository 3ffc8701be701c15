"""Estimate the state at the beginning of every window from its lead-in, for all windows at once.

Gauss-Newton steps lead to the maximum a posteriori estimate, under the noise of the outputs and a
prior that the windows share. Mean and spread of this prior are estimated from all windows
(empirical Bayes by expectation and maximization). A state on which a short lead-in has little
information then stays near its mean over the record. A formula, such as the root of a level, need
not be finite everywhere: if the lead-in is not finite from the guess of a window, the window begins
at the mean of the others, and no step leads to outputs that are not finite.
Source: Jazwinski (1970), Stochastic Processes and Filtering Theory, section 5.3; Dempster, Laird
and Rubin (1977), Maximum likelihood from incomplete data via the EM algorithm, Journal of the Royal
Statistical Society B 39.
"""

from collections.abc import Callable

import numpy as np

from greybox.data.files.arrays import Array, BoolArray
from greybox.data.files.frozen_values import frozen

Outputs = Callable[[Array], Array]  # initial states (w, n) -> outputs (w, samples, k)
# Initial states (w, n) -> derivatives of the outputs with respect to them (w, samples, k, n).
Sensitivities = Callable[[Array], Array]

# Replaces zero in a divisor.
TINY = 1e-300
# Most Gauss-Newton iterations. Most windows settle in 5 or 6; tanks that drain within a lead-in
# took 23.
MOST_ITERATIONS = 30
# Iterations in which the prior, and an unknown noise, are updated. They are fixed afterwards: the
# iterations then minimize one function, and settle.
ADAPTING = 4
# Most halvings of a step: to a millionth.
MOST_HALVINGS = 20
# Fewest windows that determine the spread of their states.
FEWEST_WINDOWS = 10


@frozen
class StateEstimates:
    """States of all windows at the first sample of their lead-ins, with their prior.

    Attributes
    ----------
    states : (w, n) array
    noise : (k, k) array
        Covariance of the outputs' errors, given or estimated from the lead-ins.
    mean, precision : (n,) arrays
        Mean and inverse variances of the prior.
    not_finite : (w,) bool array
        Windows without states that give finite outputs; their states are meaningless.
    """

    states: Array
    noise: Array
    mean: Array
    precision: Array
    not_finite: BoolArray


def estimate_states(
    outputs: Outputs,
    sensitivities: Sensitivities,
    measured: Array,
    guess: Array,
    noise: Array | None,
    spread: Array,
) -> StateEstimates:
    """Estimate the states (w, n) from `measured` (w, samples, k), NaN where missing.

    Every window begins with its `guess` (w, n), or, if its lead-in is not finite from there, at the
    mean of the others.

    `noise` (k, k) is None if it is to be estimated; `spread` (k,) is the standard deviation of the
    outputs over the record.
    """
    w, n = guess.shape

    def residual(x: Array) -> Array:
        """Return measured less simulated: zero if nothing was measured, infinite if not finite."""
        e = measured - outputs(x)
        return np.where(np.isfinite(measured), np.where(np.isfinite(e), e, np.inf), 0.0)

    # Smaller noise would make the information singular.
    floor = np.diag((1e-9 * spread) ** 2)
    R = np.diag((0.1 * spread) ** 2) + floor if noise is None else noise + floor
    x = guess
    e, S, finite = _linearized(x, residual, sensitivities)
    if not finite.any():
        unknown = np.full(n, np.nan)
        return StateEstimates(x, R, unknown, unknown, ~finite)
    if not finite.all():
        # The other windows begin at the mean of the windows that are finite.
        x = np.where(finite[:, None], x, x[finite].mean(axis=0))
        e, S, finite = _linearized(x, residual, sensitivities)

    mean = x[finite].mean(axis=0)
    precision = np.zeros(n)
    posterior = np.zeros((w, n, n))
    for iteration in range(MOST_ITERATIONS):
        is_adapting = iteration < ADAPTING
        # In the first iteration no posterior is known yet.
        if noise is None and is_adapting and iteration > 0:
            present = np.isfinite(measured) & finite[:, None, None]
            R = residual_noise(e, S, present, posterior, R) + floor
        H, b = information_of(e, S, R)
        if is_adapting:
            states = np.einsum("wij,wj->wi", H, x) + b
            mean, precision = shared_prior(
                H[finite], states[finite], mean, measured[finite], R, spread
            )
        posterior = np.linalg.inv(H + np.diag(precision))
        step = np.einsum("wij,wj->wi", posterior, b - precision * (x - mean))
        step = np.where(finite[:, None], step, 0.0)
        step = _halved(step, x, e, residual, R, mean, precision)
        x = x + step
        e, S, finite = _linearized(x, residual, sensitivities)
        deviation = np.sqrt(np.maximum(np.linalg.diagonal(posterior), TINY))
        if not is_adapting and np.all(np.abs(step) <= 1e-3 * deviation):
            break

    return StateEstimates(x, R, mean, precision, ~finite)


def _halved(
    step: Array, x: Array, e: Array, residual: Outputs, R: Array, mean: Array, precision: Array
) -> Array:
    """Halve the step (w, n) of every window until its cost grows by no more than rounding."""
    weight = whitening(R)

    def cost(e: Array, x: Array) -> Array:
        with np.errstate(all="ignore"):
            squares = ((e @ weight.T) ** 2).sum(axis=(1, 2))
        squares = np.where(np.isfinite(squares), squares, np.inf)
        return squares + (precision * (x - mean) ** 2).sum(axis=1)

    limit = cost(e, x) * (1 + 1e-9) + 1e-9
    is_worse = np.any(step != 0, axis=1)
    for _ in range(MOST_HALVINGS):
        is_worse &= ~(cost(residual(x + step), x + step) <= limit)
        if not is_worse.any():
            break
        step = np.where(is_worse[:, None], step / 2, step)
    return np.where(is_worse[:, None], 0.0, step)


# Along a motion that diverges, numbers overflow: its errors are then unknown.
@np.errstate(over="ignore", invalid="ignore")
def one_step_errors(
    e: Array, sensitivities: Array, offset: Array, precision: Array, noise: Array
) -> Array:
    """Return the errors one sample ahead in standard deviations, (w, samples, k), NaN if missing.

    A Kalman filter of the initial state predicts each output from the prior and from all earlier
    measurements in the window. For the right model, the errors are white with unit variance.

    Parameters
    ----------
    e : (w, samples, k) array
        Residuals of a trajectory, about which the filter is linear.
    sensitivities : (w, samples, k, n) array
        Derivatives of the outputs by the initial state of this trajectory.
    offset : (w, n) array
        Mean of the prior less this initial state.
    precision : (n,) array
        Inverse variances of the prior.
    noise : (k, k) array
        Covariance of the errors of the outputs.

    Source: Brown, Durbin and Evans (1975), Techniques for testing the constancy of regression
    relationships over time, Journal of the Royal Statistical Society B 37 (recursive residuals).
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
            # Rounding may make the variance of a sensitive motion negative.
            total = np.maximum(np.einsum("wi,wi->w", s, h), 0.0) + variance[j]
            error = e[:, t, j] - np.einsum("wi,wi->w", h, x)
            result[:, t, j] = error / np.sqrt(total)

            gain = np.where(present[:, None], s / total[:, None], 0.0)
            x = x + gain * np.where(present, error, 0.0)[:, None]
            P = P - gain[:, :, None] * s[:, None, :]
    return np.where(np.isfinite(result), result, np.nan)


def _linearized(
    x: Array, residual: Outputs, sensitivities: Sensitivities
) -> tuple[Array, Array, BoolArray]:
    """Return e, S and which windows are finite at x (w, n); e and S are zero in the others."""
    e = residual(x)
    S = sensitivities(x)
    finite = np.all(np.isfinite(e), axis=(1, 2)) & np.all(np.isfinite(S), axis=(1, 2, 3))
    usable = finite[:, None, None]
    return (
        np.where(usable, e, 0.0),
        np.where(usable[..., None], S, 0.0),
        finite,
    )


def information_of(e: Array, S: Array, R: Array) -> tuple[Array, Array]:
    """Return SᵀR⁻¹S (w, n, n) and SᵀR⁻¹e (w, n); S must be zero where nothing was measured."""
    weight = whitening(R)
    w, samples, k, n = S.shape
    J = (weight @ S).reshape(w, samples * k, n)
    r = (e @ weight.T).reshape(w, -1)
    return J.mT @ J, np.einsum("wmn,wm->wn", J, r)


def whitening(covariance: Array) -> Array:
    """Return W (k, k) such that the elements of W e are independent and of variance one."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def shared_prior(
    H: Array, information: Array, mean: Array, measured: Array, R: Array, spread: Array
) -> tuple[Array, Array]:
    """Return the prior's mean and precision (n,) from H (w, n, n) and H x̂ (w, n) of every window.

    Fewer than ten windows do not determine the spread of their states: the prior then stays weak.
    """
    w = len(H)
    # The weak prior: one standard deviation of a state changes the outputs by their spread.
    counts = np.isfinite(measured).sum(axis=(0, 1)) / w
    signal = max(float(counts @ (spread**2 / np.diag(R))), TINY)
    information_of_window = np.mean(np.linalg.diagonal(H), axis=0)
    is_observable = information_of_window > 0
    precision = np.where(is_observable, information_of_window / signal, 1.0)
    if w < FEWEST_WINDOWS:
        return mean, precision
    # Expectation and maximization: these need no simulation.
    for _ in range(50):
        covariance = np.linalg.inv(H + np.diag(precision))
        x = np.einsum("wij,wj->wi", covariance, information + precision * mean)
        mean = x.mean(axis=0)
        variance = np.linalg.diagonal(covariance).sum(axis=0)
        variance = variance + ((x - mean) ** 2).sum(axis=0)
        # Unobservable states need some precision, or they would drift.
        precision = np.maximum((w - 1) / variance, 1e-12 * information_of_window + TINY)
    return mean, precision


def residual_noise(e: Array, S: Array, present: BoolArray, posterior: Array, R: Array) -> Array:
    """Return the variances of the residuals as a diagonal (k, k), corrected for the fitted states.

    `present` (w, samples, k) marks the measured residuals.
    """
    # The trace is the number of degrees of freedom that the fitted states use up.
    H, _ = information_of(e, S, R)
    count = np.maximum(present.sum(axis=(0, 1)), 1)
    share = float(np.einsum("wij,wji->", H, posterior)) / count.sum()
    # The share is limited to nine tenths, so that few measurements do not make the noise infinite.
    return np.diag((e**2).sum(axis=(0, 1)) / (count * max(1 - share, 0.1)))
