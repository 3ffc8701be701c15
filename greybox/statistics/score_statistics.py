"""Whether residuals follow terms that a fitted model does not have: score tests, without a fit.

The residuals are regressed on what each term would add to the model, after both have lost what the
fitted parameters can take. All are whitened before, so that colored noise is not called misfit.
The share of the residuals that a term takes has a beta distribution if they are noise. These tests
rank the terms. For records `autoregressive_likelihood` has their probabilities; for responses these
are means over the kinds of errors that there may be.

Sources: Rao (1948), Large sample tests of statistical hypotheses, Mathematical Proceedings of the
Cambridge Philosophical Society 44; Breusch and Pagan (1980), The Lagrange multiplier test and its
applications to model specification in econometrics, Review of Economic Studies 47.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.files.arrays import (
    Array,
    real_root,
    sum_of_squares,
)
from greybox.statistics.column_space import column_basis, outside
from greybox.statistics.neighbor_correlation import slow_errors

# Share of the length of a term that must remain beside the parameters: less is an error of the
# integration, or the effect of another parameter.
REMAINS = 0.01
FEWEST = 6.0  # numbers beyond those that the parameters take

ROUNDING = 1e-12  # of products of columns
TINY = 1e-300

# Squares of errors that are smaller or larger in a band of points than elsewhere, by twelfths of
# these. Without bands in the middle, a third of right models is called wrong where errors grow to
# both ends; with them, as many wrong models are called wrong.
RATIOS = np.array([0.02, 50.0])[:, None]
TWELFTHS = np.arange(12)
BANDS = itertools.combinations(range(13), 2)
SIZES = np.vstack([RATIOS ** np.isin(TWELFTHS, range(*band)) for band in BANDS])

Fits = tuple[Array, Array, Array]  # see `correlated_fits`


def score_tests(residuals: Array, basis: Array, terms: Array) -> Array:
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
    basis : (N, r) array
        Orthonormal, of what the fit can absorb.
    terms : (N, c) array
        What unit terms would add to the model's outputs.
    """
    residuals = outside(residuals, basis)
    # Squares suffice: the terms beside the basis are not needed.
    before = np.sum(terms**2, axis=0)
    squares_left = before - np.sum((basis.T @ terms) ** 2, axis=0)
    length = np.sqrt(np.where(squares_left > REMAINS**2 * before, squares_left, np.inf))

    count = len(residuals)
    remaining = count - basis.shape[1]
    squares = float(residuals @ residuals)
    along = residuals @ terms / length
    share = np.minimum(along**2 / (squares + TINY), 1 - 1e-12)
    tested = (length < np.inf) & (remaining > FEWEST)
    error = np.sqrt(squares * (1 - share) / max(remaining, 1)) / length
    p_value = np.where(tested, chance(1 - share, remaining - 1), np.nan)
    return np.array([count * share, p_value, along / length, error])


def joint_test(residuals: Array, basis: Array, terms: Array) -> tuple[float, Array]:
    """Test c terms together, as the values of a function at c knots.

    Directions whose effect the parameters, or neighboring knots, mostly explain would only add
    noise. The principal directions of the remaining effects are tested.

    Returns
    -------
    p_value : float
        The probability that by chance the directions would explain as much of the residuals.
    directions : (c, r) array
        Each column combines the terms to one direction. The effects of these directions, less what
        the parameters can explain of them, are orthonormal.

    Parameters
    ----------
    residuals, basis, terms : see `score_tests`
    """
    effects, residuals = outside(terms, basis), outside(residuals, basis)
    # The product of the effects with themselves takes a third of the time of their singular values,
    # and only those beyond a fifth of the largest matter.
    squares, axes = np.linalg.eigh(effects.T @ effects)
    lengths = real_root(squares)
    longest = max(np.linalg.norm(terms, axis=0), default=0.0)
    # Directions shorter than a fifth of the longest are not tested.
    kept = lengths > max(0.2 * max(lengths, default=0.0), REMAINS * longest)
    directions = axes[:, kept] / lengths[kept]
    share = sum_of_squares(residuals @ effects @ directions) / (residuals @ residuals + TINY)
    remaining = len(residuals) - basis.shape[1] - np.sum(kept)
    p_value = chance(max(1 - share, 0.0), remaining, max(np.sum(kept), 1))
    return float(p_value), directions


