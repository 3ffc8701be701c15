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

from greybox.files.arrays import Array, of_diagonal, positive_or_one
from greybox.statistics.column_space import column_basis, outside

# Share of the length of a term that must remain beside the parameters: less is an error of the
# integration, or the effect of another parameter.
REMAINS = 0.01
FEWEST = 6.0  # numbers beyond those that the parameters take

ROUNDING = 1e-12  # of products of columns

# Correlated errors that are tried, beside white ones: lengths of the correlation in points, of which
# the longest is an error of all points, and variances over that of the white errors.
LENGTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 64.0])
VARIANCES = np.array([0.3, 1.0, 3.0, 10.0, 1e4])[:, None, None]
# Squares of errors of independent points that are larger or smaller beyond a share of the points.
RATIOS = np.array([0.1, 0.3, 3.0, 10.0])[:, None] ** 2
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
    before = np.linalg.norm(terms, axis=0)
    terms = outside(terms / positive_or_one(before), basis)
    length = np.linalg.norm(terms, axis=0)
    is_new = (length > remains) & (before > 0)
    rows = np.where(is_new, terms / np.where(is_new, length, 1.0), 0.0)
    residuals = outside(residuals, basis)

    count = len(residuals)
    remaining = count - basis.shape[1]
    squares = float(residuals @ residuals)
    along = rows.T @ residuals
    share = np.minimum(along**2 / max(squares, np.finfo(float).tiny), 1 - 1e-12)
    tested = is_new & (remaining > FEWEST) & (squares > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.sqrt(squares * (1 - share) / max(remaining, 1)) / (length * before)
        value = along / (length * before)
    p_value = np.where(tested, chance(1 - share, max(remaining - 1, 1)), np.nan)
    return np.array([count * share, p_value, value, error])


def correlated_fits(
    blocks: Sequence[tuple[Array, Array, Sequence[int]]], *terms: Array
) -> tuple[Array, Array, int]:
    """Return what fits leave of residuals, without a term and beside each, for m kinds of errors.

    Correlated errors look like a smooth term that is missing, large ones like a local term, and the
    other way round. So errors may be white, or correlated with white ones beside them, or larger
    beyond some row, in all blocks alike.

    Parameters
    ----------
    blocks : sequence of (residuals, fitted, lengths)
        Rows that have columns of their own: arrays (N, 1) and (N, p) as in `score_tests`, and the
        numbers of rows in which neighbors are correlated.
    *terms : (N, c) array
        What unit terms would add to a single block.

    Returns
    -------
    squares, scores : (m, 1 + c) arrays
        Weighted sums of squares, and -2 log of the restricted likelihoods.
    rank : int
        Of what a fit without a term can absorb.
    """
    count, rank = 0, 0
    squares = scores = np.zeros(1)
    for residuals, fitted, lengths in blocks:
        basis = column_basis(fitted)
        values = np.hstack([basis, 0 * residuals, *terms, residuals])
        waves = np.vstack([*map(_cosines, np.split(values, np.cumsum(lengths[:-1])))])
        powers = np.hstack([*map(_powers, lengths)])
        place = np.concatenate([np.arange(length) / length for length in lengths])
        sizes = np.where(place < SHARES[:, None, None], 1.0, RATIOS).reshape(-1, len(values))
        products = np.array(
            [(waves.T / row) @ waves for row in powers]
            + [(values.T / row) @ values for row in sizes]
        )
        # A part that is fitted exactly would leave a negative remainder by rounding.
        products += (ROUNDING * products + np.finfo(float).tiny) * np.eye(values.shape[1])
        *taken, last = range(values.shape[1])
        first = basis.shape[1]
        fits = np.array([[*taken[:first], term, last] for term in taken[first:]])
        triangles = np.linalg.cholesky(products[:, fits[:, :, None], fits[:, None]])
        # The last diagonal element is the length of what the columns leave of the residuals.
        logarithms = _squares_of_lengths(triangles)
        squares = squares + np.exp(logarithms[..., -1])
        determinants = np.log([*powers, *sizes]).sum(axis=1)[:, None]
        scores = scores + logarithms[..., :-1].sum(axis=2) + determinants
        count, rank = count + len(values), rank + first

    remaining = count - rank - (np.arange(squares.shape[1]) > 0)
    return squares, scores + remaining * np.log(squares), rank


def p_values_of_fits(
    before: Array, squares: Array, scores: Array, remaining: int, terms: int = 1
) -> Array:
    """Return the probabilities (c,) by chance that fits leave so little of the squares (m, 1).

    Both are those of `correlated_fits`. A probability is the mean over the kinds of errors, each as
    likely as the residuals beside the terms make it: without a term that is missing, they would
    always look correlated.
    """
    left = np.minimum(squares / before, 1.0)
    weight = np.exp((scores.min(axis=0) - scores) / 2)
    return np.average(chance(left, max(remaining, 1), terms), axis=0, weights=weight)


def _cosines(values: Array) -> Array:
    """Return the orthonormal cosine transform of values (n, c)."""
    n = len(values)
    turn = np.exp(-0.5j * np.pi * np.arange(n) / n)[:, None] / np.sqrt(2 * n)
    turn[0] /= np.sqrt(2)
    return (turn * np.fft.rfft(np.vstack([values, values[::-1]]), axis=0)[:n]).real


def _powers(n: int) -> Array:
    """Return the power of errors at n cosines, white ones first.

    Cosines are the principal components of a random walk, and of one that returns to its mean.
    """
    rho = np.exp(-1 / LENGTHS)[:, None]
    slow = 1 / ((1 - rho) ** 2 / rho + 2 - 2 * np.cos(np.pi * np.arange(n) / n))
    slow /= slow.mean(axis=1, keepdims=True)
    return np.vstack([np.ones(n), *(1 + VARIANCES * slow)])


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


def chance(left: Any, remaining: Any, terms: int = 1) -> Any:
    """Return the probability that terms leave at most such a share of the squares of noise.

    `remaining` is the count of numbers that the terms and parameters do not use up.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    # 1 - I_x(a, b) = I_(1 - x)(b, a), which keeps its digits where it is small.
    return betainc(remaining / 2, terms / 2, left)
