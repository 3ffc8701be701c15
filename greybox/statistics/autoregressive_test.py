"""Whether records lack a term: the likelihood with and without it, with autoregressive errors.

A term that is missing makes the residuals drift, and errors that drift hide the term. A spectrum of
such residuals contains what the term left in them, so that a test with this spectrum sees little.
Here the errors are an autoregression whose coefficients are estimated without the term and again
with it: the term must shorten the residuals by more than it could by chance.

An estimated autoregression is too short-lived if the errors drift through the whole record, and a
slow term would then look significant. So the differences of the samples are tested, too, for which
such a drift is short: the larger probability counts.

Sources: Cochrane and Orcutt (1949), Application of least squares regression to relationships
containing auto-correlated error terms, Journal of the American Statistical Association 44;
Vogelsang (1999), Sources of nonmonotonic power when testing for a shift in mean of a dynamic time
series, Journal of Econometrics 88.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from greybox.files.arrays import Array, IntArray
from greybox.statistics.score_test import chance

ORDER = 20
SAMPLES = 8  # of an output for each order
ROUNDING = 1e-12  # of the power
UNCHANGED = 1e-9  # decrease of -2 log likelihood that is rounding alone
# Factors on a smooth term beside errors that drift settle in the third round.
ROUNDS = 3
TINY = 1e-300

# For every output: the rows of its measured samples, for each stretch in order of time.
Outputs = Sequence[Sequence[IntArray]]
# Number of windows of samples, and the sums of products in them.
Products = tuple[int, Array]


def whitened(values: Array, filters: Sequence[Array], outputs: Outputs) -> Array:
    """Return rows (M, c) of values (N, c) less what the samples before them predict.

    Each stretch loses as many rows at its beginning as its filter (q + 1,) has orders.
    """
    pieces = [
        sliding_window_view(values[rows], len(weights), axis=0) @ weights[::-1]
        for weights, stretches in zip(filters, outputs, strict=True)
        for rows in stretches
        if len(rows) >= len(weights)
    ]
    return np.vstack([values[:0], *pieces])


def autoregressive_p_values(
    residuals: Array, fitted: Array, terms: Array, outputs: Outputs
) -> Array:
    """Return the probabilities (c,) that terms (N, c) explain so much of errors by chance.

    Parameters
    ----------
    residuals : (N,) array
    fitted : (N, p) array
        What the fit may have taken from them.
    terms : (N, c) array
        What unit terms would add to the model's outputs.
    outputs : sequence of sequence of (n,) arrays of int
    """
    values = np.column_stack([residuals, fitted, terms])
    values /= np.linalg.norm(values, axis=0) + TINY
    pieces = [[values[rows] for rows in stretches] for stretches in outputs]
    differences = [[np.diff(piece, axis=0) for piece in stretches] for stretches in pieces]
    # Each term is fitted beside the parameters; at last, these alone are.
    taken = np.zeros((terms.shape[1] + 1, values.shape[1]))
    taken[:, 1 : -terms.shape[1]] = 1.0
    taken[:, -terms.shape[1] :] = np.eye(*taken[:, -terms.shape[1] :].shape)
    p_values, factors = [], None
    for samples in (pieces, differences):
        products = [*map(_products, samples)]
        factors, scores = _scores(products, taken, factors)
        # A probability near one depends on the root of the decrease, which may be all rounding.
        decrease = np.maximum(scores[-1] - scores[:-1] - UNCHANGED, 0.0)
        count = sum(number for number, _ in products)
        remaining = count - np.sum(taken[0]) - sum(math.isqrt(len(sums)) for _, sums in products)
        p_values.append(chance(np.exp(-decrease / count), max(remaining, 1)))
    return np.max(p_values, axis=0)


def _scores(products: Sequence[Products], taken: Array, begin: Array | None) -> tuple[Array, Array]:
    """Return the factors (h, c) on columns that leave least, and -2 log likelihood (h,).

    The first column has the residuals; those `taken` (h, c) are fitted to it. The errors are those
    beside them: what follows a missing term is an autoregression, too, and would leave nothing of
    the term if the filters came from it. The likelihood has several maxima: differences begin at
    the factors of the samples.
    """
    filters, scores, factors = [np.eye(1, math.isqrt(len(sums))) for _, sums in products], [], begin
    for turn in range(ROUNDS):
        if turn or factors is None:
            pairs = zip(filters, products, strict=True)
            normal = sum(_squares(w) @ sums for w, (_, sums) in pairs).reshape(
                -1, *2 * taken.shape[1:]
            )
            fitted = _regular(normal * taken[:, None] * taken[..., None])
            factors = (
                np.eye(1, len(taken[0]))
                - np.linalg.solve(fitted, normal[..., :1] * taken[..., None])[..., 0]
            )
        filters = [_filters(count, _squares(factors) @ sums.T) for count, sums in products]
        scores.append(
            -2
            * sum(
                count * np.log(weights[:, 0])
                for weights, (count, _) in zip(filters, products, strict=True)
            )
        )
    return factors, np.min(scores, axis=0)


def whitening_filters(residuals: Array, outputs: Outputs) -> list[Array]:
    """Return the filters (q + 1,) that make residuals (N,) white, of unit variance, by output."""
    pieces = [[residuals[rows, None] for rows in stretches] for stretches in outputs]
    return [_filters(count, sums.T)[0] for count, sums in map(_products, pieces)]


def _products(pieces: Sequence[Array]) -> Products:
    """Return the number of windows of pieces (n, c), and the sums of products of their samples.

    Sums ((q + 1)², c²) over windows of q + 1 samples, the last one first, are the Toeplitz ones of
    pieces between zeros, less the products of windows that have such zeros.
    """
    total, columns = sum(map(len, pieces)), pieces[0].shape[1]
    # Short stretches would lose all of their samples.
    order = min(ORDER, total // SAMPLES, total // (2 * max(len(pieces), 1)))
    lags = np.arange(order + 1)
    count, sums = 0, np.zeros((order + 1, order + 1, columns, columns))
    for piece in pieces:
        if (n := len(piece)) > order:
            count += n - order
            by_lag = np.array([piece[lag:].T @ piece[: n - lag] for lag in lags])
            both = np.concatenate([by_lag[:0:-1].swapaxes(1, 2), by_lag])
            padded = np.pad(piece, ((order, order), (0, 0)))
            windows = sliding_window_view(padded, order + 1, axis=0)[..., ::-1]
            ends = np.concatenate([windows[:order], windows[n:]])
            sums += both[order + lags - lags[:, None]]
            sums -= np.tensordot(ends, ends, (0, 0)).transpose(1, 3, 0, 2)
    return count, sums.reshape(len(lags) ** 2, -1)


def _filters(count: int, moments: Array) -> Array:
    """Return weights (h, q + 1) of least squares, which the ends of a record do not disturb."""
    orders = math.isqrt(moments.shape[1])
    moments = _regular(moments.reshape(-1, orders, orders) / max(count, 1))
    weights = -np.linalg.solve(moments[:, 1:, 1:], moments[:, 1:, :1])[..., 0]
    weights = np.insert(weights, 0, 1.0, axis=1)
    return weights / np.sqrt(np.einsum("hl,hlm,hm->h", weights, moments, weights))[:, None]


def _squares(values: Array) -> Array:
    """Return the products (h, n²) of all pairs of values (h, n)."""
    return np.einsum("hi,hj->hij", values, values).reshape(len(values), -1)


def _regular(matrices: Array) -> Array:
    """Return symmetric matrices (h, n, n) that have an inverse: residuals may have no errors."""
    diagonal = np.einsum("hii->hi", matrices)
    return matrices + np.eye(matrices.shape[1]) * (ROUNDING * diagonal + TINY)[:, None]
