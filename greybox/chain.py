"""The linear algebra of multiple shooting: segments that hand their end state to the next one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def solve_chain(
    hessian: Array, transition: Array, coupled: NDArray[np.bool_], stationarity: Array, continuity: Array, soft: Array
) -> tuple[Array, Array]:
    """Solve the Karush-Kuhn-Tucker system of a chain of s segments with n states for r right-hand sides.

    H_j x_j + A_jᵀ λ_j - λ_(j-1) = stationarity_j and A_j x_j - x_(j+1) - P λ_j = continuity_j, with λ_j = 0 where
    segment j is not `coupled` to the next. P = diag(soft) is zero for exact continuity. The unknowns in the order
    x_0, λ_0, x_1, λ_1 ... make a band, which LAPACK factorizes with pivoting in a time linear in s.

    Parameters
    ----------
    hessian, transition : (s, n, n) arrays
        H and A.
    coupled : (s,) bool array
    stationarity, continuity : (s, n, r) arrays
    soft : (n,) array

    Returns
    -------
    x, λ : (s, n, r) arrays

    Raises
    ------
    numpy.linalg.LinAlgError
        If the system is singular.
    """
    from scipy.linalg.lapack import dgbsv  # noqa: PLC0415  (takes a fifth of a second to import)

    s, n, r = stationarity.shape
    if n == 0:
        return np.zeros((s, 0, r)), np.zeros((s, 0, r))
    width = 2 * n - 1
    band = np.zeros((3 * width + 1, 2 * n * s), order="F")
    center = 2 * width
    on, link = coupled[:, None], -coupled[:-1].astype(float)
    places = 2 * n * np.arange(s)

    def fill(row: int, column: int, values: Any, blocks: slice = slice(None)) -> None:
        """Put the entries of one place of the blocks, whose columns begin at `places`."""
        band[center + row - column, places[blocks] + column] = values

    transition = transition * on[..., None]
    for i in range(n):
        for k in range(n):
            fill(i, k, hessian[:, i, k])
            fill(n + i, k, transition[:, i, k])
            fill(i, n + k, transition[:, k, i])
        fill(n + i, n + i, np.where(coupled, -soft[i], 1.0))
        if s > 1:
            band[center + (n + i) - (2 * n + i), places[1:] + i] = link  # -x_(j+1) in the continuity of j
            band[center + (2 * n + i) - (n + i), places[:-1] + n + i] = link  # -λ_j in the stationarity of j+1
    right = np.concatenate([stationarity, np.where(on[..., None], continuity, 0.0)], axis=1).reshape(2 * n * s, r)
    _, _, solution, info = dgbsv(width, width, band, right, overwrite_ab=1)
    if info != 0 or not np.all(np.isfinite(solution)):
        raise np.linalg.LinAlgError("the segments do not determine their states.")
    solution = np.asarray(solution).reshape(s, 2 * n, r)
    return solution[:, :n], solution[:, n:]
