"""What fits leave of residuals with and without a term, for several kinds of errors."""

import itertools
from collections.abc import Sequence

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.statistics.beta_share import TINY, chance
from greybox.statistics.column_space import column_basis
from greybox.statistics.neighbor_spectra import slow_errors

ROUNDING = 1e-12  # of products of columns

# Squares of errors that are smaller or larger in a band of points than elsewhere, by twelfths of
# these. Without bands in the middle, a third of right models is called wrong where errors grow to
# both ends; with them, as many wrong models are called wrong.
RATIOS = np.array([0.02, 50.0])[:, None]
TWELFTHS = np.arange(12)
BANDS = itertools.combinations(range(13), 2)
SIZES = np.vstack([RATIOS ** np.isin(TWELFTHS, range(*band)) for band in BANDS])


@frozen
class Block:
    """Rows that have columns of their own.

    Attributes
    ----------
    residuals, fitted : (N, 1) and (N, p) arrays
        As in `score_tests`.
    lengths : sequence of int
        Numbers of rows in which neighbors are correlated.
    """

    residuals: Array
    fitted: Array
    lengths: Sequence[int]


@frozen
class Remainder:
    """What fits leave of residuals, without a term and with each of c, for m kinds of errors.

    Attributes
    ----------
    squares, scores : (m, 1 + c) arrays
        Weighted sums of squares, and -2 log of the restricted likelihoods.
    numbers : (1 + c,) array
        How many the fits do not use up.
    """

    squares: Array
    scores: Array
    numbers: Array


def correlated_fits(blocks: Sequence[Block], *terms: Array) -> Remainder:
    """Return what fits leave of residuals, without a term and with each, for m kinds of errors.

    Correlated errors look like a missing smooth term, large ones like a missing local term, and
    vice versa. So errors may be white, or correlated in addition to white ones, or larger or
    smaller in a band of rows than in all others, in all blocks alike.

    Parameters
    ----------
    blocks : sequence of Block
    *terms : (N, c) array
        What unit terms would add to a single block.
    """
    from scipy.fft import dct  # noqa: PLC0415  (imports slowly)

    most = 0
    squares = scores = np.zeros((1, 1))
    for block in blocks:
        residuals, lengths = block.residuals, block.lengths
        basis = column_basis(block.fitted)
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
    return Remainder(squares, scores + remaining * np.log(squares), remaining)


def p_values_of_fits(without: Remainder, beside: Remainder) -> list[float]:
    """Return the probabilities by chance that larger fits leave so little of the residuals.

    A probability is the mean over the kinds of errors, each as likely as what the larger fit
    leaves makes it: without a term that is missing, they would always look correlated.
    """
    left = np.minimum(beside.squares / without.squares[:, :1], 1.0)
    terms = np.maximum(without.numbers[0] - beside.numbers, 1)
    p_values = chance(left, beside.numbers, terms)

    weight = np.exp((beside.scores.min(axis=0) - beside.scores) / 2)
    # Before the data, white errors are as likely as all others.
    weight[0] *= len(weight) - 1
    return np.average(p_values, axis=0, weights=weight).tolist()
