"""Linear least squares over several equations, with bounds, and its covariance.

Colored residuals: Cov = (XᵀX)⁻¹ Xᵀ R X (XᵀX)⁻¹ with the autocovariance R of the residuals (Morelli
and Klein, Aircraft System Identification, 2nd ed., chapter 5). R is the sample autocovariance under
a Parzen window (Parzen, Ann. Math. Statist. 32 (1961) 951-989), which keeps it positive
semidefinite.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array
from greybox.statistics.residual_autocorrelation import autocovariance

# Singular value of the matrix with unit columns below which a combination is not determined: the
# root of the rounding, at which the normal equations lose it.
UNDETERMINED = 1e-7
# Share in such a combination from which a column belongs to it: above rounding over UNDETERMINED.
PART = 1e-3
ROUNDING = 1e-24  # of the power of a target: residuals smaller than this are rounding


@dataclass(frozen=True, eq=False)
class Block:
    """One equation over one stretch: ``target = base + slopes @ unknowns``, (n,), (n,), (n, k)."""

    equation: int
    target: Array
    base: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class Autocovariance:
    """Autocovariance of residuals at the `lags` 0 ... m - 1, and their independent number."""

    lags: Array
    independent: float


def undetermined(blocks: Sequence[Block]) -> list[tuple[int, ...]]:
    """Return the columns without effect, and the sets with a combination without effect."""
    triangle = _triangle(blocks, np.ones(1 + max(b.equation for b in blocks)))[:, 1:]
    sizes = np.linalg.norm(triangle, axis=0)
    zero = [(int(k),) for k in np.flatnonzero(sizes == 0)]
    nonzero = np.flatnonzero(sizes)
    if not nonzero.size:
        return zero
    _, values, directions = np.linalg.svd(triangle[:, nonzero] / sizes[nonzero], full_matrices=True)
    values = np.pad(values, (0, nonzero.size - values.size))
    open_directions = directions[values < UNDETERMINED * values[0]]
    share = np.sqrt(np.sum(open_directions**2, axis=0))
    combined = tuple(int(k) for k in nonzero[share > PART])
    return [*zero, combined] if combined else zero


def solve(blocks: Sequence[Block], weights: Array, low: Array, high: Array) -> Array:
    """Return the unknowns (k,) of least weighted squares within the bounds."""
    from scipy.optimize import lsq_linear  # noqa: PLC0415  (imports slowly)

    triangle = _triangle(blocks, weights)
    right = triangle[:, 0]
    matrix = triangle[:, 1:]
    if not matrix.shape[1]:
        return np.zeros(0)
    sizes = np.linalg.norm(matrix, axis=0)
    sizes[sizes == 0] = 1.0
    free = np.linalg.lstsq(matrix / sizes, right, rcond=None)[0] / sizes
    if np.all((free >= low) & (free <= high)):
        return free
    bounded = lsq_linear(
        matrix / sizes, right, (low * sizes, high * sizes), method="bvls", max_iter=1000
    )
    at_low, at_high = bounded.active_mask < 0, bounded.active_mask > 0
    return np.where(at_low, low, np.where(at_high, high, np.clip(bounded.x / sizes, low, high)))


def residuals(blocks: Sequence[Block], unknowns: Array) -> list[Array]:
    """Return target minus model of every block."""
    return [block.target - block.base - block.slopes @ unknowns for block in blocks]


def spread(blocks: Sequence[Block], errors: Sequence[Array]) -> Array:
    """Return the rms error of every equation, at least the rounding of its target.

    One of an equation whose target is zero and whose errors are: any other would do.
    """
    count = 1 + max(block.equation for block in blocks)
    squares = np.zeros(count)
    power = np.zeros(count)
    size = np.zeros(count)
    for block, error in zip(blocks, errors, strict=True):
        squares[block.equation] += error @ error
        power[block.equation] += block.target @ block.target
        size[block.equation] += error.size
    total = squares + ROUNDING * power
    return np.sqrt(np.where(total > 0, total / np.maximum(size, 1), 1.0))


def autocovariances(blocks: Sequence[Block], errors: Sequence[Array]) -> list[Autocovariance]:
    """Return the autocovariance of the residuals of every equation, over its stretches."""
    count = 1 + max(block.equation for block in blocks)
    return [
        _autocovariance([e for b, e in zip(blocks, errors, strict=True) if b.equation == k])
        for k in range(count)
    ]


def covariance(blocks: Sequence[Block], weights: Array, colored: Sequence[Autocovariance]) -> Array:
    """Return the covariance (k, k) for colored residuals of independent equations."""
    from scipy.signal import fftconvolve  # noqa: PLC0415  (takes a third of a second to import)

    size = blocks[0].slopes.shape[1]
    normal = np.zeros((size, size))
    middle = np.zeros((size, size))
    for block in blocks:
        weight = weights[block.equation] ** 2
        r = colored[block.equation].lags
        kernel = np.concatenate([r[:0:-1], r])[:, None]
        convolved = fftconvolve(block.slopes, kernel, axes=0)[
            len(r) - 1 : len(r) - 1 + len(block.slopes)
        ]
        normal += weight * block.slopes.T @ block.slopes
        middle += weight**2 * block.slopes.T @ convolved

    sizes = np.sqrt(np.diag(normal))
    scale = np.divide(1, sizes, out=np.zeros(size), where=sizes > 0)
    inverse = np.linalg.pinv(
        normal * np.outer(scale, scale), rcond=UNDETERMINED**2, hermitian=True
    ) * np.outer(scale, scale)
    return inverse @ ((middle + middle.T) / 2) @ inverse


def _triangle(blocks: Sequence[Block], weights: Array) -> Array:
    """Return the triangular factor of the weighted [right side, slopes] of all blocks."""
    result = np.zeros((0, 1 + blocks[0].slopes.shape[1]))
    for block in blocks:
        rows = np.column_stack([block.target - block.base, block.slopes]) * weights[block.equation]
        result = np.asarray(np.linalg.qr(np.vstack([result, rows]), mode="r"))
    return result


def _autocovariance(errors: Sequence[Array]) -> Autocovariance:
    """Estimate the autocovariance in a window of several correlation lengths."""
    total = sum(e.size for e in errors)
    # With a fifth as many lags as residuals, every lag averages over most of them.
    longest = max(2, min(total // 5, max(e.size for e in errors) - 1))
    raw = autocovariance(list(errors), longest - 1)
    if raw[0] <= 0:
        return Autocovariance(np.zeros(1), float(total))
    noise = 2 * longest / total  # what the squared autocorrelations of white residuals add up to
    length = max(1.0, float(2 * np.sum((raw / raw[0]) ** 2) - 1 - noise))
    # Parzen's window passes half at 0.36 of its width: nearly three correlation lengths.
    width = int(min(max(math.ceil(8 * length), 2), longest))
    k = np.arange(width) / width
    window = np.where(k <= 0.5, 1 - 6 * k**2 + 6 * k**3, 2 * (1 - k) ** 3)
    return Autocovariance(raw[:width] * window, total / length)
