"""The column space of a Jacobian: what linear parameters can remove from residuals."""

import numpy as np

from greybox.data.files.arrays import Array, IntArray, positive_or_one, unit_length

DEPENDENT = 1e-9  # of the largest singular value of columns of unit length: rounding errors


def column_basis(columns: Array) -> Array:
    """Return an orthonormal basis (n, r) of the space of columns (n, p), of any length."""
    # Parameters have different units: without scaling, the rank would depend on these.
    vectors, singular, _ = np.linalg.svd(unit_length(columns, 0), full_matrices=False)
    return vectors[:, singular > DEPENDENT * max(singular, default=0.0)]


def open_directions(active: Array, bounded: IntArray) -> Array:
    """Return an orthonormal basis (p, r) of directions that constraints and bounds leave open.

    Rows of `active` (a, p) are gradients of constraints that hold, and `bounded` are the places of
    the parameters that bounds hold.
    """
    _, singular, directions = np.linalg.svd(np.vstack([active, np.eye(active.shape[1])[bounded]]))
    return directions[np.sum(singular > 1e-12 * singular.max(initial=0.0)) :].T


def triangle_of(columns: Array) -> Array:
    """Return the triangular factor R (k, p) of columns (n, p): RᵀR is the product with itself."""
    return np.asarray(np.linalg.qr(columns, mode="r"))


def pseudo_inverse(information: Array, least: float) -> Array:
    """Return the inverse of an information matrix (p, p), zero along undetermined directions.

    Their eigenvalues are below `least` times the largest one, with a diagonal of ones, which makes
    the result independent of units.
    """
    diagonal = np.diag(information)
    scale = (diagonal > 0) / np.sqrt(positive_or_one(diagonal))
    scales = np.outer(scale, scale)
    return np.linalg.pinv(information * scales, least, hermitian=True) * scales


def beside(values: Array, columns: Array) -> Array:
    """Return the part of values (n, c) that is orthogonal to columns (n, p)."""
    return outside(values, column_basis(columns))


def outside(values: Array, basis: Array) -> Array:
    """Return the part of values (n, c) that is orthogonal to an orthonormal basis (n, r)."""
    # In memory, the samples of a column are neighbors.
    columns = values.T.copy()
    least = DEPENDENT**2 * np.einsum("...n,...n->...", columns, columns)
    columns -= (columns @ basis) @ basis.T
    # A column within the space leaves nothing but rounding.
    columns[np.einsum("...n,...n->...", columns, columns) <= least] = 0.0
    return columns.T
