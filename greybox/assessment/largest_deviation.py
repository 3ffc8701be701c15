"""The point of a response that deviates most, and how probable that is.

Let z be the residuals of a response over the expected sizes of its errors (real parts, then
imaginary parts), M = I - H the projection that removes the parameters, and k the two rows of a
point. Q = (Mz)_kᵀ M_kk⁻¹ (Mz)_k is the decrease of the sum of squares without that point. For
normal errors of these sizes, up to a common factor, Q/2 over the mean square of the other points
has an F distribution with 2 and the remaining degrees of freedom. The largest of n points is judged
by n times its probability (Cook and Weisberg (1982), Residuals and Influence in Regression, section
2.2, for real data). The test concerns the errors, not the criterion: the residuals of any criterion
are projected like those of least squares.
"""

import math

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.response_part import ResponsePart
from greybox.statistics.column_space import column_basis

# Significance level, the size of the test: the share of fits to clean data in which any point is
# called an outlier.
SIZE = 0.01

# Residuals below this share of the largest one are rounding errors.
ROUNDING = 1e-9


@frozen
class Deviation:
    """The point of a response that deviates most.

    Attributes
    ----------
    index : int
        Index of the point in the data.
    probability : float
        Probability of a deviation as unlikely as this one at a point of clean data.
    relative : float
        The deviation over the model's magnitude.
    """

    index: int
    probability: float
    relative: float


def largest_deviation(part: ResponsePart, values: Array, free: int) -> Deviation | None:
    """Return the point that deviates most at all values (k,), of which the first `free` are free.

    Where the data give variances of few degrees of freedom, a residual is a bivariate Student's t
    and is judged as such. None if no point can be judged.
    """
    # The answer is stored with the part: the test of misfit and the check of outliers both ask.
    return part.stored("deviation", values, lambda: _largest_deviation(part, values, free))


def _largest_deviation(part: ResponsePart, values: Array, free: int) -> Deviation | None:
    data, criterion = part.data, part.error_model
    model = part.response(values)
    size = criterion.error_size(model, data)
    points = np.flatnonzero(np.isfinite(size) & (size > ROUNDING * np.max(size, initial=0.0)))
    residual = (data.response - model)[points] / size[points]
    if criterion.known_noise and data.dof is not None:
        ratio = np.abs(residual) ** 2 / max(criterion.noise_ratio(model, data), 1.0)
        dof = data.dof[points]
    else:
        sensitivity = part.sensitivity(values)[points, :free] / size[points, None]
        # Each of the two components has half of a given variance.
        least = 0.5 if criterion.known_noise else 0.0
        ratio, dof = deletion_ratios(residual, sensitivity, least)

    # Probability that F with 2 and `dof` degrees of freedom exceeds the ratio.
    probability = (1 + 2 * ratio / dof) ** (-dof / 2)
    if not np.any(np.isfinite(probability)):
        return None

    worst = int(np.nanargmin(probability))
    index = int(points[worst])
    with np.errstate(divide="ignore"):  # a gain of zero ends at a response of zero
        relative = float(np.abs(data.response - model)[index] / np.abs(model[index]))
    return Deviation(index, float(probability[worst]), relative)


def deletion_ratios(
    residual: ComplexArray, sensitivity: ComplexArray, least: float
) -> tuple[Array, float]:
    """Return Q/2 over the mean square of the other points (n,), and their degrees of freedom.

    NaN for a point that the parameters fit exactly, and where no degrees of freedom remain.

    Parameters
    ----------
    residual, sensitivity : (n,) and (n, p) complex arrays
        Over the sizes of the errors.
    least : float
        Lower limit of the mean square.
    """
    n = residual.size
    basis = column_basis(real_and_imaginary(sensitivity))
    dof = 2 * n - basis.shape[1] - 2
    z = real_and_imaginary(residual)
    # Other criteria do not leave residuals orthogonal to the Jacobian; the test needs that.
    z = z - basis @ (basis.T @ z)
    total = float(z @ z)

    if dof < 2 or not total > 0:
        return np.full(n, np.nan), math.nan

    # The real parts of all points come first, then the imaginary parts: row k and row n + k belong
    # to point k.
    point_rows = np.stack([basis[:n], basis[n:]], axis=1)  # (n, 2, columns)
    M = np.eye(2) - point_rows @ point_rows.mT
    is_judged = np.linalg.eigvalsh(M)[:, 0] > ROUNDING
    M[~is_judged] = np.eye(2)  # any matrix that can be inverted: the result is NaN there
    points = z.reshape(2, n).T
    solved = np.linalg.solve(M, points[..., None])[..., 0]
    q = np.sum(points * solved, axis=1)
    mean_square = np.maximum((total - q) / dof, max(least, ROUNDING * total))
    return np.where(is_judged, q / 2 / mean_square, math.nan), float(dof)
