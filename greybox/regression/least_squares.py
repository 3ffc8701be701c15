"""Linear least squares over several equations with bounds, and the covariance of its answer when residuals are colored.

Colored residuals: Cov = (XᵀX)⁻¹ Xᵀ R X (XᵀX)⁻¹ with the autocovariance R of the residuals (Morelli and Klein, Aircraft
System Identification, 2nd ed., chapter 5). R is the sample autocovariance under a Parzen window (Parzen, Ann. Math.
Statist. 32 (1961) 951-989), which keeps it positive semidefinite.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEAD = 1e-7  # singular value of the unit-column matrix below which a combination is not determined
PART = 1e-3  # share in such a combination from which a column belongs to it
WIDTH = 8.0  # Parzen window, in correlation lengths of the residuals


@dataclass(frozen=True, eq=False)
class Block:
    """One equation over one stretch: ``target = base + slopes @ unknowns``, (n,), (n,), (n, k)."""

    equation: int
    target: Array
    base: Array
    slopes: Array


@dataclass(frozen=True, eq=False)
class Color:
    """Autocovariance (lags 0 ... m - 1) of one equation's residuals, and how many independent ones they are worth."""

    autocovariance: Array
    independent: float


def undetermined(blocks: Sequence[Block]) -> list[tuple[int, ...]]:
    """Return the columns that change nothing, each alone, and the sets whose combination changes nothing."""
    triangle = _triangle(blocks, np.ones(1 + max(b.equation for b in blocks)))[:, 1:]
    sizes = np.linalg.norm(triangle, axis=0)
    dead = [(int(k),) for k in np.flatnonzero(sizes == 0)]
    alive = np.flatnonzero(sizes)
    if not alive.size:
        return dead
    _, values, directions = np.linalg.svd(triangle[:, alive] / sizes[alive], full_matrices=True)
    values = np.pad(values, (0, alive.size - values.size))
    blind = directions[values < DEAD * values[0]]
    share = np.sqrt(np.sum(blind**2, axis=0))
    together = tuple(int(k) for k in alive[share > PART])
    return [*dead, together] if together else dead


def solve(blocks: Sequence[Block], weights: Array, low: Array, high: Array) -> Array:
    """Return the unknowns (k,) of least weighted squares within the bounds; columns are normalized first."""
    from scipy.optimize import lsq_linear  # noqa: PLC0415  (import of greybox stays free of scipy)

    triangle = _triangle(blocks, weights)
    right, matrix = triangle[:, 0], triangle[:, 1:]
    if not matrix.shape[1]:
        return np.zeros(0)
    sizes = np.linalg.norm(matrix, axis=0)
    sizes[sizes == 0] = 1.0
    free = np.linalg.lstsq(matrix / sizes, right, rcond=None)[0] / sizes
    if np.all((free >= low) & (free <= high)):
        return free
    found = lsq_linear(matrix / sizes, right, (low * sizes, high * sizes), method="bvls", max_iter=1000)
    return np.clip(found.x / sizes, low, high)


def residuals(blocks: Sequence[Block], unknowns: Array) -> list[Array]:
    """Return target minus model of every block."""
    return [block.target - block.base - block.slopes @ unknowns for block in blocks]


def spread(blocks: Sequence[Block], errors: Sequence[Array]) -> Array:
    """Return the root mean square of the errors of every equation, (equations,); at least rounding of its target."""
    count = 1 + max(block.equation for block in blocks)
    square, size, scale = np.zeros(count), np.zeros(count), np.zeros(count)
    for block, error in zip(blocks, errors, strict=True):
        square[block.equation] += error @ error
        scale[block.equation] += block.target @ block.target
        size[block.equation] += error.size
    return np.sqrt((square + 1e-24 * scale + 1e-300) / np.maximum(size, 1))


def colors(blocks: Sequence[Block], errors: Sequence[Array]) -> list[Color]:
    """Return the autocovariance of the residuals of every equation, over its stretches."""
    count = 1 + max(block.equation for block in blocks)
    return [_color([e for b, e in zip(blocks, errors, strict=True) if b.equation == k]) for k in range(count)]


def covariance(blocks: Sequence[Block], weights: Array, color: Sequence[Color]) -> Array:
    """Return the covariance (k, k) for residuals of these colors; the equations are taken as independent."""
    from scipy.signal import fftconvolve  # noqa: PLC0415  (takes a third of a second to import)

    size = blocks[0].slopes.shape[1]
    normal, middle = np.zeros((size, size)), np.zeros((size, size))
    for block in blocks:
        weight, r = weights[block.equation] ** 2, color[block.equation].autocovariance
        kernel = np.concatenate([r[:0:-1], r])[:, None]
        spreaded = fftconvolve(block.slopes, kernel, axes=0)[len(r) - 1 : len(r) - 1 + len(block.slopes)]
        normal += weight * block.slopes.T @ block.slopes
        middle += weight**2 * block.slopes.T @ spreaded
    sizes = np.sqrt(np.diag(normal))
    scale = np.divide(1, sizes, out=np.zeros(size), where=sizes > 0)
    inverse = np.linalg.pinv(normal * np.outer(scale, scale), rcond=DEAD**2, hermitian=True) * np.outer(scale, scale)
    return inverse @ ((middle + middle.T) / 2) @ inverse


def _triangle(blocks: Sequence[Block], weights: Array) -> Array:
    """Return the triangular factor of the weighted [right side, slopes] of all blocks."""
    result = np.zeros((0, 1 + blocks[0].slopes.shape[1]))
    for block in blocks:
        rows = np.column_stack([block.target - block.base, block.slopes]) * weights[block.equation]
        result = np.asarray(np.linalg.qr(np.vstack([result, rows]), mode="r"))
    return result


def _color(errors: Sequence[Array]) -> Color:
    """Estimate the autocovariance over several stretches, with a window as wide as the residuals remember."""
    total = sum(e.size for e in errors)
    longest = max(2, min(total // 5, max(e.size for e in errors) - 1))
    raw = np.sum([_products(e, longest) for e in errors], axis=0) / total
    if raw[0] <= 0:
        return Color(np.zeros(1), float(total))
    noise = 2 * longest / total  # what the squared autocorrelations of white residuals add up to
    length = max(1.0, float(2 * np.sum((raw / raw[0]) ** 2) - 1 - noise))
    width = int(min(max(math.ceil(WIDTH * length), 2), longest))
    return Color(raw[:width] * _parzen(width), total / length)


def _products(error: Array, lags: int) -> Array:
    size = 1 << (2 * error.size - 1).bit_length()
    spectrum = np.abs(np.fft.rfft(error, size)) ** 2
    return np.pad(np.fft.irfft(spectrum, size)[: min(lags, error.size)], (0, max(lags - error.size, 0)))


def _parzen(width: int) -> Array:
    """Return the one-sided Parzen lag window, (width,)."""
    k = np.arange(width) / width
    return np.where(k <= 0.5, 1 - 6 * k**2 + 6 * k**3, 2 * (1 - k) ** 3)
