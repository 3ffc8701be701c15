"""Whether residuals follow terms that a fitted model does not have: score tests, without a fit.

The residuals are regressed on what each term would add to the model, after both have lost what the
fitted parameters can take. All are whitened before, so that colored noise is not called misfit.
The share of the residuals that a term takes has a beta distribution if they are noise. These tests
rank the terms. Their probabilities are those of `autoregressive_likelihood` for records, and those
of `restricted_likelihoods` for responses.

Sources: Rao (1948), Large sample tests of statistical hypotheses, Mathematical Proceedings of the
Cambridge Philosophical Society 44; Breusch and Pagan (1980), The Lagrange multiplier test and its
applications to model specification in econometrics, Review of Economic Studies 47.
"""

import numpy as np

from greybox.data.files.arrays import Array, real_root, sum_of_squares
from greybox.statistics.beta_share import TINY, chance
from greybox.statistics.column_space import outside

# Share of the length of a term that must remain beside the parameters: less is an error of the
# integration, or the effect of another parameter.
REMAINS = 0.01
FEWEST = 6.0  # numbers beyond those that the parameters take


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
