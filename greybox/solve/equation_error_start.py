"""Starts of state spaces by equation error: regressions of derivatives and outputs on signals.

Equations without free parameters (kinematics, measured states, an acceleration minus the equation
of its velocity) give the states from the measured responses. With the states, the other equations
are linear in most parameters: their squared errors, relative to their left sides, have few minima,
and noise in the regressors biases them little enough for a start. States that the responses do not
determine, such as those of a rotor, follow from the others by their own equations.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.compiled.shared_response import SharedResponses, SharedSystem, resolvents
from greybox.files.arrays import Array, BoolArray, ComplexArray

RANK = 1e-8  # singular values below this share of the largest one are zero

# Relative errors of a state over those of the responses. Beyond, differences of responses determine
# it, which are noise.
AMPLIFIED = 5.0


class EquationErrors:
    """The squared equation errors, with gradient and Gauss-Newton Hessian, for many points."""

    def __init__(self, responses: SharedResponses, points: Array) -> None:
        """Find the states from the responses, at the points z (p, k) if entries depend on z."""
        self._regressions = [
            _regression(system, responses.data, points)
            for system in responses.systems
            if isinstance(system, SharedSystem)
        ]

    def __call__(self, z: Array, smoothing: Array, data: Array) -> tuple[Array, Array, Array]:
        """Return cost (k,), gradient (p, k) and Hessian (p * p, k) at z (p, k)."""
        p, k = z.shape
        cost, gradient, hessian = np.zeros(k), np.zeros((p, k)), np.zeros((p * p, k))
        for system, left, weight, known, hidden in self._regressions:
            n = system.states
            S, delays, slopes, delay_slopes = system.matrices(z)
            s = 1j * system.omega
            lag = np.exp(-s[:, None] * delays[:, None])[..., None]
            states, inverses = _with_hidden(system, S, lag, known, hidden)
            error = left - states @ S[:, None, :, :n].swapaxes(-1, -2)
            error -= lag * S[:, None, :, n:].swapaxes(-1, -2)
            jacobian = np.zeros((*error.shape, p), complex)
            for e in np.flatnonzero(np.any(slopes != 0, axis=(0, 2))):
                i, j = system.rows[e]
                if j < n:
                    jacobian[:, :, :, i] -= states[..., j, None] * slopes[:, None, None, e]
                else:
                    jacobian[:, :, j - n, i] -= lag[:, :, j - n] * slopes[:, None, e]
            by_delay = s[:, None, None] * lag * S[:, None, :, n:].swapaxes(-1, -2)
            jacobian += by_delay[..., None] * delay_slopes[:, None, :, None]
            # The hidden states move with the parameters, too.
            for input, inverse in inverses.items():
                at = hidden[input]
                moves = S[:, None, :, :n][..., at] @ inverse @ jacobian[:, :, input, :n][:, :, at]
                jacobian[:, :, input] += moves
            for c in range(k):
                weighted = (weight[..., None] * jacobian[c]).reshape(-1, p)
                rows = np.concatenate([weighted.real, weighted.imag])
                errors = (weight * error[c]).ravel()
                cost[c] += np.vdot(errors, errors).real
                gradient[:, c] += 2 * np.concatenate([errors.real, errors.imag]) @ rows
                hessian[:, c] += 2 * (rows.T @ rows).ravel()
        return cost, gradient, hessian


def _with_hidden(
    system: SharedSystem, S: Array, lag: ComplexArray, known: ComplexArray, hidden: BoolArray
) -> tuple[ComplexArray, dict[int, ComplexArray]]:
    """Return all states (k, w, m, n), and by input (jωI - A)⁻¹ of the hidden ones."""
    n, inverses = system.states, {}
    states = np.broadcast_to(known, (len(S), *known.shape)).copy()
    for input in np.flatnonzero(hidden.any(axis=1)):
        at = hidden[input]
        rows = S[:, :n][:, at]
        inverses[input] = resolvents(rows[..., :n][..., at], system.omega)
        driven = states[:, :, input] @ rows[..., :n].swapaxes(-1, -2)
        driven += lag[:, :, input] * rows[:, None, :, n + input]
        states[:, :, input, at] = (inverses[input] @ driven[..., None])[..., 0]
    return states, inverses


def _regression(system: SharedSystem, data: Sequence[ComplexArray], z: Array) -> Any:
    """Find states by the combinations of equations that contain no parameter.

    Returns the system, the left sides of its equations, their weights (both (w, m, n + l)), the
    states (w, m, n), zero if hidden, and by input which ones are hidden (m, n).
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
    y = np.full((w, m, outputs), np.nan, complex)
    for part, output, input, at in system.pairs:
        y[at, input, output] = data[part]
    amplified, states = np.zeros((w, m, n)), np.zeros((w, m, n), complex)
    s = 1j * system.omega
    for input in range(m):
        for k in range(w):
            missing = np.isnan(y[k, input])
            columns = np.hstack([s[k] * free[:, :n] - known[:, :n], free[:, n:][:, missing]])
            control = known[:, n + input] * np.exp(-s[k] * delays[0, input])
            right = control - free[:, n:][:, ~missing] @ y[k, input, ~missing]
            inverse = np.linalg.pinv(columns, RANK)
            solution = inverse @ right
            states[k, input] = solution[:n]
            # The projection onto the null space, and the errors of states with equal relative ones.
            solved = np.abs(np.diag(np.eye(len(inverse)) - inverse @ columns))[:n] <= RANK
            spread = np.linalg.norm(inverse @ (free[:, n:] * y[k, input])[:, ~missing], axis=1)[:n]
            amplified[k, input] = np.where(solved, spread, np.inf)
    # A state that one input hardly moves, and others do, is noise in few equations only.
    limit = AMPLIFIED * np.median(np.abs(states), axis=0)
    is_noise = np.all(np.median(amplified, axis=0) > limit, axis=0)
    hidden = np.isinf(amplified).any(axis=0) | is_noise
    states[:, hidden] = 0
    left = np.concatenate([s[:, None, None] * states, np.nan_to_num(y)], axis=-1)
    weight = np.concatenate([np.broadcast_to(~hidden, states.shape), ~np.isnan(y)], axis=-1)
    size = np.abs(left)
    # A left side that vanishes somewhere has no relative error there.
    floor = 0.05 * np.sqrt(np.mean(size**2, axis=0))
    weight = np.divide(weight, size + floor, out=np.zeros_like(size), where=size + floor > 0)
    return system, left, weight, states, hidden
