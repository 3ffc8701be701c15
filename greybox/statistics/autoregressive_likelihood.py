"""Whether records lack a term: the likelihood with and without it, with autoregressive errors.

A term that is missing makes the residuals drift, and errors that drift hide the term. A spectrum of
such residuals contains what the term left in them, so that a test with this spectrum sees little.
Here the errors are an autoregression whose coefficients are estimated without the term and again
with it: the term must shorten the residuals by more than it could by chance.

An estimated autoregression is too short-lived if the errors drift through the whole record, and a
slow term would then look significant. So the differences of the samples are tested, for which such
a drift is short. And it reaches back by few samples: where gusts move a vehicle slowly, beneath the
noise of its sensors, the past of many samples would have to be averaged. So means of some samples
are tested, too, if the term is slow enough: the larger probability counts.

Process noise reaches several outputs, in which it can look like one term. Their errors are then not
independent, and their log-likelihoods must not be added.

Sources: Cochrane and Orcutt (1949), Application of least squares regression to relationships
containing auto-correlated error terms, Journal of the American Statistical Association 44;
Vogelsang (1999), Sources of nonmonotonic power when testing for a shift in mean of a dynamic time
series, Journal of Econometrics 88.
"""

from collections.abc import Iterator, Sequence
from itertools import repeat
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from greybox.data.files.arrays import Array, IntArray
from greybox.statistics.beta_share import chance
from greybox.statistics.column_space import column_basis, outside

ORDER = 20
# Samples of an output for each order. With 8, right models of 60 samples were called wrong in 7 %
# of fits where neighboring errors correlate by 0.9.
SAMPLES = 15
# Share of the power of columns that may be rounding, as errors that are white and independent.
ROUNDING = 1e-12
# Share of the power of errors that terms cannot explain: they are linearized and have simple forms.
# An autoregression predicts smooth residuals down to their noise. Where that is less, it would
# predict them as well without the term that is missing as with it.
INEXACT = 1e-5
# Samples in a mean. Means of 16 would excuse few more right models, and more wrong ones.
MEANS = 4
TINY = 1e-300

# For every output: the rows of its measured samples, for each stretch in order of time.
Outputs = Sequence[Sequence[IntArray]]


def whitened(values: Array, filters: Sequence[Array], outputs: Outputs) -> Array:
    """Return rows (M, c) of values (N, c) less what the samples before them predict.

    Each stretch loses as many rows at its beginning as its filter (q + 1,) has orders.
    """
    pieces = [values[:0]]
    for weights, stretches in zip(filters, outputs, strict=True):
        for rows in stretches:
            # A stretch that is shorter than the filter leaves nothing.
            if len(rows) >= len(weights):
                windows = sliding_window_view(values[rows], len(weights), axis=0)
                pieces.append(windows @ weights[::-1])
    return np.vstack(pieces)


