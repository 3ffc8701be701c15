"""A small convex quadratic program: every Gauss-Newton step solves one for its parameters."""

import numpy as np

from greybox.data.files.arrays import Array, positive_or_one


def solve_small_qp(hessian: Array, gradient: Array, normals: Array, limits: Array) -> Array:
    """Return the d (p,) that minimizes d·H·d/2 + g·d subject to normals·d >= limits.

    H (p, p) is positive semidefinite.

    The program is solved as a least distance problem, by nonnegative least squares. Source: Lawson
    and Hanson (1974), Solving Least Squares Problems, chapter 23. Where the limits contradict
    one another, the step that ignores them is returned.
    """
    p = len(gradient)
    scale = 1 / np.sqrt(positive_or_one(np.diag(hessian)))
    values, vectors = np.linalg.eigh(hessian * scale * scale[:, None])
    largest = max(values.max(), 0.0)
    # Flatter directions move only where a limit needs it, and then count little.
    curved = values > 1e-13 * largest
    roots = np.sqrt(np.where(curved, values, 1e-10 * (largest or 1.0)))
    # d = map · (y + free), y the unknown of the least distance problem.
    mapping = scale[:, None] * vectors / roots
    free = np.where(curved, -(mapping.T @ gradient), 0.0)
    step = mapping @ free
    missed = normals @ step < limits
    if not missed.any():
        return step
    from scipy.optimize import nnls  # noqa: PLC0415  (takes a fifth of a second to import)

    rows = normals @ mapping
    least = limits - normals @ step
    size = positive_or_one(np.linalg.norm(rows, axis=1))
    rows, least = rows / size[:, None], least / size
    reach = max(float(np.abs(least).max()), 1e-300)
    system = np.vstack([rows.T, least / reach])
    target = np.eye(p + 1)[p]
    weights, _ = nnls(system, target, maxiter=50 * system.shape[1])
    residual = system @ weights - target
    if residual[p] > -1e-12:
        return step
    active = weights > 0
    # Least squares on the active limits has more digits.
    nearest = np.linalg.lstsq(rows[active], least[active])[0]
    if np.any(rows @ nearest < least - 1e-9 * reach):
        nearest = -residual[:p] / residual[p] * reach
    return mapping @ (free + nearest)
