"""A likelihood-ratio test of terms that a model may lack, with autoregressive errors.

A missing term makes the residuals drift, and errors that drift hide the term. A spectrum of the
residuals would contain the effect of the term, so that a test with this spectrum would detect
little. Here the errors are an autoregression. Its coefficients are estimated without the term and
again with it, and the term must reduce the residuals by more than it could by chance.

Two cases need more care:

- If errors drift through the whole record, an estimated autoregression decays too fast, and a slow
  term would look significant. The test therefore uses the differences of the samples, whose drift
  is short.
- An autoregression contains only the last few samples. If gusts move a vehicle slowly, and less
  than the noise of its sensors, many samples would have to be averaged. If the term is slow enough,
  means of several samples are therefore tested as well, and the larger probability counts.

Process noise reaches several outputs, where it can look like one term. Their errors are then not
independent, so that their log-likelihoods must not simply be added.

Sources: Cochrane and Orcutt (1949), Application of least squares regression to relationships
containing auto-correlated error terms, Journal of the American Statistical Association 44;
Vogelsang (1999), Sources of nonmonotonic power when testing for a shift in mean of a dynamic time
series, Journal of Econometrics 88.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from greybox.data.files.arrays import Array, IntArray
from greybox.statistics.beta_share import chance
from greybox.statistics.column_space import column_basis, outside

# Highest order of an autoregression.
ORDER = 20
# Fewest samples of an output for each order. With 8, right models of 60 samples, with a correlation
# of neighboring errors of 0.9, were called wrong in 7 % of fits.
SAMPLES = 15
# Share of the power of columns that may be rounding, which is treated as white noise.
ROUNDING = 1e-12
# Share of the power of errors that no term can explain, because terms are linearized and have
# simple forms. An autoregression predicts smooth residuals down to their noise. If the noise were
# smaller than this share, it would predict them equally well with and without the missing term.
INEXACT = 1e-5
# Samples in a mean. Means of 16 would excuse few more right models, and more wrong ones.
MEANS = 4
TINY = 1e-300

# For every output, and every stretch of it: the rows of its measured samples in order of time.
Outputs = Sequence[Sequence[IntArray]]


def whitened(values: Array, filters: Sequence[Array], outputs: Outputs) -> Array:
    """Return rows (M, c) of values (N, c), less their prediction from the samples before them.

    There is a filter (q + 1,) for every output. Each stretch loses its first q rows.
    """
    pieces = [values[:0]]
    for weights, stretches in zip(filters, outputs, strict=True):
        for rows in stretches:
            # Nothing remains of a stretch that is shorter than the filter.
            if len(rows) >= len(weights):
                windows = sliding_window_view(values[rows], len(weights), axis=0)
                pieces.append(windows @ weights[::-1])
    return np.vstack(pieces)


def _shared(columns: Array, filters: Sequence[Array], outputs: Outputs, width: int) -> Array:
    """Return the factors (c,) by which common errors of outputs raise the variances of terms.

    The columns (N, 1 + c) are the errors and the terms. The filters make the errors of every output
    white, but process noise reaches several outputs, some of them later.
    """
    signals = np.zeros(columns.T.shape)
    # The rows that the filters leave: each stretch loses its first ones.
    remaining = []
    for weights, stretches in zip(filters, outputs, strict=True):
        remaining += [rows[len(weights) - 1 :] for rows in stretches]
    signals[:, np.concatenate(remaining)] = whitened(columns, filters, outputs).T
    # Rows of one moment stand together: (1 + c, moments, outputs).
    signals = signals.reshape(len(signals), -1, width)
    # One more signal marks the measured errors, so that products of it count the pairs.
    signals = np.append(signals, signals[:1] != 0, axis=0)
    terms = signals[1:-1]
    shared = 0.0
    for lag in range(min(ORDER + 1, signals.shape[1])):
        # Products of every output with every later one.
        products = signals[:, lag:].mT @ signals[:, : signals.shape[1] - lag]
        counts = np.maximum(products[-1], 1)
        # Only between different outputs.
        covariances = (1 - np.eye(width)) * products[0] / counts
        # Either output may be the later one.
        weight = 2 if lag else 1
        shared += weight * np.tensordot(products[1:-1], covariances)
    return 1 + np.maximum(shared / np.sum(terms**2, axis=(1, 2)), 0.0)


def autoregressive_p_values(
    residuals: Array,
    fitted: Array,
    terms: Array,
    outputs: Outputs,
    width: int = 1,
    lost: int = 0,
    sizes: Sequence[int] = (),
) -> Array:
    """Return the probabilities (c,) that terms explain so much of the residuals by chance.

    Parameters
    ----------
    residuals : (N,) array
    fitted : (N, p) array
        Columns that the fit has removed from the residuals.
    terms : (N, c) array
        The changes of the model's outputs by terms with a factor of one.
    outputs : sequence of sequences of (n,) arrays of int
        See `Outputs`.
    width : int
        Number of outputs whose errors may be correlated: as many neighboring rows are of one
        moment.
    lost : int
        Degrees of freedom that all columns have lost, for example by initial states.
    sizes : sequence of (t,) int
        Numbers of neighboring terms that are tested together. The result is then (t,), one
        probability for each group. Without them, each term is tested by itself.
    """
    # With an orthogonal basis, nearly dependent columns have no large factors and rounding errors.
    basis = column_basis(fitted)
    values = np.column_stack([residuals, basis, outside(terms, basis)])
    values /= np.linalg.norm(values, axis=0) + TINY
    # Columns before the terms: residuals and parameters.
    first = 1 + basis.shape[1]
    size = np.array(sizes or [1] * terms.shape[1], dtype=int)
    # Every fit has the parameters. Each of the first fits has one group of terms, the last none.
    tests = np.repeat(np.eye(len(size) + 1, len(size)), size, axis=1)
    used_columns = np.hstack([np.ones((len(tests), first)), tests])
    # Pairs of columns whose products each fit needs.
    used = used_columns[..., None] * used_columns[:, None]

    counts, filters, factors = _fits(values, outputs, used, m=1, times=1)
    # From filters of differences to filters of samples.
    weights = [np.convolve(w[-1], [1.0, -1.0]) for w in filters]
    columns = np.column_stack([values @ factors[-1], values[:, first:]])
    shared = tests[:-1] @ _shared(columns, weights, outputs, width) / size

    def p_values(counts: Sequence[int], filters: Sequence[Array]) -> Array:
        """Return the probabilities of all tests from the filters of all fits."""
        scores = -2 * np.array(counts) @ np.log([w[:, 0] for w in filters])
        # A probability near one depends on the root of the decrease, which may be all rounding,
        # 1e-9.
        decrease = np.maximum(scores[-1] - scores[:-1] - 1e-9, 0.0) / shared
        remaining = sum(counts) - lost - first - sum(w.shape[1] for w in filters) + 1 - size
        return chance(np.exp(-decrease / sum(counts)), remaining, size)

    p_of_samples = p_values(counts, filters)
    # With few samples, an autoregression of means would contain no more of the past.
    fewest = min(sum(len(rows) // MEANS for rows in stretches) for stretches in outputs)
    m = MEANS if MEANS * fewest > ORDER * SAMPLES else 1
    counts, filters, _ = _fits(values, outputs, used, m, times=0)
    p_of_means = p_values(counts, filters)

    # A term is slow if its means keep half of its power, else they would show too little of it.
    # With 0.9 in place of 0.5, errors that oscillate slowly, beneath white noise, were called terms
    # in 4 % of tests with p < 0.001.
    white = whitened(values[:, first:], weights, outputs)
    power = tests[:-1] @ np.sum(white**2, axis=0)
    power_of_means = tests[:-1] @ (m * np.sum(_means(white, m) ** 2, axis=0))
    is_slow = power_of_means > 0.5 * power
    return np.where(is_slow, np.maximum(p_of_samples, p_of_means), p_of_samples)


def _fits(
    values: Array, outputs: Outputs, used: Array, m: int, times: int
) -> tuple[Sequence[int], Sequence[Array], Array]:
    """Return the numbers of samples and the filters of all outputs, and the factors of fits.

    Factors and filters are estimated together. The effect of a missing term is an autoregression,
    too, and filters from residuals with this effect would remove the term.

    Parameters
    ----------
    values : (N, n) array
        Residuals, then other columns.
    outputs : see `Outputs`
    used : (h, n, n) array
        Pairs of columns that each of the h fits has.
    m : int
        Number of samples in a mean.
    times : 0 or 1
        How often differences are taken of the means.

    Returns
    -------
    counts : sequence of int
        Number of windows of each output.
    filters : sequence of (h, q + 1) arrays
        For each output.
    factors : (h, n) array
        One for the residuals; zero for columns that a fit does not have.
    """
    # Pairs of columns that no fit has, such as two terms, would take most of the time.
    i, j = np.nonzero(used.any(axis=0))
    counts = []
    sums = []
    for stretches in outputs:
        count, products = _products([_means(values[rows], m) for rows in stretches])
        products[0, 0] += INEXACT * products[0, 0, 0, 0] * np.eye(products.shape[-1])
        counts.append(count)
        # Differences of the samples in a window are a window of one order less.
        sums.append(np.diff(np.diff(products[i, j], times), times, axis=1))

    def filters_for(factors: Array) -> list[Array]:
        """Return the filters of all outputs at factors (h, n)."""
        pairs = factors[:, i] * factors[:, j]
        return [
            _filters(pairs, count, products) for count, products in zip(counts, sums, strict=True)
        ]

    factors = _least(values.T @ values + TINY * np.eye(values.shape[1]), used)
    squares = np.zeros(used.shape)
    # The factor of a smooth term, with errors that drift, converges in at most seven rounds.
    for _ in range(7):
        added = []
        for products, weights in zip(sums, filters_for(factors), strict=True):
            pairs = weights[..., None] * weights[:, None]
            added.append(np.tensordot(pairs, products, ((1, 2), (1, 2))))
        squares[:, i, j] = np.sum(added, axis=0)
        earlier, factors = factors, _least(squares, used)
        # Near its maximum, the likelihood changes with the square of a change of the factors.
        if np.allclose(factors, earlier, atol=1e-4):
            break
    return counts, filters_for(factors), factors


def _means(values: Array, m: int) -> Array:
    """Return the means (n // m, c) of every m neighboring rows of values (n, c)."""
    count = len(values) // m
    return values[: count * m].reshape(count, m, values.shape[1]).mean(axis=1)


def whitening_filters(residuals: Array, outputs: Outputs) -> list[Array]:
    """Return the filter (q + 1,) of every output that makes its residuals white, of unit variance.

    `residuals` (N,) are those of all outputs.
    """
    filters = []
    for stretches in outputs:
        count, sums = _products([residuals[rows, None] for rows in stretches])
        filters.append(_filters(np.ones((1, 1)), count, sums[0])[0])
    return filters


def _products(pieces: Sequence[Array]) -> tuple[int, Array]:
    """Return the number of windows in pieces (n, c), and the sums of their products.

    A window has q + 1 samples, the last one first. The sums are (c, c, q + 1, q + 1), for every
    pair of columns and of samples in a window. They are computed as the Toeplitz matrices of pieces
    that are padded with zeros, less the products of windows that contain such zeros.
    """
    total = sum(map(len, pieces))
    columns = pieces[0].shape[1]
    # With a higher order, short stretches would lose all of their samples.
    order = max(min(ORDER, total // SAMPLES, total // (2 * len(pieces))), 1)
    lags = np.arange(order + 1)
    width = columns * (order + 1)
    count = 0
    by_lag = np.zeros((order + 1, columns, columns))
    ends: list[Array] = []
    for piece in pieces:
        n = len(piece)
        padded = np.pad(piece, ((order, order), (0, 0)))
        by_lag += sliding_window_view(padded[:-order], n, axis=0) @ piece
        windows = sliding_window_view(padded, order + 1, axis=0)[..., ::-1]
        ends.append(np.delete(windows, slice(order, n), axis=0).reshape(-1, width))
        count += max(n - order, 0)
    # The products of all lags, from -order to order, are the diagonals of the matrices.
    both_signs = np.concatenate([by_lag.T.swapaxes(0, 1), by_lag.T[..., -2::-1]], axis=2)
    sums = both_signs[..., order + lags - lags[:, None]]
    outer = np.vstack(ends)
    # In this form, as the product of a matrix with itself, it takes half of the time.
    sums -= (outer.T @ outer).reshape(columns, order + 1, columns, -1).swapaxes(1, 2)
    # A small white noise is added: the filter of a column that is predicted exactly would be
    # undefined, and leave only rounding errors.
    errors = ROUNDING * np.diag(sums[..., 0, 0]) + TINY
    return count, sums + np.diag(errors)[..., None, None] * np.eye(order + 1)


def _filters(factors: Array, count: int, sums: Array) -> Array:
    """Return the filters (h, q + 1) by least squares, which the ends of a record do not disturb.

    `sums` (m, q + 1, q + 1) are products of m pairs of columns, `factors` (h, m) those of the
    pairs, and `count` is the number of windows.
    """
    moments = np.tensordot(factors, sums, 1)
    weights = _least(moments)
    squares = weights[:, None] @ moments @ weights[..., None]
    return weights / np.sqrt(squares[:, 0] / max(count, 1))


def _least(squares: Array, used: Any = True) -> Array:
    """Return the factors f (h, n), with one for the first column, that minimize f' squares f.

    `squares` are (h, n, n) or (n, n). Where `used` (h, n, n) is zero, factors of columns are zero.
    """
    squares = np.where(used, squares, np.eye(squares.shape[-1]))
    others = -np.linalg.solve(squares[:, 1:, 1:], squares[:, 1:, :1])[..., 0]
    return np.hstack([np.ones((len(others), 1)), others])
