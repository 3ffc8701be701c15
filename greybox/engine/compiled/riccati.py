"""The steady Kalman filter of a record with estimated process noise: its gain and derivatives.

The model is x[k+1] = F x[k] + w, y = C x + v, with w of the covariance Q that noise on the
derivatives of some states makes over a sample, and v of that of the sensors, V. The prediction
errors of its steady filter have the covariance S = C P Cᵀ + V, and the gain is K = P Cᵀ S⁻¹, where
P = F (P - K C P) Fᵀ + Q: Riccati's equation. Source: Maine and Iliff (1981), SIAM Journal on
Applied Mathematics 41(3); Simon (2006), Optimal State Estimation.
"""

from typing import Any

import casadi as ca
import numpy as np

from greybox.data.files.arrays import Array, BoolArray, IntArray, all_finite, diagonal
from greybox.data.files.frozen_values import frozen
from greybox.data.files.named_values import places_of
from greybox.engine.compiled.record_model import RecordModel
from greybox.engine.compiled.sample_step import SampleStep
from greybox.modeling.symbolic_reading import dense_jacobian


@np.errstate(all="ignore")
def steady_covariance(F: Any, C: Any, process: Any) -> Any:
    """Return the covariance P (..., n, n) of states predicted by steady filters; NaN without one.

    `process` (..., n, n) is the covariance of the process noise; the sensors have unit variances.
    Leading axes are filters. By the structure-preserving doubling algorithm, which needs as many
    iterations as the filter takes doublings of the sample to settle. Source: Chu, Fan, Lin, Wang
    (2004), International Journal of Control 77(8).
    """
    # States in units of their noise, because intensities may be decades apart.
    variance: Any = np.linalg.diagonal(process)
    variance = variance.real
    largest = variance.max(axis=-1, keepdims=True, initial=0.0)
    size = np.sqrt(np.where(variance > 0, variance, largest))
    row, column = size[..., None, :], size[..., :, None]
    A = F.mT * column / row
    scaled = C * row
    G = scaled.mT @ scaled
    H = process / row / column
    eye = np.eye(F.shape[-1])

    for _ in range(60):  # doublings of the time: 2^60 samples
        if not all_finite(A, H):
            break
        try:
            step = np.linalg.solve(eye + G @ H, A)
            gramian = np.linalg.solve(eye + G @ H, G)
        except np.linalg.LinAlgError:
            break
        change = A.mT @ H @ step
        G = G + A @ gramian @ A.mT
        A = A @ step
        H = H + (change + change.mT) / 2
        if np.abs(change).max(initial=0.0) <= 1e-12 * np.abs(H).max(initial=0.0):
            return H * row * column

    return np.full(F.shape, np.nan)


@np.errstate(invalid="ignore")
def steady_state_gain(F: Array, C: Array, process: Array) -> Array:
    """Return the gain (n, k) of the steady filter for process noise of variances (n,).

    NaN if there is no steady filter.

    The sensors have unit variances.
    """
    P = steady_covariance(F, C, np.diag(process))
    return np.linalg.solve(C @ P @ C.T + np.eye(len(C)), C @ P).T


@frozen
class SteadyFilter:
    """A steady Kalman filter at some parameters.

    Attributes
    ----------
    gain, gain_slope : (n, k) and (n, k, q) arrays
        Gain and its derivatives with respect to the q estimated parameters.
    covariance, covariance_slope : (k, k) and (k, k, q) arrays
        Covariance of the prediction errors, and its derivatives.
    """

    gain: Array
    gain_slope: Array
    covariance: Array
    covariance_slope: Array


