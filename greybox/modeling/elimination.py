"""Responses D + C (s I - A)⁻¹ B of a linear system by elimination, in numbers or in expressions.

The states are eliminated from the matrix [[s I - A, B], [-C, D]], in whose last corner the
responses remain. Pivots of expressions cannot be chosen by their size during the elimination. A
pivot is zero not only at a pole but wherever a leading sub-block of A has an eigenvalue at s, as
the undamped position and velocity inside a damped system do. So the order of elimination is chosen
beforehand, by these eigenvalues at sample values of the parameters. The characteristic polynomial
would need no pivots, but loses all digits if eigenvalues differ by a few decades.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.data.files.arrays import AnyArray, Array


def eliminated(system: Sequence[Sequence[Any]], s: Any, order: Sequence[int]) -> list[list[Any]]:
    """Return the responses of a system [[-A, B], [-C, D]]; None is an entry that is always zero."""
    n = len(order)
    corner = range(n, len(system))
    # Entries that are always zero are not stored, which keeps the expressions short.
    rows = [{k: v for k, v in enumerate(row) if v is not None} for row in system]
    for i in range(n):
        rows[i][i] = s + rows[i][i] if i in rows[i] else s

    for position, i in enumerate(order):
        pivot = rows[i].pop(i)
        for j in (*order[position + 1 :], *corner):
            if i not in rows[j]:
                continue
            factor = rows[j].pop(i) / pivot
            for k, value in rows[i].items():
                change = factor * value
                rows[j][k] = rows[j][k] - change if k in rows[j] else -change

    return [[rows[j].get(k, 0.0) for k in range(n, len(system[0]))] for j in corner]


def elimination_order(A: Array, omega: Array) -> tuple[int, ...]:
    """Return an order of the states in which no pivot vanishes: the natural one, or its reverse.

    Parameters
    ----------
    A : (m, n, n) array
        The matrix at sample values of the parameters.
    omega : (k,) array, rad/s
        Where the responses are needed, s = jω.
    """
    natural = tuple(range(A.shape[1]))
    for order in (natural, natural[::-1]):
        blocks = (A[:, order[:k]][:, :, order[:k]] for k in natural[1:])
        distances = (np.abs(np.linalg.eigvals(block)[..., None] - 1j * omega) for block in blocks)
        # Next to an eigenvalue of a leading block, a pivot loses six of sixteen digits.
        if not any(np.any(distance < 1e-6 * omega) for distance in distances):
            return order
    # The natural order keeps the expressions short.
    return natural


def solve_pencils(pencil: AnyArray, right: AnyArray) -> AnyArray:
    """Solve (..., n, n) x = (..., n) with pivoting; NaN where the matrix is singular, at a pole."""
    try:
        return np.linalg.solve(pencil, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        # One singular matrix fails the whole stack; a matrix of NaN has a solution of NaN.
        is_singular = np.linalg.matrix_rank(pencil) < right.shape[-1]
        regular = np.where(is_singular[..., None, None], np.nan, pencil)
        return np.linalg.solve(regular, right[..., None])[..., 0]
