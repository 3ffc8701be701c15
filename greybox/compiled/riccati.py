"""The steady Kalman filter of a record with estimated process noise: its gain and the derivatives of that.

The model is x[k+1] = F x[k] + w, y = C x + v, with w of the covariance Q that noise on the
derivatives of some states makes over a sample, and v of that of the sensors, V. The prediction
errors of its steady filter have the covariance S = C P Cᵀ + V, and the gain is K = P Cᵀ S⁻¹, where
P = F (P - K C P) Fᵀ + Q: Riccati's equation. Its derivatives follow from the equation itself: dP =
A dP Aᵀ + ..., A = F (I - K C), which is linear. Source: Maine and Iliff (1981), SIAM Journal on
Applied Mathematics 41(3); Simon (2006), Optimal State Estimation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from greybox.compiled.sample_step import SampleStep
from greybox.files.arrays import Array, BoolArray, IntArray


@np.errstate(over="ignore", invalid="ignore")
def steady_covariance(F: Array, C: Array, process: Array) -> Array:
    """Return the covariance P (n, n) of the predicted states of a steady Kalman filter; NaN without one.

    `process` (n, n) is the covariance of the process noise; the sensors have unit variances. By the
    structure-preserving doubling algorithm, which needs as many iterations as the filter takes
    doublings of the sample to settle. Source: Chu, Fan, Lin, Wang (2004), International Journal of
    Control 77(8).
    """
    n = len(F)
    variance = np.diag(process)
    size = np.sqrt(np.where(variance > 0, variance, variance.max(initial=0.0)))
    A = F.T * size[:, None] / size
    scaled = C * size
    G = scaled.T @ scaled
    H = process / size / size[:, None]
    eye = np.eye(n)
    for _ in range(60):  # doublings of the time: 2^60 samples
        if not np.all(np.isfinite(A)) or not np.all(np.isfinite(H)):
            break
        try:
            solution = np.linalg.solve(eye + G @ H, np.hstack([A, G]))
        except np.linalg.LinAlgError:
            break
        step, gramian = solution[:, :n], solution[:, n:]
        change = A.T @ H @ step
        G = G + A @ gramian @ A.T
        A = A @ step
        H = H + (change + change.T) / 2
        if np.abs(change).max(initial=0.0) <= 1e-12 * np.abs(H).max(initial=0.0):
            return H * size * size[:, None]
    return np.full((n, n), np.nan)


def steady_state_gain(F: Array, C: Array, process: Array) -> Array:
    """Return the gain (n, k) of the steady Kalman filter for process noise of variances (n,); NaN without one.

    The sensors have unit variances.
    """
    P = steady_covariance(F, C, np.diag(process))
    if not np.all(np.isfinite(P)):
        return np.full((len(F), len(C)), np.nan)
    return np.linalg.solve(C @ P @ C.T + np.eye(len(C)), C @ P).T.astype(float)


@dataclass(frozen=True, eq=False)
class SteadyFilter:
    """A steady Kalman filter at some parameters.

    Attributes
    ----------
    gain, gain_slope : (n, k) and (n, k, q) arrays
        Gain and its derivatives by the q estimated parameters.
    covariance, covariance_slope : (k, k) and (k, k, q) arrays
        Covariance of the prediction errors, and its derivatives.
    """

    gain: Array
    gain_slope: Array
    covariance: Array
    covariance_slope: Array


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The linear model of a record over a sample, and the places of its noise among the parameters.

    Attributes
    ----------
    linear : casadi.Function
        (q) -> F, F over half a sample, C, and the derivatives of each, column by column, by the
        estimated parameters.
    step : float
        Of a sample, s.
    driven : (d,) array
        States with process noise.
    intensities, deviations : (d,) and (k,) arrays
        Places in q of the intensities of the process noise, in units of the state per √s, and of
        the standard deviations of the sensors.
    columns : (places,) bool array
        Which places of q are estimated.
    """

    linear: ca.Function
    step: float
    driven: IntArray
    intensities: IntArray
    deviations: IntArray
    columns: BoolArray

    @np.errstate(over="ignore", invalid="ignore")
    def at(self, q: Array) -> SteadyFilter:
        """Return the filter at the parameters q; NaN where there is none."""
        (F, dF), (half, dhalf), (C, dC) = self._linearization(q)
        n, k, free = len(F), len(C), dF.shape[0]
        V, dV = _diagonal(q, np.arange(k), self.deviations, self.columns, k)
        K, dK = np.zeros((n, k)), np.zeros((free, n, k))
        S, dS = V, dV
        if np.any(q[self.intensities] > 0):
            W, dW = _diagonal(q, self.driven, self.intensities, self.columns, n)
            # The integral over a sample by Simpson's rule: exact for two integrators in a row.
            Q = self.step / 6 * (W + 4 * half @ W @ half.T + F @ W @ F.T)
            dQ = (
                self.step
                / 6
                * (dW + 4 * _congruence(half, dhalf, W, dW) + _congruence(F, dF, W, dW))
            )
            # Noise does not reach the other states, which may be integrators without a steady filter.
            r = np.flatnonzero(reached(F, self.driven))
            block = np.ix_(r, r)
            K[r], dK[:, r], S, dS = _filter(
                (F[block], dF[:, r][:, :, r]),
                (C[:, r], dC[:, :, r]),
                (Q[block], dQ[:, r][:, :, r]),
                (V, dV),
            )
        return SteadyFilter(K, np.moveaxis(dK, 0, -1), S, np.moveaxis(dS, 0, -1))

    def _linearization(self, q: Array) -> list[tuple[Array, Array]]:
        """Return matrices with their derivatives (free, rows, columns)."""
        values = [np.asarray(value) for value in self.linear.call([ca.DM(q)])]
        return [
            (M.astype(float), slope.T.reshape(-1, M.shape[1], M.shape[0]).transpose(0, 2, 1))
            for M, slope in zip(values[:3], values[3:], strict=True)
        ]