def correlated_fits(blocks: Sequence[tuple[Array, Array, Sequence[int]]], *terms: Array) -> Fits:
    """Return what fits leave of residuals, without a term and with each, for m kinds of errors.

    Correlated errors look like a missing smooth term, large ones like a missing local term, and
    vice versa. So errors may be white, or correlated in addition to white ones, or larger or
    smaller in a band of rows than in all others, in all blocks alike.

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
    remaining : (1 + c,) array
        Numbers that the fits do not use up.
    """
    from scipy.fft import dct  # noqa: PLC0415  (imports slowly)

    most = 0
    squares = scores = np.zeros((1, 1))
    for residuals, fitted, lengths in blocks:
        basis = column_basis(fitted)
        values = np.hstack([basis, 0 * residuals, *terms, residuals])
        pieces = np.split(values, np.cumsum(lengths[:-1]))
        waves = np.vstack([np.asarray(dct(piece, axis=0, norm="ortho")) for piece in pieces])
        slow = np.hstack([slow_errors(np.pi * np.arange(n) / n) for n in lengths])
        places = np.hstack([(12 * np.arange(n) + 6) // n for n in lengths])
        # All sizes are the same within a twelfth.
        sums = (values.T * (places == TWELFTHS[:, None, None])) @ values
        products = np.vstack(
            [[(waves.T / row) @ waves for row in slow], np.tensordot(1 / SIZES, sums, 1)]
        )
        # A part that is fitted exactly would leave a negative remainder by rounding.
        products += (ROUNDING * products + TINY) * np.eye(values.shape[1])
        first = basis.shape[1]
        triangles = np.linalg.cholesky(products)
        # The product of its last rows is what the first columns leave of the others.
        rest = triangles[:, first:, first:] @ triangles[:, first:, first:].mT
        left = np.linalg.diagonal(rest)
        squares = squares + left[:, -1:] - rest[:, -1, :-1] ** 2 / left[:, :-1]
        logarithms = (
            2 * np.log(np.linalg.diagonal(triangles)[:, :first]),
            np.log(np.vstack([slow, SIZES[:, places]])),
        )
        scores = scores + np.log(left[:, :-1]) + np.hstack(logarithms).sum(axis=1, keepdims=True)
        most += len(values) - first

    remaining = most - np.minimum(np.arange(squares.shape[1]), 1.0)
    return squares, scores + remaining * np.log(squares), remaining


def p_values_of_fits(without: Fits, beside: Fits) -> list[float]:
    """Return the probabilities by chance that larger fits leave so little of the residuals.

    A probability is the mean over the kinds of errors, each as likely as what the larger fit
    leaves makes it: without a term that is missing, they would always look correlated.
    """
    (before, _, most), (squares, scores, remaining) = without, beside
    left = np.minimum(squares / before[:, :1], 1.0)
    p_values = chance(left, remaining, np.maximum(most[0] - remaining, 1))
    weight = np.exp((scores.min(axis=0) - scores) / 2)
    # Before the data, white errors are as likely as all others.
    weight[0] *= len(weight) - 1
    return np.average(p_values, axis=0, weights=weight).tolist()


def chance(left: Any, remaining: Any, terms: Any = 1) -> Any:
    """Return the probability that terms leave at most such a share of the squares of noise.

    `remaining` is the count of numbers that the terms and parameters do not use up.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    # 1 - I_x(a, b) = I_(1 - x)(b, a), which keeps its digits where it is small.
    return betainc(np.maximum(remaining, TINY) / 2, terms / 2, left)
