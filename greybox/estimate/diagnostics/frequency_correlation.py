"""Whether the errors of a response or of a manoeuvre are correlated along frequency.

Errors of neighboring points are not independent where these are closer than the resolution of the
transform that they come from, nor where the model leaves a part of the response out. The residuals
show both: of independent errors, neighbors have no product on average but for what the fitted
parameters take away. Standard errors of responses account for it
(`greybox.statistics.neighbor_correlation`), those of manoeuvres do not.

With z the residuals over their size, real and imaginary parts below each other, the correlation of
neighbors is r = zᵀWz / zᵀz. Of normal errors with the parameters taken away, z = Me, r is
independent of zᵀz and has the mean tr MW / k and the variance 2 (tr (MW)² - (tr MW)² / k) / (k (k +
2)), k = tr M (Durbin and Watson (1950), Biometrika 37, who hold a beta distribution against it).
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import ResponsePart
from greybox.compiled.transient_part import TransientPart
from greybox.estimate.covariance import Accuracy
from greybox.files.arrays import Array, ComplexArray
from greybox.files.text_table import counted
from greybox.statistics.column_space import column_basis

# Correlation lengths of the points below which standard errors are called rough: of 12 points with
# a correlation of 0.8, two and a half lengths, intervals of 95 % hold in 86 to 93 % of fits, of 24
# in 91 to 98.
FEWEST_LENGTHS = 8.0


def correlated_frequencies(nlp: CompiledProblem, x: Array, accuracy: Accuracy) -> Iterator[str]:
    """Name the responses whose residuals at the estimate `x` (p,) are correlated from one frequency to the next."""
    all_neighbors = accuracy.neighbors or (None,) * len(nlp.parts)
    for part, neighbors in zip(nlp.parts, all_neighbors, strict=True):
        if isinstance(part, ResponsePart):
            yield from _of_response(nlp, part, x, neighbors)
        elif isinstance(part, TransientPart):
            where = f" of {part.problem.name!r}" if len(nlp.parts) > 1 else ""
            for name, errors, jacobian in part.errors_by_output(nlp.scaling.to_solver(x)):
                slope = np.vstack([jacobian.real, jacobian.imag])
                excess = excess_correlation(errors, slope)
                if excess is not None:
                    yield (
                        f"{_correlated(f'the errors of {name}{where}', excess)}; the standard errors, which assume "
                        "independent errors, are too small."
                    )


def _of_response(
    nlp: CompiledProblem, part: ResponsePart, x: Array, neighbors: Any
) -> Iterator[str]:
    excess = excess_correlation(*_residuals(part, nlp.all_values(x), len(nlp.free)))
    text = f"the residuals of {part.problem.name!r}"
    if neighbors is not None and neighbors.lengths < FEWEST_LENGTHS:
        excess = neighbors.correlation if excess is None else excess
        points = len(part.data)
        yield (
            f"{_correlated(text, excess)}; {counted(points, 'point')} whose errors stay correlated over "
            f"{points / neighbors.lengths:.1f} of them cannot show the size of slow errors, and the standard errors "
            "are rough."
        )
    elif excess is not None:
        accounted = "" if neighbors is None else "; the standard errors account for that"
        yield f"{_correlated(text, excess)}{accounted}."


def _correlated(what: str, correlation: float) -> str:
    return (
        f"{what} are correlated along frequency ({correlation:.2f} from one point to the next). Either the points are "
        "closer than the frequency resolution, or the model misses something"
    )


def excess_correlation(residuals: ComplexArray, jacobian: Array) -> float | None:
    """Return the correlation of neighbors beyond that of independent errors; None below 99 % significance."""
    lag_one = lag_one_correlation(residuals, jacobian)
    if lag_one is None:
        return None
    r, mean, variance = lag_one
    return r - mean if chance_of_more(r, mean, variance) < 0.01 else None


def chance_of_more(r: float, mean: float, variance: float) -> float:
    """Return the probability of a correlation above r, by a beta distribution on [-1, 1] of this mean and variance."""
    from scipy.special import betaincc  # noqa: PLC0415 - scipy takes longer to import than this package

    middle = (1 + mean) / 2
    total = middle * (1 - middle) / (variance / 4) - 1
    return float(betaincc(middle * total, (1 - middle) * total, (1 + r) / 2))


def lag_one_correlation(
    residuals: ComplexArray, jacobian: Array
) -> tuple[float, float, float] | None:
    """Return the correlation of neighbors, and its mean and variance if the errors are independent.

    Parameters
    ----------
    residuals : (n,) complex array
        In the order of frequency, over their sizes.
    jacobian : (2n, p) array
        Their derivatives by the parameters that were fitted, real parts first.

    Returns
    -------
    (float, float, float) or None
        None with fewer than four degrees of freedom, too few for the beta distribution, or if all
        are zero.
    """
    n = residuals.size
    basis = column_basis(jacobian)
    k = 2 * n - basis.shape[1]
    total = np.sum(np.abs(residuals) ** 2)
    if k < 4 or n < 2 or not total > 0:
        return None

    def neighbors(columns: Array) -> Array:
        """W times columns: the mean of both neighbors, real and imaginary parts apart."""
        halves = columns.reshape(2, n, -1)
        result = np.zeros_like(halves)
        result[:, 1:] += halves[:, :-1] / 2
        result[:, :-1] += halves[:, 1:] / 2
        return result.reshape(columns.shape)

    W_basis = neighbors(basis)
    inner = basis.T @ W_basis
    trace = -np.trace(inner)
    trace_of_square = (n - 1) - 2 * np.sum(W_basis**2) + np.sum(inner**2)  # tr W² = 4 (n - 1) / 4
    r = float(np.sum(residuals[1:] * residuals[:-1].conj()).real / total)
    return r, float(trace / k), float(2 * (trace_of_square - trace**2 / k) / (k * (k + 2)))


def _residuals(part: ResponsePart, values: Array, free: int) -> tuple[ComplexArray, Array]:
    """Return the residuals over their sizes by frequency, (n,), and their derivatives, (2n, free)."""
    data = part.data
    order = np.argsort(data.omega)
    size = np.abs(data.response)
    if data.variance is not None and part.criterion.known_noise:
        size = np.sqrt(data.variance)
    order = order[size[order] > 1e-9 * size.max()]
    sensitivity = part.sensitivity(values)[order, :free] / size[order, None]
    residuals = (part.response(values) - data.response)[order] / size[order]
    return residuals, np.vstack([sensitivity.real, sensitivity.imag])
