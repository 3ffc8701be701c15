"""Whether a point of a response lies farther from the model than the others let expect, and the answer without it.

With z the residuals of a response over the sizes that its criterion expects of errors, real and
imaginary parts below each other, M = I - H what remains of errors when the parameters have been
fitted to this response alone, and k the two rows of a point, Q = (Mz)_kᵀ M_kk⁻¹ (Mz)_k is what
leaving the point out takes from the sum of squares. Of normal errors of these sizes, up to a common
factor, Q/2 over the mean square of the rest has an F distribution with 2 and the remaining degrees
of freedom; the largest of n points is judged by n times its probability (Cook and Weisberg (1982),
Residuals and Influence in Regression, section 2.2, for real data). This asks about the errors, not
about the criterion: residuals of every one are projected to those of least squares.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem, compile_problem
from greybox.compiled.response_part import ResponsePart
from greybox.estimate.covariance import Accuracy, assess
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import number, with_error
from greybox.formulation.problem import Problem
from greybox.solve.multistart import multistart, solver_for
from greybox.statistics.column_space import column_basis

# Of fits to clean data, the share in which any point is called an outlier.
SIZE = 0.01

# Standard errors by which a parameter must move to be listed: less is in no digit that is printed.
MOVED = 0.1

# Of the largest size of an error: points below have no size that residuals could be held against.
LEAST_SIZE = 1e-9

LEAST_LEFT = 2  # degrees of freedom of the other points
DEPENDENT = 1e-9  # shares of a point's residual: rounding errors


@dataclass(frozen=True, order=True)
class Deviation:
    """The point of a response that deviates most.

    Attributes
    ----------
    index : int
        Of the point in the data.
    probability : float
        Of a deviation as unlikely as this one, at a point of clean data.
    relative : float
        The deviation over the model's magnitude.
    """

    index: int
    probability: float
    relative: float


def outlying_points(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> tuple[str, ...]:
    """Name the points of responses that are outliers of the fit `x` (p,), and say what it is without them."""
    values = nlp.all_values(x)
    each = [
        largest_deviation(p, values, len(nlp.free)) if isinstance(p, ResponsePart) else None
        for p in nlp.parts
    ]
    total = sum(part.numbers // 2 for part in nlp.parts if isinstance(part, ResponsePart))
    found = sorted(
        (min(total * deviation.probability, 1.0), k, deviation)
        for k, deviation in enumerate(each)
        if deviation
    )
    return tuple(_warning(nlp, x, accuracy, *item) for item in found if item[0] < SIZE)


def _warning(
    nlp: CompiledProblem, x: Array, accuracy: Accuracy, probability: float, k: int, found: Deviation
) -> str:
    return (
        f"{_point(nlp, k, found)} is an outlier, {100 * found.relative:.2g} % from the model: fewer than "
        f"{_share(probability)} fits to clean data have one as unlikely; {_without_it(nlp, x, accuracy, k, found)}."
    )


def _point(nlp: CompiledProblem, k: int, found: Deviation) -> str:
    problem = nlp.parts[k].problem
    return f"the point at {problem.response.omega[found.index]:.4g} rad/s of {problem.name!r}"


def largest_deviation(part: ResponsePart, values: Array, free: int) -> Deviation | None:
    """Return the point that deviates most at all values (k,), of which the first are `free`; None if none can be told.

    Where the data give variances of few degrees of freedom a residual is a bivariate Student's t,
    so that it is judged by these, as it stands.
    """
    data, criterion = part.data, part.criterion
    model = part.response(values)
    size = criterion.error_size(model, data)
    kept = np.flatnonzero(np.isfinite(size) & (size > LEAST_SIZE * np.max(size, initial=0.0)))
    if not kept.size:
        return None
    residual = (data.response - model)[kept] / size[kept]
    if criterion.known_noise and data.dof is not None:
        ratio = np.abs(residual) ** 2 / max(criterion.noise_ratio(model, data), 1.0)
        left = data.dof[kept]
    else:
        sensitivity = part.sensitivity(values)[kept, :free] / size[kept, None]
        # A component of a given variance has half of it.
        ratio, left = _ratios(residual, sensitivity, least=0.5 if criterion.known_noise else 0.0)
    probability = (1 + 2 * ratio / left) ** (
        -left / 2
    )  # that an F of 2 and `left` degrees of freedom exceeds it
    if not np.any(np.isfinite(probability)):
        return None
    worst = int(np.nanargmin(probability))
    relative = float(np.abs(data.response - model)[kept[worst]] / np.abs(model[kept[worst]]))
    return Deviation(int(kept[worst]), float(probability[worst]), relative)


def _ratios(residual: ComplexArray, sensitivity: ComplexArray, least: float) -> tuple[Array, float]:
    """Return Q/2 over the mean square of the rest, at least `least`, (n,), and its dof; NaN where nothing is left."""
    n = residual.size
    jacobian = np.vstack([sensitivity.real, sensitivity.imag])
    basis = column_basis(jacobian)
    dof = 2 * n - basis.shape[1] - 2
    z = np.concatenate([residual.real, residual.imag])
    z = z - basis @ (basis.T @ z)
    total = float(z @ z)
    if dof < LEAST_LEFT or not total > 0:
        return np.full(n, math.nan), math.nan
    re, im = basis[:n], basis[n:]
    a, b, c = (
        1 - np.sum(re**2, axis=1),
        -np.sum(re * im, axis=1),
        1 - np.sum(im**2, axis=1),
    )  # [[a, b], [b, c]] = M_kk
    remains = (a + c) / 2 - np.hypot((a - c) / 2, b) > DEPENDENT
    with np.errstate(divide="ignore", invalid="ignore"):
        taken = (c * z[:n] ** 2 - 2 * b * z[:n] * z[n:] + a * z[n:] ** 2) / (a * c - b**2)
    ratio = np.where(
        remains,
        taken / 2 / np.maximum((total - taken) / dof, max(least, DEPENDENT * total)),
        math.nan,
    )
    return ratio, float(dof)


def _fitted_without(
    nlp: CompiledProblem, x: Array, part: int, point: int
) -> tuple[Array, Array] | None:
    """Return estimate and standard errors (p,) without a point, from the estimate with it; None if there is none."""
    parts = list(nlp.problem.parts)
    parts[part] = _without(parts[part], point)
    smaller = compile_problem(nlp.problem.with_parts(parts), nlp.method)
    solver = solver_for(smaller)
    search = multistart(smaller, solver, x[None], movable=False)
    if not search.minima:
        return None
    best = search.minima[0].estimate
    accuracy = assess(smaller, best, solver.profile(best, search.nodes).trajectories)
    return best, np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(best)], 0.0))


def _without(problem: Problem, point: int) -> Problem:
    kept = np.arange(len(problem.response)) != point
    sine = problem.amplitude
    if sine is not None and np.size(sine.amplitude) > 1:
        sine = replace(sine, amplitude=np.asarray(sine.amplitude)[kept])
    return problem.with_(data=problem.response.where(kept), amplitude=sine)


def _without_it(
    nlp: CompiledProblem, x: Array, accuracy: Accuracy, part: int, deviation: Deviation
) -> str:
    """Say which parameters move without a point, and to where."""
    found = _fitted_without(nlp, x, part, deviation.index)
    if found is None:
        return "without it the fit does not converge"
    estimate, error = found
    before = np.sqrt(np.maximum(np.diag(accuracy.covariance)[: len(x)], 0.0))
    moved = [k for k in range(len(x)) if not abs(estimate[k] - x[k]) <= MOVED * before[k]]
    if not moved:
        return "without it no parameter moves by a tenth of its standard error"
    units = (nlp.problem.parameters[nlp.free[k]].unit for k in moved)
    each = (" ± ".join(with_error(float(estimate[k]), float(error[k]))) for k in moved)
    return "without it " + ", ".join(
        f"{nlp.free[k]} = {value}{f' {unit}' if unit not in ('', '1') else ''}"
        for k, value, unit in zip(moved, each, units, strict=True)
    )


def _share(probability: float) -> str:
    """Say a probability as one in so many."""
    return f"one in {number(float(max(math.floor(1 / max(probability, 1e-12)), 1)), 2)}"