def _shared(columns: Array, filters: Sequence[Array], outputs: Outputs, width: int) -> Array:
    """Return by how much errors that outputs share raise the variances (c,) of factors on terms.

    The columns (N, 1 + c) are those of the errors and of the terms. The filters make the errors of
    every output white, but process noise reaches several outputs, some of them later.
    """
    signals = np.zeros(columns.T.shape)
    # The rows that the filters leave: each stretch loses its first ones.
    remaining = []
    for weights, stretches in zip(filters, outputs, strict=True):
        remaining += [rows[len(weights) - 1 :] for rows in stretches]
    signals[:, np.concatenate(remaining)] = whitened(columns, filters, outputs).T
    signals = signals.reshape(len(signals), -1, width)
    signals = np.append(signals, signals[:1] != 0, axis=0)
    terms, shared = signals[1:-1], 0.0
    for lag in range(min(ORDER + 1, signals.shape[1])):
        sums = signals[:, lag:].mT @ signals[:, : signals.shape[1] - lag]
        covariances = (1 - np.eye(width)) * sums[0] / np.maximum(sums[-1], 1)
        # Either output may be the later one.
        shared += (2 if lag else 1) * np.tensordot(sums[1:-1], covariances)
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
    """Return the probabilities (c,) that terms (N, c) explain so much of errors by chance.

    Parameters
    ----------
    residuals : (N,) array
    fitted : (N, p) array
        What the fit may have taken from them.
    terms : (N, c) array
        What unit terms would add to the model's outputs.
    outputs : sequence of sequences of (n,) arrays of int
    width : int
        Number of neighboring rows of one moment, each of another output, whose errors may be
        correlated.
    lost : int
        Degrees of freedom that all columns have lost, such as by initial states.
    sizes : sequence of (t,) int
        Numbers of neighboring terms that are tested together, which then have one probability, (t,)
        in all. Without them, each term is tested by itself.
    """
    # Columns that nearly depend on each other would have large factors, and errors of rounding.
    basis = column_basis(fitted)
    values = np.column_stack([residuals, basis, outside(terms, basis)])
    values /= np.linalg.norm(values, axis=0) + TINY
    # Each test is fitted with the parameters, without the others; the last fit has no term.
    first, size = 1 + basis.shape[1], np.array(sizes or [1] * terms.shape[1], dtype=int)
    tests = np.repeat(np.eye(len(size) + 1, len(size)), size, axis=1)
    used = np.hstack([np.ones((len(tests), first)), tests])
    used = used[..., None] * used[:, None]

    counts, filters, factors = _fits(values, outputs, used, m=1, times=1)
    # Filters of differences, as filters of samples.
    weights = [np.convolve(w[-1], [1.0, -1.0]) for w in filters]
    columns = np.column_stack([values @ factors[-1], values[:, first:]])
    shared = tests[:-1] @ _shared(columns, weights, outputs, width) / size

    def p_values(counts: Sequence[int], filters: Sequence[Array]) -> Array:
        scores = -2 * np.array(counts) @ np.log([w[:, 0] for w in filters])
        # A probability near one depends on the root of the decrease, which may be all rounding,
        # 1e-9.
        decrease = np.maximum(scores[-1] - scores[:-1] - 1e-9, 0.0) / shared
        remaining = sum(counts) - lost - first - sum(w.shape[1] for w in filters) + 1 - size
        return chance(np.exp(-decrease / sum(counts)), remaining, size)

    p_of_samples = p_values(counts, filters)
    # Where samples are few, an autoregression of means does not reach further back.
    fewest = min(sum(len(rows) // MEANS for rows in stretches) for stretches in outputs)
    m = MEANS if MEANS * fewest > ORDER * SAMPLES else 1
    white = whitened(values[:, first:], weights, outputs)
    kept, whole = (tests[:-1] @ (k * np.sum(_means(white, k) ** 2, axis=0)) for k in (m, 1))
    p_of_means = p_values(*_fits(values, outputs, used, m, times=0)[:2])
    # Of a faster term, means would show too little. With a limit of 0.9, errors that oscillate
    # slowly beneath white noise were called terms in 4 % of tests with p < 0.001.
    return np.where(kept > 0.5 * whole, np.maximum(p_of_samples, p_of_means), p_of_samples)


def _fits(
    values: Array, outputs: Outputs, used: Array, m: int, times: int
) -> tuple[Sequence[int], Sequence[Array], Array]:
    """Return the numbers of samples, the filters, and the factors (h, n) of fits of values (N, n).

    They are fits of the means of `m` samples, or of their differences, `times` one. The errors are
    fitted together with the columns: the effect of a missing term is an autoregression, too, and
    filters that contained it would leave nothing of the term.
    """
    counts, whole = zip(
        *[_products([_means(values[rows], m) for rows in stretches]) for stretches in outputs],
        strict=True,
    )
    for each in whole:
        each[0, 0] += INEXACT * each[0, 0, 0, 0] * np.eye(each.shape[-1])
    # Pairs of columns that no fit has, such as two terms, would take most of the time.
    i, j = np.nonzero(used.any(axis=0))
    # Differences of the samples in a window are a window of one order less.
    sums = [np.diff(np.diff(each[i, j], times), times, axis=1) for each in whole]
    squares = np.zeros(used.shape)
    factors = _least(values.T @ values + TINY * np.eye(values.shape[1]), used)

    def filters() -> Iterator[Array]:
        return map(_filters, repeat(factors[:, i] * factors[:, j]), counts, sums)

    # Factors on a smooth term, fitted with errors that drift, converge in up to seven rounds.
    for _ in range(7):
        added = [
            np.tensordot(w[..., None] * w[:, None], each, ((1, 2), (1, 2)))
            for each, w in zip(sums, filters(), strict=True)
        ]
        squares[:, i, j] = np.sum(added, axis=0)
        earlier, factors = factors, _least(squares, used)
        # At a maximum, the likelihood changes with the square of a change of the factors.
        if np.allclose(factors, earlier, atol=1e-4):
            break
    return counts, [*filters()], factors


def _means(values: Array, m: int) -> Array:
    """Return the means (n // m, c) of m neighboring rows of values (n, c) each."""
    count = len(values) // m
    return values[: count * m].reshape(count, m, values.shape[1]).mean(axis=1)


def whitening_filters(residuals: Array, outputs: Outputs) -> list[Array]:
    """Return the filters (q + 1,) that make residuals (N,) white, of unit variance, by output."""
    return [
        _filters(np.ones((1, 1)), count, sums[0])[0]
        for count, sums in [_products([residuals[rows, None] for rows in s]) for s in outputs]
    ]


def _products(pieces: Sequence[Array]) -> tuple[int, Array]:
    """Return the number of windows of pieces (n, c), and the sums (c, c, q + 1, q + 1) of products.

    Windows are of q + 1 samples, the last one first. Sums are the Toeplitz ones of pieces between
    zeros, less the products of windows that have such zeros.
    """
    total, columns = sum(map(len, pieces)), pieces[0].shape[1]
    # Short stretches would lose all of their samples.
    order = max(min(ORDER, total // SAMPLES, total // (2 * len(pieces))), 1)
    lags = np.arange(order + 1)
    count, width = 0, columns * (order + 1)
    by_lag, ends = np.zeros((order + 1, columns, columns)), list[Array]()
    for piece in pieces:
        n = len(piece)
        padded = np.pad(piece, ((order, order), (0, 0)))
        by_lag += sliding_window_view(padded[:-order], n, axis=0) @ piece
        windows = sliding_window_view(padded, order + 1, axis=0)[..., ::-1]
        ends.append(np.delete(windows, slice(order, n), axis=0).reshape(-1, width))
        count += max(n - order, 0)
    both = np.concatenate([by_lag.T.swapaxes(0, 1), by_lag.T[..., -2::-1]], axis=2)
    sums = both[..., order + lags - lags[:, None]]
    outer = np.vstack(ends)
    # The product of a matrix with itself takes half of the time.
    sums -= (outer.T @ outer).reshape(columns, order + 1, columns, -1).swapaxes(1, 2)
    # What is predicted exactly would have no filter, and leave rounding errors alone.
    errors = ROUNDING * np.diag(sums[..., 0, 0]) + TINY
    return count, sums + np.diag(errors)[..., None, None] * np.eye(order + 1)


def _filters(factors: Array, count: int, sums: Array) -> Array:
    """Return filters (h, q + 1) by factors (h, m) on sums (m, q + 1, q + 1) of products of columns.

    They follow by least squares, which the ends of a record do not disturb.
    """
    moments = np.tensordot(factors, sums, 1)
    weights = _least(moments)
    squares = weights[:, None] @ moments @ weights[..., None]
    return weights / np.sqrt(squares[:, 0] / max(count, 1))


def _least(squares: Array, used: Any = True) -> Array:
    """Return factors (h, n) with the least `squares` (h, n, n), one on the first column.

    The factors of columns other than the `used` ones (h, n, n) are zero.
    """
    squares = np.where(used, squares, np.eye(squares.shape[-1]))
    others = -np.linalg.solve(squares[:, 1:, 1:], squares[:, 1:, :1])[..., 0]
    return np.hstack([np.ones((len(others), 1)), others])
