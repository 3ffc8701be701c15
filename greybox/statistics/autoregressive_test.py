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

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from greybox.files.arrays import Array, IntArray
from greybox.statistics.column_space import column_basis, outside
from greybox.statistics.score_test import chance

ORDER = 20
SAMPLES = 8  # of an output for each order
# Share of the power of columns that may be rounding, as errors that are white and independent.
ROUNDING = 1e-12
UNCHANGED = 1e-9  # decrease of -2 log likelihood that is rounding alone
# Factors on a smooth term beside errors that drift settle in up to seven rounds.
ROUNDS = 7
TINY = 1e-300

# For every output: the rows of its measured samples, for each stretch in order of time.
Outputs = Sequence[Sequence[IntArray]]


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
    # Columns that nearly depend on each other would have large factors, and errors of rounding.
    basis = column_basis(fitted)
    # The last term is of zeros: what the residuals are without any.
    values = np.column_stack([residuals, basis, outside(terms, basis), np.zeros(len(residuals))])
    values /= np.linalg.norm(values, axis=0) + TINY
    # Each term is fitted beside the parameters, by columns of its own.
    first = 1 + basis.shape[1]
    fits = np.array([[*range(first), k] for k in range(first, values.shape[1])])
    of_fits = fits[:, :, None], fits[:, None]
    squares = values.T @ values + TINY * np.eye(values.shape[1])
    p_values, factors = list[Array](), _least(squares[of_fits])
    samples = [_products([values[rows] for rows in stretches]) for stretches in outputs]
    for times in range(2):
        # Differences of the samples in a window are a window of one order less.
        products = [
            (n, np.diff(np.diff(sums, times), times, axis=2)[of_fits]) for n, sums in samples
        ]
        # The errors are those beside the columns: what follows a missing term is an autoregression,
        # too, and would leave nothing of the term if the filters came from it. The likelihood has
        # several maxima: differences begin at the factors of the samples.
        filters = [_filters(factors, *pair) for pair in products]
        for _ in range(ROUNDS):
            added = [
                np.einsum("hlm,hijlm->hij", w[:, :, None] * w[:, None], sums)
                for w, (_, sums) in zip(filters, products, strict=True)
            ]
            factors = _least(np.sum(added, axis=0))
            filters = [_filters(factors, *pair) for pair in products]
        counts = [count for count, _ in products]
        *beside, without = np.sum(
            [-2 * n * np.log(w[:, 0]) for n, w in zip(counts, filters, strict=True)], axis=0
        )
        # A probability near one depends on the root of the decrease, which may be all rounding.
        decrease = np.maximum(without - beside - UNCHANGED, 0.0)
        remaining = sum(counts) - first - sum(w.shape[1] for w in filters)
        p_values.append(chance(np.exp(-decrease / sum(counts)), remaining))
    return np.max(p_values, axis=0)


def whitening_filters(residuals: Array, outputs: Outputs) -> list[Array]:
    """Return the filters (q + 1,) that make residuals (N,) white, of unit variance, by output."""
    products = [_products([residuals[rows, None] for rows in stretches]) for stretches in outputs]
    return [_filters(np.ones((1, 1)), n, sums[None])[0] for n, sums in products]


def _products(pieces: Sequence[Array]) -> tuple[int, Array]:
    """Return the number of windows of pieces (n, c), and the sums (c, c, q + 1, q + 1) of products.

    Windows are of q + 1 samples, the last one first. Sums are the Toeplitz ones of pieces between
    zeros, less the products of windows that have such zeros.
    """
    total, columns = sum(map(len, pieces)), pieces[0].shape[1]
    # Short stretches would lose all of their samples.
    order = max(min(ORDER, total // SAMPLES, total // (2 * len(pieces))), 1)
    lags = np.arange(order + 1)
    count, sums = 0, np.zeros((columns, columns, order + 1, order + 1))
    for piece in filter(len, pieces):
        n = len(piece)
        padded = np.pad(piece, ((order, order), (0, 0)))
        by_lag = (sliding_window_view(padded[:-order], n, axis=0) @ piece).T
        by_lag = np.concatenate([by_lag.swapaxes(0, 1), by_lag[..., -2::-1]], axis=2)
        windows = sliding_window_view(padded, order + 1, axis=0)[..., ::-1]
        ends = np.delete(windows, slice(order, n), axis=0)
        sums += by_lag[..., order + lags - lags[:, None]]
        sums -= np.tensordot(ends, ends, (0, 0)).swapaxes(1, 2)
        count += max(n - order, 0)
    # What is predicted exactly would have no filter, and leave rounding errors alone.
    errors = ROUNDING * np.diag(sums[..., 0, 0]) + TINY
    return count, sums + np.diag(errors)[..., None, None] * np.eye(order + 1)


def _filters(factors: Array, count: int, sums: Array) -> Array:
    """Return filters (h, q + 1) of columns by factors (h, k).

    They follow by least squares, which the ends of a record do not disturb.
    """
    moments = np.einsum("hij,hijlm->hlm", factors[:, :, None] * factors[:, None], sums)
    weights = _least(moments)
    squares = np.einsum("hl,hlm,hm->h", weights, moments, weights)[:, None]
    return weights / np.sqrt(squares / max(count, 1))


def _least(squares: Array) -> Array:
    """Return factors (h, n) with the least `squares` (h, n, n), one on the first column."""
    others = -np.linalg.solve(squares[:, 1:, 1:], squares[:, 1:, :1])[..., 0]
    return np.insert(others, 0, 1.0, axis=1)
