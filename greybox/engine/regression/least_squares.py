"""Linear least squares over several equations, with bounds."""

import numpy as np

from greybox.data.files.arrays import Array, IntArray, positive_or_one
from greybox.data.files.frozen_values import frozen
from greybox.statistics.column_space import triangle_of


@frozen
class Rows:
    """Rows of regressions, ``target = base + slopes @ unknowns``.

    Attributes
    ----------
    equation : (n,) array of int
        The number of the equation of every row.
    target, base : (n,) arrays
    slopes : (n, k) array
    """

    equation: IntArray
    target: Array
    base: Array
    slopes: Array

    def errors(self, unknowns: Array) -> Array:
        """Return the residuals (n,) at the unknowns (k,)."""
        return self.target - self.base - self.slopes @ unknowns

    def solution(self, weights: Array, low: Array, high: Array) -> Array:
        """Return the unknowns of least squares within bounds, with a weight for each equation."""
        row_weights = weights[self.equation]
        slopes = row_weights[:, None] * self.slopes
        return solve(slopes, row_weights * (self.target - self.base), low, high)

    def spread(self, errors: Array, count: int) -> Array:
        """Return the rms error of `count` equations, at least the rounding error of their targets.

        An equation whose target and errors are zero gets one, since no scale would matter.
        """
        size = np.bincount(self.equation, minlength=count)
        squares = np.bincount(self.equation, errors**2, minlength=count)
        power = np.bincount(self.equation, self.target**2, minlength=count)
        # Smaller squares of residuals are rounding errors.
        total = squares + 1e-24 * power
        return np.sqrt(np.where(total > 0, total / np.maximum(size, 1), 1.0))


def undetermined(slopes: Array) -> list[tuple[int, ...]]:
    """Return groups of columns whose unknowns cannot be determined separately.

    A group of one column is a column of zeros, without any effect. In a larger group, a combination
    of the columns has no effect.
    """
    from scipy.linalg import null_space  # noqa: PLC0415  (imports slowly)

    # The triangular factor has the singular values of all rows, which may be many thousands.
    triangle = triangle_of(slopes)
    sizes = np.linalg.norm(triangle, axis=0)
    zero = [(int(k),) for k in np.flatnonzero(sizes == 0)]
    nonzero = np.flatnonzero(sizes)
    if not nonzero.size:
        return zero

    # The limit of 1e-7 is about the square root of the rounding error: normal equations would lose
    # a combination with a smaller singular value.
    open_directions = null_space(triangle[:, nonzero] / sizes[nonzero], 1e-7)
    share = np.linalg.norm(open_directions, axis=1)
    # Smaller shares of a column in such a combination are rounding errors.
    combined = tuple(int(k) for k in nonzero[share > 1e-3])
    return [*zero, combined] if combined else zero


def solve(slopes: Array, right: Array, low: Array, high: Array) -> Array:
    """Return the unknowns (k,) of least squares within the bounds."""
    from scipy.optimize import lsq_linear  # noqa: PLC0415  (imports slowly)

    if not slopes.shape[1]:
        return np.zeros(0)
    # The triangular factor of the augmented matrix states the same least squares in few rows.
    triangle = triangle_of(np.column_stack([right, slopes]))
    right, matrix = triangle[:, 0], triangle[:, 1:]
    # The least-norm solution of columns of length one does not depend on units.
    sizes = positive_or_one(np.linalg.norm(matrix, axis=0))
    bounded = lsq_linear(
        matrix / sizes, right, (low * sizes, high * sizes), method="bvls", max_iter=1000
    )
    unknowns = np.clip(bounded.x / sizes, low, high)
    # An active bound is met exactly, without the rounding of the scale.
    unknowns = np.where(bounded.active_mask > 0, high, unknowns)
    return np.where(bounded.active_mask < 0, low, unknowns)
