"""Starts of state spaces by equation error: regressions of derivatives and outputs on signals.

Equations without free parameters (kinematics, measured states, an acceleration minus the equation
of its velocity) give the states from the measured responses. With the states, the other equations
are linear in most parameters: their squared errors, relative to their left sides, have few minima,
and noise in the regressors biases them little enough for a start. Equations with states that the
responses do not determine are left out; parameters on which the others have no information keep
their values.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.compiled.shared_response import SharedResponses, SharedSystem
from greybox.files.arrays import Array, ComplexArray

RANK = 1e-8  # singular values below this share of the largest one are zero


class EquationErrors:
    """The squared equation errors, with gradient and Gauss-Newton Hessian, for many points."""

    def __init__(self, responses: SharedResponses, points: Array) -> None:
        """Find the states from the responses, at the points z (p, k) if entries depend on z."""
        self._regressions = [_regression(s, responses.data, points) for s in responses.systems]

    def __call__(self, z: Array, smoothing: Array) -> tuple[Array, Array, Array]:
        """Return cost (k,), gradient (p, k) and Hessian (p * p, k) at z (p, k)."""
        p, k = z.shape
        cost, gradient, hessian = np.zeros(k), np.zeros((p, k)), np.zeros((p * p, k))
        for system, left, weight, states in self._regressions:
            n = system.states
            S, delays, slopes, delay_slopes = system.matrices(z)
            s = 1j * system.omega
            lag = np.exp(-s[:, None] * delays[:, None])[..., None]
            error = left - states @ S[:, None, :, :n].swapaxes(-1, -2)
            error -= lag * S[:, None, :, n:].swapaxes(-1, -2)
            jacobian = np.zeros((*error.shape, p), complex)
            for e in np.flatnonzero(np.any(slopes != 0, axis=(0, 2))):
                i, j = system.rows[e]
                if j < n:
                    jacobian[:, :, :, i] -= states[None, :, :, j, None] * slopes[:, None, None, e]
                else:
                    jacobian[:, :, j - n, i] -= lag[:, :, j - n] * slopes[:, None, e]
            by_delay = s[:, None, None] * lag * S[:, None, :, n:].swapaxes(-1, -2)
            jacobian += by_delay[..., None] * delay_slopes[:, None, :, None]
            for c in range(k):
                rows = (weight[..., None] * jacobian[c]).reshape(-1, p)
                errors = (weight * error[c]).ravel()
                cost[c] += np.vdot(errors, errors).real
                gradient[:, c] += 2 * (rows.conj().T @ errors).real
                hessian[:, c] += 2 * (rows.conj().T @ rows).real.ravel()
        return cost, gradient, hessian


def _regression(system: SharedSystem, data: Sequence[ComplexArray], z: Array) -> Any:
    """Find states by the combinations of equations that contain no parameter.

    Returns the system, the left sides of its equations, their weights (both (w, m, n + l)), and the
    states (w, m, n).
    """
    n, m, outputs = system.states, system.inputs, system.outputs
    w = len(system.omega)
    # Entries that are linear in the parameters have the same slopes everywhere: a few points show.
    S, delays, slopes, _ = system.matrices(z[:, :3])
    moving = np.zeros((n + outputs, n + m, len(z) * len(S)))
    moving[system.rows[:, 0], system.rows[:, 1]] = np.moveaxis(slopes, 1, 0).reshape(
        len(system.rows), -1
    )
    # Projected onto their left null space, [s x; y] = S [x; u] has constant coefficients.
    slope = np.linalg.qr(moving.reshape(n + outputs, -1).T)[1].T
    free = np.eye(n + outputs) - slope @ np.linalg.pinv(slope, RANK)
    known = free @ S[0]
    depends = np.zeros((n + outputs, n + m), bool)
    depends[tuple(system.rows.T)] = True

    y = np.full((w, m, outputs), np.nan, complex)
    for part, output, input, at in system.pairs:
        y[at, input, output] = data[part]
    left = np.zeros((w, m, n + outputs), complex)
    weight, states = np.zeros((w, m, n + outputs)), np.zeros((w, m, n), complex)
    s = 1j * system.omega
    for input in range(m):
        for k in range(w):
            missing = np.isnan(y[k, input])
            columns = np.hstack([s[k] * free[:, :n] - known[:, :n], free[:, n:][:, missing]])
            control = known[:, n + input] * np.exp(-s[k] * delays[0, input])
            right = control - free[:, n:][:, ~missing] @ y[k, input, ~missing]
            inverse = np.linalg.pinv(columns, RANK)
            solution = inverse @ right
            # The projection onto the null space.
            unknown = np.abs(np.diag(np.eye(len(inverse)) - inverse @ columns)) > RANK
            states[k, input] = np.where(unknown[:n], 0, solution[:n])
            left[k, input, :n] = s[k] * states[k, input]
            left[k, input, n:] = np.where(missing, 0, y[k, input])
            lacks = np.concatenate([unknown[:n], missing])
            weight[k, input] = ~lacks & ~np.any(depends[:, :n] & unknown[:n], axis=1)
    size = np.abs(left)
    # A left side that vanishes somewhere has no relative error there.
    floor = 0.05 * np.sqrt(np.mean(size**2, axis=0))
    weight = np.divide(weight, size + floor, out=np.zeros_like(size), where=size + floor > 0)
    return system, left, weight, states
