"""Whether residuals follow terms that a fitted model does not have: score tests, without a fit.

The residuals are regressed on what each term would add to the model, after both have lost what the
fitted parameters can take. All are whitened before, so that colored noise is not called misfit.
The share of the residuals that a term takes has a beta distribution if they are noise. For records
these tests rank the terms; `autoregressive_test` has their probabilities.

Sources: Rao (1948), Large sample tests of statistical hypotheses, Mathematical Proceedings of the
Cambridge Philosophical Society 44; Breusch and Pagan (1980), The Lagrange multiplier test and its
applications to model specification in econometrics, Review of Economic Studies 47.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.files.arrays import Array, of_diagonal
from greybox.statistics.column_space import column_basis, outside

# Share of the length of a term that must remain beside the parameters: less is an error of the
# integration, or the effect of another parameter.
REMAINS = 0.01
FEWEST = 6.0  # numbers beyond those that the parameters take

ROUNDING = 1e-12  # of products of columns

# Correlations of neighbors that are tried, each with equal errors.
CORRELATIONS = np.tanh(np.linspace(0.0, 2.5, 20))
# Errors of independent points that are larger or smaller beyond a share of the points.
RATIOS = (0.1, 0.3, 3.0, 10.0)
SHARES = np.arange(1, 6) / 6
# Powers of frequency by which errors fall: none, then those of a gust through up to two lags.
POWERS = np.array([0, 1, 2, 4, 6])[:, None, None]


def score_tests(residuals: Array, fitted: Array, terms: Array, remains: float = REMAINS) -> Array:
    """Test c terms one by one.

    Returns
    -------
    (4, c) array
        The decrease of the sum of squares by each term, over their mean; the probability by chance
        of such a share, NaN where it cannot be decided; the factor on each term that a fit would
        estimate, to first order, and its standard error if the model then explains the data.

    Parameters
    ----------
    residuals : (N,) array
        White if they are noise.
    fitted : (N, p) array
        What the fit can absorb of them.
    terms : (N, c) array
        What unit terms would add to the model's outputs.
    remains : float
        Share of the length of a term that must remain beside the parameters.
    """
    basis = column_basis(fitted)
    residuals = outside(residuals, basis)
    before, terms = np.linalg.norm(terms, axis=0), outside(terms, basis)
    length = np.linalg.norm(terms, axis=0)
    is_new = length > remains * before
    length[~is_new] = 1.0

    count = len(residuals)
    remaining = count - basis.shape[1]
    squares = float(residuals @ residuals)
    along = np.where(is_new, residuals @ terms / length, 0.0)
    share = np.minimum(along**2 / max(squares, np.finfo(float).tiny), 1 - 1e-12)
    tested = is_new & (remaining > FEWEST) & (squares > 0)
    error = np.sqrt(squares * (1 - share) / max(remaining, 1)) / length
    value = along / length
    p_value = np.where(tested, chance(1 - share, max(remaining - 1, 1)), np.nan)
    return np.array([count * share, p_value, value, error])


def correlated_score(blocks: Sequence[tuple[Array, Array, Sequence[int]]]) -> tuple[float, int]:
    """Return -2 log likelihood of residuals, and the rank of what a fit can absorb.

    Errors may be correlated, or larger at some rows.

    Correlated errors look like a smooth term that is missing, large ones like a local term, and the
    other way round: a term must explain more than an exponential correlation of neighbors does, or
    errors that are larger beyond some row. Either is estimated here, the same for all blocks.

    Parameters
    ----------
    blocks : sequence of (residuals, fitted, lengths)
        Rows that have columns of their own: arrays (N, 1) and (N, p) as in `score_tests`, and the
        numbers of rows in which neighbors are correlated.
    """
    count, rank, counted, determinants = 0, 0, 0.0, 0.0
    squares = np.finfo(float).tiny  # parts fitted exactly leave nothing
    for residuals, fitted, lengths in blocks:
        numbers, firsts = len(residuals), np.cumsum([0, *lengths[:-1]])
        values = np.hstack([column_basis(fitted), residuals])
        # Products of orthonormal columns keep twelve digits where their lengths change tenfold.
        total, later = values.T @ values, np.delete(np.arange(numbers), firsts)
        now, before = values[later], values[later - 1]
        product, cross = now.T @ now, now.T @ before
        # Less what the neighbor predicts.
        rho = CORRELATIONS[:, None, None]
        white = product - rho * (cross + cross.T) + rho**2 * (before.T @ before)
        white = white / (1 - rho**2) + total - product
        place = np.concatenate([np.arange(length) / length for length in lengths])
        is_before = place < SHARES[:, None, None]
        size = np.where(is_before, 1.0, np.array(RATIOS)[:, None]).reshape(-1, numbers)
        near = ((is_before * values.T) @ values)[:, None]
        sized = near + (total - near) / np.array(RATIOS)[:, None, None] ** 2
        products = np.concatenate([white, sized.reshape(-1, *total.shape)])
        # A part that is fitted exactly would leave a negative remainder by rounding.
        products += (ROUNDING * products + np.finfo(float).tiny) * np.eye(len(total))
        # The last diagonal element is the length of what the columns leave of the residuals.
        logarithms = _squares_of_lengths(np.linalg.cholesky(products))
        squares += np.exp(logarithms[:, -1])
        counted += logarithms[:, :-1].sum(axis=1)
        count, rank = count + numbers, rank + values.shape[1] - 1
        correlated = (numbers - len(lengths)) * np.log(1 - CORRELATIONS**2)
        determinants += np.append(correlated, 2 * np.log(size).sum(axis=1))

    scores = count * np.log(squares) + determinants
    # Many columns leave small residuals, which would look equal: their number is counted.
    return scores[np.argmin(scores + counted - rank * np.log(squares))], rank


def scores_of_powers(residuals: Array, fitted: Array, omega: Array) -> Array:
    """Return -2 log likelihood of residuals (2n,) whose power falls with frequency by POWERS.

    Residuals at `omega` (n,) are real parts, then imaginary parts. It is the restricted likelihood:
    the columns `fitted` (2n, p) are projected out.
    Source: Patterson and Thompson (1971), Recovery of inter-block information when block sizes are
    unequal, Biometrika 58.
    """
    size = np.tile(omega, 2)[:, None] ** (-POWERS / 2)
    columns = np.column_stack([column_basis(fitted), residuals]) / size
    logarithms = _squares_of_lengths(np.asarray(np.linalg.qr(columns, mode="r")))
    scores = logarithms.sum(axis=1) + 2 * np.log(size).sum(axis=(1, 2))
    return scores + (len(residuals) - logarithms.shape[1]) * logarithms[:, -1]


def _squares_of_lengths(triangles: Array) -> Array:
    """Return the logarithms of the squares of their diagonals, lengths beside earlier columns."""
    diagonal = np.abs(of_diagonal(triangles))
    return 2 * np.log(np.maximum(diagonal, np.finfo(float).tiny))


def p_value_of_scores(without: tuple[float, int], beside: tuple[float, int], count: int) -> float:
    """Return the probability by chance of two scores of `count` residuals, with their ranks."""
    (score, taken), (lower, rank) = without, beside
    if rank == taken:
        return 1.0
    # The ratio of likelihoods as a share of squares; correlation or ratio is one more unknown.
    left = np.exp(-max(score - lower, 0.0) / count)
    return float(chance(left, max(count - rank - 1, 1), rank - taken))


def chance(left: Any, remaining: Any, terms: int = 1) -> Any:
    """Return the probability that terms leave at most such a share of the squares of noise.

    `remaining` is the count of numbers that the terms and parameters do not use up.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    # 1 - I_x(a, b) = I_(1 - x)(b, a), which keeps its digits where it is small.
    return betainc(remaining / 2, terms / 2, left)
