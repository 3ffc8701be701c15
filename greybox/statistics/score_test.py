"""Whether residuals follow terms that a fitted model does not have: score tests, without a fit.

The residuals are regressed on what each term would add to the model, after both have lost what the
fitted parameters can take. All are whitened before, so that colored noise is not called misfit.
The share of the residuals that a term takes has a beta distribution if they are noise. Residuals of
a record say something only where a term has power: a trend is compared with the few lowest
frequencies, not with all samples.

Sources: Rao (1948), Large sample tests of statistical hypotheses, Mathematical Proceedings of the
Cambridge Philosophical Society 44; Breusch and Pagan (1980), The Lagrange multiplier test and its
applications to model specification in econometrics, Review of Economic Studies 47.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from greybox.files.arrays import Array
from greybox.statistics.column_space import column_basis

# Share of the length of a term that must remain beside the parameters: less is the error of
# the integration, or another parameter's work.
REMAINS = 0.01
FEWEST = 6.0  # numbers beyond those that the parameters take

# Correlations of neighbors that are tried.
CORRELATIONS = np.tanh(np.linspace(0.0, 2.5, 20))


@dataclass(frozen=True, eq=False)
class ScoreTests:
    """Score tests of c terms.

    Attributes
    ----------
    value, error : (c,) arrays
        The factor on each term that a fit would estimate, to first order, with its standard error
        if the model then explains the data.
    share : (c,) array
        Share of the squared residuals that the term takes, of those at its frequencies.
    p_value : (c,) array
        Probability of a larger share by chance; NaN where it cannot be told.
    decrease : (c,) array
        What each term takes from the sum of squares, over their mean.
    """

    value: Array
    error: Array
    share: Array
    p_value: Array
    decrease: Array


def score_tests(residuals: Array, fitted: Array, terms: Array, *, in_time: bool) -> ScoreTests:
    """Test c terms one by one.

    Parameters
    ----------
    residuals : (N,) array
        White if they are noise.
    fitted : (N, p) array
        What the fit may have taken from them.
    terms : (N, c) array
        What unit terms would add to the model's outputs.
    in_time : bool
        Whether the rows follow one another in time, and the residuals are white only as far as
        their spectrum was estimated at the frequencies of the term.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    basis = column_basis(fitted)
    before = np.linalg.norm(terms, axis=0)
    terms = _beside(basis, terms / np.where(before > 0, before, 1.0))
    length = np.linalg.norm(terms, axis=0)
    is_new = (length > REMAINS) & (before > 0)
    rows = np.where(is_new, terms / np.where(is_new, length, 1.0), 0.0)
    residuals = _beside(basis, residuals)

    count = len(residuals)
    variance = np.full(terms.shape[1], float(residuals @ residuals) / count)
    numbers = np.full(terms.shape[1], float(count))
    if in_time:
        power = _power(rows) / np.maximum(_power(rows).sum(axis=0), 1e-300)
        # Each frequency has two numbers.
        numbers = 2 / np.maximum((power**2).sum(axis=0), 1e-300)
        local = _power(residuals[:, None])[:, 0] @ power / 2
        variance = np.maximum(variance, local)
    remaining = numbers - basis.shape[1]
    along = rows.T @ residuals
    overall = max(float(residuals @ residuals) / count, np.finfo(float).tiny)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.minimum(along**2 / (numbers * variance), 1.0)
        error = np.sqrt(variance * (1 - share) * numbers / remaining) / (length * before)
        value = along / (length * before)
    tested = is_new & (remaining > FEWEST) & (variance > 0)
    share = np.minimum(share, 1 - 1e-12)
    p_value = np.full(len(share), np.nan)
    # 1 - I_x(a, b) = I_(1 - x)(b, a), which keeps its digits where it is small.
    p_value[tested] = betainc((remaining[tested] - 1) / 2, 0.5, 1 - share[tested])

    return ScoreTests(value, error, np.where(tested, share, 0.0), p_value, along**2 / overall)


def _power(rows: Array) -> Array:
    """Return the power (frequencies, c) of columns (N, c); it adds up to their sum of squares."""
    power = np.abs(np.fft.rfft(rows, axis=0)) ** 2 / len(rows)
    power[1 : (len(rows) + 1) // 2] *= 2
    return power


def _beside(basis: Array, values: Array) -> Array:
    # Once more: the first pass leaves rounding errors of the size of the values.
    values = values - basis @ (basis.T @ values)
    return values - basis @ (basis.T @ values)


def p_value_beside_correlation(
    residuals: Array, fitted: Array, term: Array, lengths: Sequence[int]
) -> float:
    """Return the probability of a term if errors of neighboring rows may be correlated.

    The term must explain more than an exponential correlation does, whose size is estimated without
    and with it: correlated errors look like a smooth term, and the other way round.

    Parameters
    ----------
    residuals, fitted, term : (N, 1), (N, p) and (N, 1) arrays
        As in `score_tests`.
    lengths : sequence of int
        Numbers of rows in which neighbors are correlated.
    """
    from scipy.special import betainc  # noqa: PLC0415  (takes a tenth of a second to import)

    numbers, firsts = len(residuals), np.cumsum([0, *lengths[:-1]])
    values = np.hstack([residuals, term, fitted])
    scores = []
    for rho in CORRELATIONS:
        # Less what the neighbor predicts.
        white = (values - rho * np.roll(values, 1, axis=0)) / np.sqrt(1 - rho**2)
        white[firsts] = values[firsts]
        without, beside = (
            np.sum(_beside(column_basis(white[:, begin:]), white[:, 0]) ** 2) for begin in (2, 1)
        )
        determinant = (numbers - len(lengths)) * np.log(1 - rho**2)
        squares = np.maximum([without, beside], np.finfo(float).tiny)
        scores.append(numbers * np.log(squares) + determinant)
    without, beside = np.min(scores, axis=0)
    # The ratio of likelihoods as a share of squares; the correlation is one more unknown.
    remaining = max(numbers - fitted.shape[1] - 2, 1)
    return float(betainc(remaining / 2, 0.5, np.exp(-max(without - beside, 0.0) / numbers)))