def noise_model(
    sample: SampleStep,
    step: float,
    reference: tuple[Array, Array],
    names: Sequence[str],
    active: IntArray,
    driven: Sequence[str],
    outputs: Sequence[str],
) -> NoiseModel:
    """Compile the linearization of a `sample` of `step` s about a `reference`, its state and its data.

    `names` are those of the parameters q, where the `active` ones are estimated; gains among them are
    zero here.
    """
    x, q, d = sample.symbols()
    end, _, y = sample.function(x, q, d)
    by_state = ca.Function(
        "by_state", [x, q, d], [ca.densify(ca.jacobian(value, x)) for value in (end, y)]
    )
    gains = [f"K_{state}_{output}" for state in sample.system.states for output in outputs]
    is_gain = np.isin(names, gains)
    without_gain = ca.vertcat(*[0 if off else q[k] for k, off in enumerate(is_gain)])
    point, data = reference
    F, C = by_state(point, without_gain, data)
    half, _ = by_state(point, without_gain, np.append(data[:-1], step / 2))

    columns = np.isin(np.arange(len(names)), active) & ~is_gain
    places = np.flatnonzero(columns).tolist()
    slopes = [ca.densify(ca.jacobian(ca.vec(M), q)[:, places]) for M in (F, half, C)]
    return NoiseModel(
        linear=ca.Function("linear", [q], [F, half, C, *slopes], {"cse": True}),
        step=step,
        driven=np.array([sample.system.states.index(name) for name in driven], dtype=int),
        intensities=np.array([names.index(f"w_{name}") for name in driven], dtype=int),
        deviations=np.array([names.index(f"v_{name}") for name in outputs], dtype=int),
        columns=columns,
    )


def reached(F: Array, states: IntArray) -> BoolArray:
    """Return which states (n,) depend on the given ones, directly or through others, by a transition F (n, n)."""
    dependent = np.zeros(len(F), dtype=bool)
    dependent[states] = True
    for _ in range(len(F)):
        dependent |= (F[:, dependent] != 0).any(axis=1)
    return dependent


def _filter(
    transition: tuple[Array, Array],
    output: tuple[Array, Array],
    process: tuple[Array, Array],
    noise: tuple[Array, Array],
) -> tuple[Array, Array, Array, Array]:
    """Return gain and covariance of the prediction errors, each followed by its derivatives (free, rows, columns)."""
    (F, dF), (C, dC), (Q, dQ), (V, dV) = transition, output, process, noise
    n = len(F)
    P = steady_covariance(F, C / np.sqrt(np.diag(V))[:, None], Q)
    S = C @ P @ C.T + V
    if not np.all(np.isfinite(S)):
        return np.full((n, len(C)), np.nan), np.full((len(dF), n, len(C)), np.nan), V, dV
    K = np.linalg.solve(S, C @ P).T.astype(float)
    error_share = np.eye(n) - K @ C
    updated = P - K @ C @ P

    # Derivatives of the update in Joseph's form, (I - K C) P (I - K C)ᵀ + K V Kᵀ, which does not
    # change with K to first order.
    mixed = K @ dC @ P @ error_share.T
    forced = K @ dV @ K.T - mixed - mixed.transpose(0, 2, 1)
    forced = F @ forced @ F.T + dQ
    mixed = dF @ updated @ F.T
    forced = forced + mixed + mixed.transpose(0, 2, 1)
    A = F @ error_share
    try:
        dP = np.linalg.solve(np.eye(n * n) - np.kron(A, A), forced.reshape(len(forced), n * n).T)
    except np.linalg.LinAlgError:
        dP = np.full((n * n, len(forced)), np.nan)
    dP = dP.T.reshape(-1, n, n)

    mixed = dC @ P @ C.T
    dS = C @ dP @ C.T + mixed + mixed.transpose(0, 2, 1) + dV
    dPC = dP @ C.T + P @ dC.transpose(0, 2, 1) - K @ dS
    dK = np.linalg.solve(S, dPC.transpose(0, 2, 1)).transpose(0, 2, 1).astype(float)
    return K, dK, S, dS


def _congruence(F: Array, dF: Array, W: Array, dW: Array) -> Array:
    """Return the derivatives of F W Fᵀ."""
    mixed = dF @ W @ F.T
    return mixed + mixed.transpose(0, 2, 1) + F @ dW @ F.T


def _diagonal(
    q: Array,
    rows: IntArray,
    places: IntArray,
    columns: BoolArray,
    size: int,
) -> tuple[Array, Array]:
    """Return the diagonal matrix (size, size) of squares of q at `places`, and its derivatives (free, size, size)."""
    matrix = np.zeros((size, size))
    matrix[rows, rows] = q[places] ** 2
    number = np.cumsum(columns) - 1
    slope = np.zeros((int(columns.sum()), size, size))
    for row, place in zip(rows, places, strict=True):
        if columns[place]:
            slope[number[place], row, row] = 2 * q[place]
    return matrix, slope
