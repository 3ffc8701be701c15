"""State estimation: the state at the beginning of every window from its lead-in, all windows at once.

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
Sensitivities = Callable[
    [Array], Array
]  # initial states (w, n) -> outputs' derivatives by them (w, samples, k, n)

ITERATIONS = 30  # of Gauss-Newton: most settle in 5 or 6, tanks that drain within a lead-in took 23
SETTLED = 1e-3  # of a state's posterior standard deviation: a step that does not matter
# Iterations in which the prior, and a noise that is not known, are estimated anew. Then they are
# held, so that the iterations minimize one function and settle.
ADAPTING = 4
PRIOR_STEPS = 50  # of expectation and maximization within an iteration, which costs no simulation
FEWEST_WINDOWS = 10  # below which their states do not determine a spread
FIRST_NOISE = 0.1  # of an output's spread: noise taken at first where none is known
ROUNDING = (
    1e-9  # of an output's spread: noise below is rounding, and would make the information singular
)
HALVINGS = 20  # of a step: to a millionth
# Of the information of the lead-in: the least precision of a prior, which keeps states that no
# output shows in place.
LEAST_PRECISION = 1e-12
TINY = 1e-300  # instead of a division by zero
LEAST_FREEDOM = 0.1  # share of the residuals that estimated states leave free, at least


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
    """Estimate the states (w, n) from `measured` (w, samples, k), NaN where missing, beginning at one of `guesses`.

    `noise` (k, k) is None where it is to be estimated; `spread` (k,) is that of the outputs over
    the record.
    """
    w, n = guesses[0].shape
    lead_ins = _LeadIns(outputs, sensitivities, measured)
    R = noise if noise is not None else np.diag((FIRST_NOISE * spread) ** 2)
    R = R + np.diag((ROUNDING * spread) ** 2)
    x, e, S, finite = lead_ins.begin(guesses)
    if not finite.any():
        unknown = np.full(n, np.nan)
        return StateEstimates(x, np.full((w, n, n), np.nan), R, unknown, unknown, ~finite)

    mean = x[finite].mean(axis=0)
    precision = np.zeros(n)
    posterior = np.zeros((w, n, n))
    for iteration in range(ITERATIONS):
        adapting = iteration < ADAPTING
        if noise is None and 0 < iteration < ADAPTING:
            R = _noise_of(e, S, np.isfinite(measured) & finite[:, None, None], posterior, R, spread)
        H, b = _information(e, S, R)
        if adapting:
            information = np.einsum("wij,wj->wi", H, x) + b
            mean, precision = _prior(
                H[finite], information[finite], mean, measured[finite], R, spread
            )

        posterior = _inverse(H, precision)
        step = np.einsum("wij,wj->wi", posterior, b - precision * (x - mean))
        x, e, taken = _line_search(
            lead_ins.residual, _Posterior(R, mean, precision), x, e, step, finite
        )
        x, e, S, finite = lead_ins.linear(x, e)
        deviation = np.sqrt(np.maximum(np.diagonal(posterior, axis1=1, axis2=2), TINY))
        if not adapting and np.all(np.abs(taken) <= SETTLED * deviation):
            break

    H, _ = _information(e, S, R)
    return StateEstimates(x, _inverse(H, precision), R, mean, precision, ~finite)


def without_states(errors: Array, noise: Array | None, spread: Array) -> StateEstimates:
    """Return the estimates of a static model with these errors (w, samples, k): its noise, given or theirs."""
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
    """Return the errors one sample ahead in units of their standard deviations, (w, samples, k); NaN where missing.

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
    """The lead-ins of all windows as functions of their initial states x (w, n): residuals e, sensitivities S."""

    outputs: Outputs
    sensitivities: Sensitivities
    measured: Array

    def residual(self, x: Array) -> Array:
        """Return measured less simulated, zero where nothing was measured, infinite where the model is not finite."""
        e = self.measured - self.outputs(x)
        return np.where(np.isfinite(self.measured), np.where(np.isfinite(e), e, np.inf), 0.0)

    def begin(self, guesses: Sequence[Array]) -> tuple[Array, Array, Array, BoolArray]:
        """Return x, e, S and which windows are finite, from the first guess that makes each of them so."""
        x = guesses[0]
        e, S, finite = self._at(x)
        for guess in guesses[1:]:
            if finite.all():
                break
            x = np.where(finite[:, None], x, guess)
            e, S, finite = self._at(x)
        return self._completed(x, e, S, finite)

    def linear(self, x: Array, e: Array) -> tuple[Array, Array, Array, BoolArray]:
        """Return x, e, S and which windows are finite where the residuals are `e`; x is changed where one is not."""
        S = self.sensitivities(x)
        return self._completed(x, e, S, _finite(e, S))

    def _at(self, x: Array) -> tuple[Array, Array, BoolArray]:
        e = self.residual(x)
        S = self.sensitivities(x)
        return e, S, _finite(e, S)

    def _completed(
        self, x: Array, e: Array, S: Array, finite: BoolArray
    ) -> tuple[Array, Array, Array, BoolArray]:
        """Begin windows that are not finite where the others are on average; where that fails they do not count."""
        if not finite.all() and finite.any():
            x = np.where(finite[:, None], x, x[finite].mean(axis=0))
            e, S, finite = self._at(x)
        return (
            x,
            np.where(finite[:, None, None], e, 0.0),
            np.where(finite[:, None, None, None], S, 0.0),
            finite,
        )


