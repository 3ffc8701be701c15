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

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from greybox.files.arrays import Array, IntArray
from greybox.statistics.score_test import chance

ORDER = 20
SAMPLES = 8  # of an output for each order
ROUNDING = 1e-12  # of the power
SIGNIFICANT = 0.05
UNCHANGED = 1e-9  # decrease of -2 log likelihood that is rounding alone
# Factors on a smooth term beside errors that drift settle in the third round.
ROUNDS = 3
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
    values = np.column_stack([residuals, fitted, terms])
    values /= np.linalg.norm(values, axis=0) + TINY
    changes = np.zeros_like(values)
    for rows in itertools.chain(*outputs):
        changes[rows[1:]] = np.diff(values[rows], axis=0)
    later = [[rows[1:] for rows in stretches] for stretches in outputs]
    columns = [*range(1 + fitted.shape[1])]
    factors, (base, _) = _score(values[:, columns], outputs)
    _, (base_of_changes, _) = _score(changes[:, columns], later, factors)

    def p_value(without: float, score: float, remaining: int) -> float:
        # A probability near one depends on the root of the decrease, which may be all rounding.
        decrease = max(without - score - UNCHANGED, 0.0)
        left = np.exp(-decrease / sum(map(len, itertools.chain(*outputs))))
        return float(chance(left, max(remaining, 1)))

    p_values = np.ones(terms.shape[1])
    for k in range(terms.shape[1]):
        taken = [*columns, len(columns) + k]
        factors, score = _score(values[:, taken], outputs)
        p_values[k] = p_value(base, *score)
        # The differences can only excuse what looks significant without them.
        if p_values[k] < SIGNIFICANT:
            _, score = _score(changes[:, taken], later, factors)
            p_values[k] = max(p_values[k], p_value(base_of_changes, *score))
    return p_values


def _score(
    values: Array, outputs: Outputs, begin: Array | None = None
) -> tuple[Array, tuple[float, int]]:
    """Return the factors on columns that fit the first of them, -2 log likelihood, and its freedom.

    The errors are those beside the columns: what follows a missing term is an autoregression, too,
    and would leave nothing of the term if the filters came from it. The likelihood has several
    maxima: differences begin at the factors of the samples.
    """
    counts = [sum(map(len, stretches)) for stretches in outputs]
    white, filters, scores = values, list[Array](), list[float]()
    factors = np.zeros(0) if begin is None else begin
    for turn in range(ROUNDS):
        if turn:
            white = whitened(values, filters, outputs)
        if turn or begin is None:
            factors = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
        filters = whitening_filters(values[:, 0] - values[:, 1:] @ factors, outputs)
        scores.append(-2 * float(counts @ np.log([weights[0] for weights in filters])))
    return factors, (min(scores), len(white) - len(factors) - sum(map(len, filters)))


def whitening_filters(residuals: Array, outputs: Outputs) -> list[Array]:
    """Return the filters (q + 1,) that make residuals (N,) white, of unit variance, by output.

    They follow by least squares, which the ends of a record do not disturb.
    """
    filters = []
    for stretches in outputs:
        pieces = [residuals[rows] for rows in stretches]
        total = sum(map(len, pieces))
        # Short stretches would lose all of their samples.
        order = min(ORDER, total // SAMPLES, total // (2 * max(len(pieces), 1)))
        views = [
            sliding_window_view(piece, order + 1)[:, ::-1] for piece in pieces if len(piece) > order
        ]
        windows = np.vstack([np.zeros((0, order + 1)), *views])
        moments = windows.T @ windows / max(len(windows), 1)
        # Residuals without errors have no inverse.
        moments += (ROUNDING * np.trace(moments) + TINY) * np.eye(order + 1)
        weights = np.append(1.0, -np.linalg.solve(moments[1:, 1:], moments[1:, 0]))
        filters.append(weights / np.sqrt(weights @ moments @ weights))
    return filters
