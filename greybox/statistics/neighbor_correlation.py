"""The correlation of errors of neighboring points along frequency, from the residuals of a fit.

The correlation is the same for real and imaginary parts. It falls exponentially with the distance
in points, rho^|i - j|, as that of a smooth effect that the model omits, and white errors may lie
above it; or the errors are means of neighbors, or means of such means, as those of a transform
whose resolution is coarser than the points. Twenty points determine rho to about 0.15 only. So
standard errors and intervals are averaged over all these correlations, weighted by their restricted
likelihoods, which take account of what the fitted parameters took from the errors. Cosines are the
principal components of such errors.
Before the data, independent errors are as likely as correlated ones. Where a fit has several
responses, all of them together show how likely. If independent errors are 1.5 times as likely
afterwards, the errors count as independent. Errors of a single response that are independent are
recognized in nine of ten fits of 48 points, and in two of three fits of 12. Errors of another shape
get intervals that are too wide: at 30 points, standard errors were 3 times too large for errors of
alternating sign, because a negative correlation is not considered.
`benchmarks/neighbor_coverage.py` shows what this costs.

Sources: Patterson and Thompson (1971), Recovery of inter-block information when block sizes are
unequal, Biometrika 58 (restricted likelihood); Tunnicliffe Wilson (1989), On the use of marginal
likelihood in time series model estimation, JRSS B 51 (of an autoregression); Hoeting, Madigan,
Raftery and Volinsky (1999), Bayesian Model Averaging: A Tutorial, Statistical Science 14.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from greybox.files.arrays import (
    Array,
    ComplexArray,
    all_finite,
    real_and_imaginary,
)
from greybox.files.frozen_values import frozen
from greybox.statistics.column_space import column_basis

# Probability of independent errors below which a correlation is reported: in simulated fits of 10
# to 100 points it is reported in at most 1 % of those with independent errors.
UNLIKELY = 0.1
# Lengths of a slow correlation in points, the longest of which is mostly an error common to all
# points, and variances over that of the white errors above it. Parameters take most of a slow
# effect beneath noise: where two thirds of the variance of 40 points are a random walk, intervals
# cover 78 % (66 % with white errors beside means of neighbors alone).
LENGTHS = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 64.0])[:, None]
VARIANCES = np.array([0.3, 1.0, 3.0, 10.0, 1e4])[:, None, None]
# Residuals over the sizes of the errors below which data are fitted exactly.
EXACT = math.sqrt(np.finfo(float).eps)

# Levels at which the intervals of an average of distributions and of Student's t must agree: those
# of a standard error, and of the printed interval.
LEVELS = (0.6827, 0.95)


@frozen
class NeighborCorrelation:
    """The distribution of the correlation of n neighboring errors.

    Attributes
    ----------
    powers : (m, n) array
        Possible correlations of errors 0 to n - 1 points apart; the first are independent.
    weight : (m,) array
        Their probabilities.
    scale : (m,) array
        Variance of the errors over that of independent ones: fits take more from slow errors.
    variances : (m, n) array
        Those of the cosines of errors of variance one.
    """

    powers: Array
    weight: Array
    scale: Array
    variances: Array

    @property
    def independent(self) -> float:
        """The probability that the errors are independent."""
        return float(self.weight[0])

    @property
    def mean(self) -> float:
        """The mean correlation of neighbors."""
        return float(self.weight @ self.powers[:, 1])

    def drawn(self, random: np.random.Generator, white: ComplexArray) -> ComplexArray:
        """Return errors (n,) of one of these correlations from white ones."""
        from scipy.fft import idct  # noqa: PLC0415  (imports slowly)

        kind = random.choice(len(self.weight), p=self.weight)
        return np.asarray(
            idct(np.sqrt(self.scale[kind] * self.variances[kind]) * white, norm="ortho")
        )


def neighbor_correlation(
    errors: ComplexArray, design: Array, inflation: float | None = None
) -> NeighborCorrelation | None:
    """Return the distribution of the correlation of errors, by the residuals of a fit.

    Parameters
    ----------
    errors : (n,) complex array
        Residuals over the sizes of the errors, by frequency.
    design : (2n, p) array
        Derivatives of the residuals in the same units, real parts first.
    inflation : float, optional
        Squared residuals over their expectation by given error sizes. If it is below one, the given
        sizes are used. By default, the size is estimated from the residuals.

    Returns
    -------
    NeighborCorrelation or None
        None if the residuals contain no information on it: too few numbers remain, or the data are
        fitted exactly.
    """
    from scipy.fft import dct  # noqa: PLC0415  (imports slowly)

    n = errors.size
    norm = np.linalg.norm(errors)
    if not (all_finite(design) and EXACT * math.sqrt(n) < norm < math.inf):
        return None

    # The residuals lack what the parameters took from the errors.
    basis = column_basis(design)
    numbers = 2 * n - basis.shape[1]
    # Fewer numbers beyond the parameters have no information on a correlation.
    if numbers < 4:
        return None

    powers, variances = error_kinds(n)
    columns = np.column_stack([real_and_imaginary(errors), basis]).reshape(2, n, -1)
    waves = np.asarray(dct(columns, axis=1, norm="ortho")).reshape(2 * n, -1)
    moments = np.array([(waves.T / row) @ waves for row in np.tile(variances, 2)])
    # What remains of the first row's square without the others is a ratio of determinants.
    information = np.linalg.slogdet(moments[:, 1:, 1:])[1]
    squares = np.exp(np.linalg.slogdet(moments)[1] - information)

    # The parameters absorbed all of the errors, except for rounding.
    if not squares.min() > (EXACT * norm) ** 2:
        return None

    # Estimated sizes follow the squares, given ones are a lower limit.
    squares *= (inflation or 1.0) / squares[0]
    size = np.maximum(squares, 0.0 if inflation is None else 1.0)
    # -2 log of the restricted likelihood: the last term is that of the fitted parameters.
    score = numbers * (np.log(size) + squares / size)
    score += 2 * np.log(variances).sum(axis=1) + information

    # Independent errors are as likely as correlated ones, of which all kinds are.
    weight = np.exp((score.min() - score) / 2)
    weight[1:] /= len(weight) - 1
    return NeighborCorrelation(powers, weight / weight.sum(), size / size[0], variances)


def judged_together(
    responses: Sequence[NeighborCorrelation],
) -> list[NeighborCorrelation | None]:
    """Return the distributions by all responses of a fit; None where errors count as independent.

    The share of responses with independent errors is unknown, and uniform before the data. All
    responses show it, and in each it is the prior probability of independent errors. If responses
    are judged alone, one of six with independent errors counts as correlated, and standard errors
    of ten responses with given variances are 1.2 times too large.
    """
    from scipy.special import softmax  # noqa: PLC0415  (imports slowly)

    share = np.arange(0.005, 1, 0.01)[:, None]
    alone = np.array([errors.independent for errors in responses])
    evidence = share * alone + (1 - share) * (1 - alone)
    together = softmax(np.log(evidence).sum(axis=1)) @ (share * alone / evidence)

    # Above this posterior probability errors count as independent. Intervals of a response with 8
    # to 40 points of independent errors are then 2 to 18 % wider in the mean, and cover 95 to 97 %.
    return [
        None
        if p > 0.6
        else replace(errors, weight=np.append(p, errors.weight[1:] * (1 - p) / (1 - q)))
        for errors, p, q in zip(responses, together, alone, strict=True)
    ]


@lru_cache(4)  # members of a study mostly have equal numbers of points
def error_kinds(n: int) -> tuple[Array, Array]:
    """Return the correlations (m, n) of n errors, and the variances (m, n) of their cosines.

    Independent errors come first.
    """
    omega = np.pi * np.arange(n + 1) / n
    # Means of two to eight neighbors, and means of such means. With slow correlations alone,
    # intervals of 60 points were 1.4 to 1.8 times too wide for means of two and four neighbors and
    # for a Hann window of three.
    count = np.arange(2, 9)
    power = np.abs(np.tri(8)[1:] @ np.exp(-1j * np.outer(np.arange(8), omega))) ** 2
    # Errors that are alike over half of the points look like a gain.
    means = np.vstack([power, power**2])[np.append(count, 2 * count - 1) <= max(n / 2, 2)]
    # Few points smear the frequencies that a mean takes out.
    means += means.mean(axis=1, keepdims=True) / n
    # A longer correlation is an error of all points, which looks like a gain.
    slow = slow_errors(omega, LENGTHS[LENGTHS[:, 0] <= n])
    variances = np.vstack([slow, means])[:, :n]
    # The mean counts as one of the cosines, and as half of one in a Fourier series.
    slow[1:, 0] *= 2
    powers = np.fft.irfft(np.vstack([slow, means]))[:, :n]
    return powers / powers[:, :1], variances / variances.mean(axis=1, keepdims=True)


def slow_errors(omega: Array, lengths: Array = LENGTHS) -> Array:
    """Return the spectra (kinds, n) of white errors above slow ones.

    White errors alone come first. Frequencies `omega` are in rad for a point.
    """
    slow = 1 / (np.cosh(1 / lengths) - np.cos(omega))
    slow /= slow.mean(axis=1, keepdims=True)
    return np.vstack([np.ones_like(omega), *(1 + VARIANCES * slow)])


def averaged_meat(
    scores: ComplexArray,
    known: NeighborCorrelation,
    correlation: Callable[[Array], Array],
    dof: float,
) -> tuple[Array, float]:
    """Return the covariance (r, r) of the sum of scores, and its degrees of freedom.

    Parameters
    ----------
    scores : (n, r) complex array
        Derivatives of the residuals, in directions of unit variance for independent errors, times
        the deviations of their scores if the errors are independent, by frequency.
    known : NeighborCorrelation
    correlation : function of an array
        The correlation of scores by that of their errors.
    dof : float
        Degrees of freedom of the size of the errors.
    """
    # Sums over all pairs of points at one distance: a correlation, fast by Fourier transforms.
    size = 2 * len(scores)
    transform = np.fft.fft(scores, size, axis=0, norm="ortho")
    spectra = known.scale[:, None] * (2 * np.fft.fft(correlation(known.powers), size).real - 1)
    variances = spectra @ np.sum(np.abs(transform) ** 2, axis=1)
    meat = (transform.conj().T * (known.weight @ spectra) @ transform).real
    variance, dof = student_of_average(known.weight, variances, dof)
    return meat * (variance / (known.weight @ variances or 1.0)), dof


def student_of_average(weight: Array, variance: Array, dof: float) -> tuple[float, float]:
    """Return variance and degrees of freedom of a Student's t that replaces an average of several.

    These have variances (m,) and the same degrees of freedom; the result has the same intervals as
    their average at `LEVELS`. With infinite degrees of freedom, the result is normal and has the
    same interval at the first level, that of a standard error. The variance of the average would be
    mostly that of the slowest errors, which few residuals exclude: standard errors of ten responses
    with correlations of 0.3 and 0.6 were 1.6 and 1.8 times the scatter, now 1.3 and 1.5.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (takes a tenth of a second to import)
    from scipy.special import stdtr, stdtrit  # noqa: PLC0415

    if not variance.min() > 0:
        return float(weight @ variance), dof

    deviation = np.sqrt(variance)
    tails = (1 - np.array(LEVELS)) / 2
    half_widths: Any = (
        brentq(
            lambda size, tail=tail: stdtr(dof, -size / deviation) @ weight - tail,
            0,
            -1.01 * stdtrit(dof, tail) * deviation.max(),  # that of the widest
        )
        for tail in tails
    )
    inner, outer = half_widths
    if math.isinf(dof):
        return float((inner / stdtrit(dof, tails[0])) ** 2), dof

    # The ratio of both intervals falls as the degrees of freedom rise.
    few, most = 1 / dof, 1.0
    for _ in range(40):
        middle = (few + most) / 2
        narrow, wide = stdtrit(1 / middle, tails)
        few, most = (middle, most) if wide / narrow < outer / inner else (few, middle)
    return float((outer / stdtrit(1 / few, 1 - tails[1])) ** 2), 1 / few
