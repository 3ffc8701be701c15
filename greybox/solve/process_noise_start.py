"""Starts of many responses by output error with process noise, which has few minima.

Noise w in the state equations, jωx = A x + B u + w, adds Y w to the responses of a model, where
Y = C (jωI - A)⁻¹. With a covariance Q of w and R of the measured responses, the squared errors are

    rᴴ (R + Y Q Yᴴ)⁻¹ r,

the least sum of squared errors of all equations over the states x. Without noise they are the
output error, whose minima are many in wide boxes. With much noise the states follow from the
measured responses where these show them, and the errors are those of the state equations,
which are linear in most parameters. A start passes from much noise to little, first behind a strong
barrier at its bounds, so that most starts meet.

Derivatives are those at the best states (the envelope theorem): with S = [[A, B], [C, D]] and a
whitening W of R + Y Q Yᴴ they are those of -W [Y, I] dS [x; u].
"""

from typing import Any

import numpy as np

from greybox.compiled.shared_response import resolvents
from greybox.files.arrays import Array, ArrayTriple, ComplexArray, evenly_spread, positive_or_one


class ProcessNoise:
    """The mean squared error with process noise, with gradient and Gauss-Newton Hessian."""

    def __init__(self, responses: Any, points: Array) -> None:
        """Take `SharedResponses`; the noise is scaled by the states' derivatives at z (p, k)."""
        # System, frequencies, measured responses, weights and sizes of the derivatives.
        self._terms = []
        self._numbers = 0
        for system in responses.systems:
            # States follow from outputs that are measured at one frequency: where responses have
            # frequencies of their own, they are interpolated at as many as the longest has.
            longest = max(len(at) for _, (*_, at) in system.pairs)
            omega = system.omega[evenly_spread(len(system.omega), longest)]
            # By frequency, input and output; weights are zero where nothing is measured.
            measured = np.zeros((len(omega), system.inputs, system.outputs), complex)
            for part, (output, input, at) in system.pairs:
                order = np.argsort(at)
                own = system.omega[at[order]]
                inside = (own[0] <= omega) & (omega <= own[-1])
                response = np.interp(omega[inside], own, responses.data[part][order])
                measured[inside, input[0], output[0]] = response
            size = np.abs(measured)
            weight = (size > 0) / positive_or_one(size)
            self._numbers += 2 * np.count_nonzero(weight)

            # Typical derivatives of the states.
            n, (S, *_) = system.states, system.matrices(points)
            with np.errstate(all="ignore"):
                states = resolvents(S[:, :n, :n], omega) @ S[:, None, :n, n:]
                sizes = np.median(np.abs(states), axis=0) * omega[:, None, None]
            sizes = np.nan_to_num(sizes, posinf=0.0).mT
            self._terms.append((system, omega, measured, weight, sizes))

    @np.errstate(all="ignore")
    def __call__(self, z: Array, smoothing: Array, data: Array) -> ArrayTriple:
        """Return cost (k,), gradient (p, k) and Hessian (p * p, k) at z (p, k).

        The `data` (1, k) are the ratios of noise to errors.
        """
        p, k = z.shape
        cost, gradient, hessian = np.zeros(k), np.zeros((p, k)), np.zeros((p * p, k))
        for term in self._terms:
            system, omega, *_, sizes = term
            noise = data[0, :, None, None, None] * sizes
            S, delays, (i, j), *slopes = system.matrices(z)
            s = 1j * omega[:, None]
            lag = np.exp(-s * delays[:, None])
            errors, left, x = _whitened(term, S, lag, noise)
            right = np.concatenate([x, lag[..., None] * np.eye(system.inputs)], axis=-1)

            # Rows (entry, frequency, input and output); those of the delays follow the entries.
            left, right = (np.moveaxis(side, -1, 1) for side in (left, right))
            by_input = np.einsum("kiu,kiwvl->kuwvl", S[..., system.states :], left)
            by_delay = by_input * (s * right[:, system.states :])[..., None]
            slopes = np.hstack(slopes)
            rows = [left[:, i] * -right[:, j, ..., None], by_delay, errors[:, None]]
            rows = np.concatenate(rows, 1).reshape(k, len(i) + system.inputs + 1, -1).view(float)
            products = rows @ rows.mT
            cost += products[:, -1, -1]
            gradient += 2 * (slopes.mT @ products[:, :-1, -1:])[..., 0].T
            hessian += 2 * (slopes.mT @ products[:, :-1, :-1] @ slopes).reshape(k, -1).T
        return cost / self._numbers, gradient / self._numbers, hessian / self._numbers


def _whitened(
    term: tuple[Any, ...], S: Array, lag: ComplexArray, noise: Array
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return the whitened errors (k, w, m, l), W [Y, I] (k, w, m, l, n + l), and x (k, w, m, n)."""
    system, omega, measured, weight, _ = term
    n, outputs = system.states, system.outputs
    inverse = resolvents(S[:, :n, :n], omega)
    states = lag[..., None] * (inverse @ S[:, None, :n, n:]).mT
    C, D = S[:, None, n:, :n], S[:, None, n:, n:].mT
    errors = weight * (measured - states @ C.mT - lag[..., None] * D)
    by_noise = weight[..., None] * (C @ inverse)[:, :, None]
    scaled = by_noise * noise[..., None, :]
    # A pole at a frequency: such trials are refused, since the sum of noise and errors is not
    # definite in double precision.
    refused = ~(np.abs(scaled).max(axis=(-2, -1)) < 1e7)
    scaled[refused], errors[refused] = 0, np.nan

    root = np.linalg.cholesky(np.eye(outputs) + scaled @ scaled.conj().mT)
    whitening = np.linalg.inv(root)
    errors = (whitening @ errors[..., None])[..., 0]
    left = np.concatenate([whitening @ by_noise, whitening * weight[..., None, :]], axis=-1)
    driven = noise**2 * (left[..., :n].conj().mT @ errors[..., None])[..., 0]
    return errors, left, states + (inverse[:, :, None] @ driven[..., None])[..., 0]
