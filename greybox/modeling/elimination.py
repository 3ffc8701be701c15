"""Solving (s I - A) x = b by elimination, in numbers or in expressions.

Expressions cannot be pivoted as they go. A pivot is zero not only at a pole but wherever a leading
sub-block of A has an eigenvalue at s, as the undamped position and velocity inside a damped system
do. So the order of elimination is chosen beforehand: the first one that agrees with a pivoted
solution in numbers, at sample values of the parameters. The characteristic polynomial would need no
pivots, but loses all digits if eigenvalues differ by a few decades.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array, BoolArray

# Relative error of the solution up to which an order is good enough: six of sixteen digits are
# lost.
ACCURATE = 1e-10
ORDERS = 200  # random orders to try: of many states, many orders are good


def solve(A: Sequence[Sequence[Any]], b: Sequence[Any], s: Any, order: Sequence[int]) -> list[Any]:
    """Solve (s I - A) x = b; None in A is an entry that is always zero."""
    n = len(b)
    # Entries that are always zero are not stored, which keeps the expressions short.
    rows: list[dict[int, Any]] = [{k: -a for k, a in enumerate(row) if a is not None} for row in A]
    for i in range(n):
        rows[i][i] = s + rows[i][i] if i in rows[i] else s

    right = list(b)
    for position, i in enumerate(order):
        for j in order[position + 1 :]:
            if i not in rows[j]:
                continue
            factor = rows[j].pop(i) / rows[i][i]
            for k in order[position + 1 :]:
                if k in rows[i]:
                    change = factor * rows[i][k]
                    rows[j][k] = rows[j][k] - change if k in rows[j] else -change
            right[j] = right[j] - factor * right[i]

    x: list[Any] = [0.0] * n
    for position, i in reversed(list(enumerate(order))):
        for k in order[position + 1 :]:
            if k in rows[i]:
                right[i] = right[i] - rows[i][k] * x[k]
        x[i] = right[i] / rows[i][i]

    return x


def elimination_order(
    samples: Array,
    b: Array,
    zero: BoolArray,
    omega: Array,
) -> tuple[int, ...]:
    """Return the order in which to eliminate.

    Parameters
    ----------
    samples : (m, n, n) array
        A at sample values of the parameters.
    b : (m, n) array
        The right-hand side there.
    zero : (n, n) array of bool
        Entries of A that are always zero.
    omega : (k,) array, rad/s
        Where the solution is needed, s = jω.
    """
    m, n, _ = samples.shape
    if n < 2:
        return tuple(range(n))
    s = 1j * omega[None, :]
    entries = [[None if zero[i, k] else samples[:, i, k, None] for k in range(n)] for i in range(n)]
    right = [np.broadcast_to(b[:, i, None], (m, omega.size)).astype(complex) for i in range(n)]
    pencil = s[..., None, None] * np.eye(n) - samples[:, None]
    # An order with a zero pivot divides by it here, and is thereby found out.
    with np.errstate(all="ignore"):
        exact = solve_pencils(pencil, np.stack(right, axis=-1))
        size = np.abs(exact).max(axis=-1, keepdims=True)
        best = tuple(range(n))
        least = np.inf
        for order in _orders(n):
            solution = np.stack([v + 0 * s for v in solve(entries, right, s, order)], axis=-1)
            error = np.max(
                np.nan_to_num(np.abs(solution - exact) / size, nan=1e300),
                where=np.isfinite(size),
                initial=0.0,
            )
            if error < least:
                best = order
                least = error
            # The first good order is taken: the natural one keeps the expressions short.
            if least < ACCURATE:
                break

    return best


def _orders(n: int) -> Iterator[tuple[int, ...]]:
    """Yield the natural order, the reversed one, and random ones."""
    yield tuple(range(n))
    yield tuple(range(n))[::-1]
    random = np.random.default_rng(0)
    for _ in range(ORDERS):
        yield tuple(random.permutation(n).tolist())


def solve_pencils(pencil: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Solve (..., n, n) x = (..., n) with pivoting; NaN where the matrix is singular, at a pole."""
    try:
        return np.linalg.solve(pencil, right[..., None])[..., 0]
    except np.linalg.LinAlgError:
        # One singular matrix fails the whole stack: solve the others one by one.
        exact = np.full(right.shape, np.nan, dtype=complex)
        for index in np.ndindex(right.shape[:-1]):
            if np.linalg.matrix_rank(pencil[index]) == right.shape[-1]:
                exact[index] = np.linalg.solve(pencil[index], right[index])
        return exact