@frozen
class NoiseModel:
    """The linear model of a record over a sample, and the places of its noise among the parameters.

    Attributes
    ----------
    linear : casadi.Function
        (q) -> F, F over half a sample, C, and the derivatives of each, column by column, by the
        estimated parameters.
    step : float
        Time from one sample to the next, s.
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

    @np.errstate(all="ignore")
    def at(self, q: Array) -> SteadyFilter:
        """Return the filter at the parameters q; NaN where it does not exist.

        The derivatives are computed by complex steps: a change of 1e-100 i of a parameter changes
        the real parts by less than rounding, and the imaginary parts by the derivative, to all
        digits.
        """
        tiny = 1e-100
        steps = 1j * tiny * np.eye(len(q))[self.columns]
        moved = q + np.vstack([np.zeros(len(q)), steps])
        values = [matrix.full() for matrix in self.linear.call([ca.DM(q)])]
        matrices = []
        for M, slope in zip(values[:3], values[3:], strict=True):
            # CasADi stacks matrices column by column; the first filter is at q itself.
            slopes = slope.T.reshape(-1, M.shape[1], M.shape[0]).mT
            matrices.append(M + 1j * tiny * np.concatenate([np.zeros((1, *M.shape)), slopes]))
        F, half, C = matrices
        K, S = self._filters(F, half, C, moved)
        gain_slope = np.moveaxis(K[1:].imag / tiny, 0, -1)
        covariance_slope = np.moveaxis(S[1:].imag / tiny, 0, -1)
        return SteadyFilter(K[0].real, gain_slope, S[0].real, covariance_slope)

    def _filters(self, F: Any, half: Any, C: Any, q: Any) -> tuple[Any, Any]:
        """Return the gains (m, n, k) and prediction error covariances (m, k, k) of m filters."""
        n, k = F.shape[-1], C.shape[-2]
        K = np.zeros((len(q), n, k), dtype=complex)
        V = diagonal(q[:, self.deviations] ** 2)
        # Without process noise the predictions need no correction.
        if not np.any(q[0, self.intensities].real > 0):
            return K, V
        W = np.zeros((len(q), n, n), dtype=complex)
        W[:, self.driven, self.driven] = q[:, self.intensities] ** 2
        # The integral over a sample by Simpson's rule: exact for two integrators in a row.
        Q = self.step / 6 * (W + 4 * half @ W @ half.mT + F @ W @ F.mT)

        # Noise does not reach the other states, which may be integrators without a steady filter.
        r = np.flatnonzero(reached(F[0].real, self.driven))
        F, C, Q = F[:, r[:, None], r], C[:, :, r], Q[:, r[:, None], r]
        deviation = np.sqrt(np.linalg.diagonal(V))[:, :, None]
        P = steady_covariance(F, C / deviation, Q)
        S = C @ P @ C.mT + V
        if not all_finite(S):
            K[:, r] = np.nan
            return K, V

        K[:, r] = np.linalg.solve(S, C @ P).mT
        return K, S


def noise_model(
    model: RecordModel, sample: SampleStep, step: float, reference: tuple[Array, Array]
) -> NoiseModel:
    """Compile the linearization of a `sample` of `step` s about a `reference` (state, data).

    Gains among the parameters q of the model are zero here.
    """
    names, outputs = model.parameters, model.outputs
    x, q, d = sample.symbols()
    end, _, y = sample.function(x, q, d)
    by_state = ca.Function("by_state", [x, q, d], [dense_jacobian(value, x) for value in (end, y)])
    gains = [f"K_{state}_{output}" for state in sample.system.states for output in outputs]
    is_gain = np.isin(names, gains)
    without_gain = ca.vertcat(*[0 if off else q[k] for k, off in enumerate(is_gain)])
    point, data = reference
    F, C = by_state(point, without_gain, data)
    half, _ = by_state(point, without_gain, np.append(data[:-1], step / 2))

    # The filter itself gives the slopes of its gains.
    columns = np.isin(np.arange(len(names)), model.active) & ~is_gain
    places = np.flatnonzero(columns).tolist()
    slopes = [ca.densify(ca.jacobian(ca.vec(M), q)[:, places]) for M in (F, half, C)]
    return NoiseModel(
        linear=ca.Function("linear", [q], [F, half, C, *slopes], {"cse": True}),
        step=step,
        driven=places_of(model.driven, sample.system.states),
        intensities=places_of((f"w_{name}" for name in model.driven), names),
        deviations=places_of((f"v_{name}" for name in outputs), names),
        columns=columns,
    )


def reached(F: Array, states: IntArray) -> BoolArray:
    """Return which states (n,) a transition F (n, n) makes depend on the given ones."""
    dependent = np.zeros(len(F), dtype=bool)
    dependent[states] = True
    for _ in range(len(F)):
        dependent |= (F[:, dependent] != 0).any(axis=1)
    return dependent