def _finite(e: Array, S: Array) -> BoolArray:
    return np.all(np.isfinite(e), axis=(1, 2)) & np.all(np.isfinite(S), axis=(1, 2, 3))


def _information(e: Array, S: Array, R: Array) -> tuple[Array, Array]:
    """Return SᵀR⁻¹S (w, n, n) and SᵀR⁻¹e (w, n) over what was measured; S must be zero elsewhere."""
    weight = np.linalg.inv(np.linalg.cholesky(R))
    w, samples, k, n = S.shape
    J = np.einsum("ij,wtjn->wtin", weight, S).reshape(w, samples * k, n)
    r = np.einsum("ij,wtj->wti", weight, e).reshape(w, -1)
    return np.matmul(J.transpose(0, 2, 1), J), np.einsum("wmn,wm->wn", J, r)


def _inverse(H: Array, precision: Array) -> Array:
    return np.asarray(np.linalg.inv(H + np.diag(precision)), dtype=np.float64)


def _prior(
    H: Array, information: Array, mean: Array, measured: Array, R: Array, spread: Array
) -> tuple[Array, Array]:
    """Return the prior's mean and precision (n,) from H (w, n, n) and H x̂ (w, n) of every window.

    It begins as weak as a state must change to change the outputs by their spread.
    """
    w = len(H)
    counts = np.isfinite(measured).sum(axis=(0, 1)) / w
    signal = max(float(counts @ (spread**2 / np.diag(R))), TINY)
    seen = np.mean(np.diagonal(H, axis1=1, axis2=2), axis=0)
    weak = np.where(seen > 0, seen / signal, 1.0)
    precision = weak.copy()
    if w < FEWEST_WINDOWS:
        return mean, precision
    for _ in range(PRIOR_STEPS):
        covariance = _inverse(H, precision)
        x = np.einsum("wij,wj->wi", covariance, information + precision * mean)
        mean = x.mean(axis=0)
        variance = np.diagonal(covariance, axis1=1, axis2=2).sum(axis=0) + ((x - mean) ** 2).sum(
            axis=0
        )
        precision = np.maximum((w - 1) / variance, LEAST_PRECISION * seen + TINY)
    return mean, precision


def _noise_of(
    e: Array, S: Array, present: BoolArray, posterior: Array, R: Array, spread: Array
) -> Array:
    """Return the variances of the residuals, corrected for what the states have fitted away, as a diagonal (k, k).

    `present` (w, samples, k) says which of them there are.
    """
    H, _ = _information(e, S, R)
    count = np.maximum(present.sum(axis=(0, 1)), 1)
    fitted = float(np.einsum("wij,wji->", H, posterior)) / count.sum()
    squares = np.where(np.isfinite(e), e**2, 0.0).sum(axis=(0, 1))
    return np.diag(squares / (count * max(1 - fitted, LEAST_FREEDOM)) + (ROUNDING * spread) ** 2)


@dataclass(frozen=True, eq=False)
class _Posterior:
    """The posterior density of the initial states, given the noise and the prior."""

    R: Array
    mean: Array
    precision: Array

    def cost(self, e: Array, x: Array) -> Array:
        """Return its negative logarithm for every window (w,), twice and up to a constant."""
        weight = np.linalg.inv(np.linalg.cholesky(self.R))
        with np.errstate(invalid="ignore", over="ignore"):
            squares = (np.einsum("ij,wtj->wti", weight, e) ** 2).sum(axis=(1, 2))
        return np.where(np.isfinite(squares), squares, np.inf) + (
            self.precision * (x - self.mean) ** 2
        ).sum(axis=1)


def _line_search(
    residual: Outputs,
    posterior: _Posterior,
    x: Array,
    e: Array,
    step: Array,
    finite: BoolArray,
) -> tuple[Array, Array, Array]:
    """Take the step of every window that is finite, halved until it does not cost more.

    Returns states, residuals, and what was taken.
    """
    before = posterior.cost(e, x)
    length = np.where(finite, 1.0, 0.0)
    worse = finite
    for _ in range(HALVINGS):
        moved = x + length[:, None] * step
        e = residual(moved)
        worse = finite & ~(
            posterior.cost(e, moved) <= before * (1 + 1e-9) + 1e-9
        )  # by more than rounding
        if not worse.any():
            return moved, e, length[:, None] * step
        length = np.where(worse, length / 2, length)
    length = np.where(worse, 0.0, length)
    moved = x + length[:, None] * step
    return moved, residual(moved), length[:, None] * step
