"""Linear least squares over several equations, with bounds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array

# Singular value of the matrix with unit columns, below which a combination is undetermined: about
# the root of the rounding error, where normal equations would lose it.
UNDETERMINED = 1e-7
# Share of a column in such a combination from which it belongs to it: above the rounding error over
# UNDETERMINED.
PART = 1e-3
ROUNDING = 1e-24  # of the power of a target: smaller squares of residuals are rounding errors


@dataclass(frozen=True, eq=False)
class Block:
    """One equation over one stretch: ``target = base + slopes @ unknowns``, (n,), (n,), (n, k)."""

    equation: int
    target: Array
    base: Array
    slopes: Array


def undetermined(blocks: Sequence[Block]) -> list[tuple[int, ...]]:
    """Return the columns without effect, and sets of columns with a combination without effect."""
    # The triangular factor has the singular values of all rows, which may be many thousands.
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
    # The least-norm solution of columns of length one does not depend on units.
    sizes[sizes == 0] = 1.0
    # Usually no bound is active, and the plain solution is the answer.
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
    """Return the rms error of every equation, at least the rounding error of its target.

    It is one for an equation whose target and errors are zero: any other number would do.
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


def _triangle(blocks: Sequence[Block], weights: Array) -> Array:
    """Return the triangular factor of the weighted [right side, slopes] of all blocks."""
    result = np.zeros((0, 1 + blocks[0].slopes.shape[1]))
    # Block by block, so that no matrix of all rows is formed.
    for block in blocks:
        rows = np.column_stack([block.target - block.base, block.slopes]) * weights[block.equation]
        result = np.asarray(np.linalg.qr(np.vstack([result, rows]), mode="r"))
    return result
