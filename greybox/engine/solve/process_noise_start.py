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

from itertools import product
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, evenly_spread, positive_or_one
from greybox.engine.compiled.shared_response import resolvents

# Points that are evaluated together. With 19, arrays of sixty responses no longer fit into memory
# that is used again, and each point takes twice the time.
TOGETHER = 8


class ProcessNoise:
    """The mean squared error with process noise, with gradient and Gauss-Newton Hessian."""

    def __init__(self, responses: Any, points: Array, step: int = 1) -> None:
        """Take `SharedResponses`; the noise is scaled by the states' derivatives at z (p, k).

        With a `step` of two every second frequency counts.
        """
        # System, frequencies, measured responses, weights and sizes of the derivatives.
        self._terms = []
        self._numbers = 0
        for system in responses.systems:
            # States follow from outputs that are measured at one frequency: where responses have
            # frequencies of their own, they are interpolated at as many as the longest has.
            longest = max(len(at) for _, (*_, at) in system.pairs)
            omega = system.omega[evenly_spread(len(system.omega), longest)][::step]
            # The axes are frequency, input and output. Weights are zero where nothing is measured.
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
    def __call__(self, z: Array, smoothing: Array, data: Array) -> tuple[Array, Array, Array]:
        """Return cost (k,), gradient (p, k) and Hessian (p * p, k) at z (p, k).

        The `data` (1, k) are the ratios of noise to errors.
        """
        p, k = z.shape
        cost, gradient, hessian = np.zeros(k), np.zeros((p, k)), np.zeros((p * p, k))
        for term, first in product(self._terms, range(0, k, TOGETHER)):
            at = slice(first, first + TOGETHER)
            rows, slopes = _derivatives(term, z[:, at], data[0, at])
            products = rows @ rows.mT / self._numbers
            cost[at] += products[:, -1, -1]
            gradient[:, at] += 2 * (slopes.mT @ products[:, :-1, -1:])[..., 0].T
            squares = slopes.mT @ products[:, :-1, :-1] @ slopes
            hessian[:, at] += 2 * squares.reshape(-1, p * p).T
        return cost, gradient, hessian


def _derivatives(term: tuple[Any, ...], z: Array, ratio: Array) -> tuple[Array, Array]:
    """Return whitened derivatives (k, rows, numbers) of the errors, and slopes (k, rows - 1, p).

    The rows are those of the entries of S, of the delays, and the errors themselves; the slopes are
    those of the entries and delays by z (p, k). The `ratio` (k,) is that of noise to errors.
    """
    system, omega, measured, weight, sizes = term
    S, delays, (i, j), *slopes = system.matrices(z)
    noise = ratio[:, None, None, None] * sizes
    lag = np.exp(-1j * omega[:, None] * delays[:, None])
    n, outputs = system.states, system.outputs
    inverse = resolvents(S[:, :n, :n], omega)
    states = lag[..., None] * (inverse @ S[:, None, :n, n:]).mT
    C, D = S[:, None, n:, :n], S[:, None, n:, n:].mT
    modeled = weight * (states @ C.mT + lag[..., None] * D)
    by_noise = weight[..., None] * (C @ inverse)[:, :, None]
    scaled = by_noise * noise[..., None, :]
    covariance = np.eye(outputs) + scaled @ scaled.conj().mT
    # A pole at a frequency: such trials are refused, since the sum of noise and errors is not
    # definite in double precision.
    refused = ~(np.trace(covariance, axis1=-2, axis2=-1).real < 1e14)
    covariance[refused], modeled[refused] = np.eye(outputs), np.nan

    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    both = np.stack([1j * omega[:, None, None] * modeled, weight * measured - modeled], -1)
    columns = [whitening @ by_noise, whitening * weight[..., None, :], whitening @ both]
    left = np.moveaxis(np.concatenate(columns, -1), -1, 1)
    *_, by_delay, errors = left.swapaxes(0, 1)
    driven = noise**2 * np.einsum("knwml,kwml->kwmn", left[:, :n].conj(), errors)
    x = states + (inverse[:, :, None] @ driven[..., None])[..., 0]

    # Entries of B and D, and delays, act on the responses to their own input only.
    own = np.eye(system.inputs)
    right = -np.moveaxis(np.concatenate([x, lag[..., None] * own], -1), -1, 1)[..., None]
    delayed = by_delay[:, None] * own[:, None, :, None]
    rows = np.concatenate([left[:, i] * right[:, j], delayed, errors[:, None]], 1)
    return rows.reshape(*rows.shape[:2], -1).view(float), np.hstack(slopes)
