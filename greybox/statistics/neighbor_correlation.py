"""The correlation of errors of neighboring points along frequency, from the residuals of a fit.

The correlation is the same for real and imaginary parts. It falls exponentially with the distance
in points, rho^|i - j|, as that of a smooth effect that the model omits; or the errors are means of
neighbors, or means of such means, as those of a transform whose resolution is coarser than the
points, with or without white errors beside them. Twenty points determine rho to about 0.15 only. So
standard errors and intervals are averaged over all these correlations, weighted by their restricted
likelihoods, which take account of what the fitted parameters took from the errors.
Before the data, independent errors are as likely as correlated ones. If they are four times as
likely afterwards, the errors count as independent. Errors that are independent are recognized in
nine of ten fits of 48 points, and in two of three fits of 12. Errors of another shape get intervals
that are too wide: at 30 points, standard errors were 3 times too large for errors of alternating
sign, because a negative correlation is not considered. `benchmarks/neighbor_coverage.py` shows what
this costs.

Sources: Patterson and Thompson (1971), Recovery of inter-block information when block sizes are
unequal, Biometrika 58 (restricted likelihood); Tunnicliffe Wilson (1989), On the use of marginal
likelihood in time series model estimation, JRSS B 51 (of an autoregression); Hoeting, Madigan,
Raftery and Volinsky (1999), Bayesian Model Averaging: A Tutorial, Statistical Science 14.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from greybox.files.arrays import Array, ComplexArray, all_finite, frozen
from greybox.statistics.column_space import column_basis

# Values of rho, evenly spaced up to a correlation over all points. The spacing is below the error
# of rho up to 10 000 points.
VALUES = 200
# Probability of independent errors below which a correlation is reported: in simulated fits of 10
# to 100 points it is reported in at most 1 % of those with independent errors.
UNLIKELY = 0.1
# Correlations (m, lags) of means of two to eight neighbors, and of means of such means. With
# exponential correlations alone, intervals of 60 points were 1.4 to 1.8 times too wide for means of
# two and four neighbors and for a Hann window of three. A little white noise keeps their covariance
# from being singular in rounded numbers.
_POWER = np.abs(np.fft.rfft(np.tri(8)[1:], 32)) ** 2
LAGS = np.fft.irfft([*_POWER, *_POWER**2 + 1e-5])[:, :16]
LAGS /= LAGS[:, :1]
# Some of them with as large white errors, as of a slow effect beneath noise: parameters take most
# of such an effect, and exponential correlations do not show the rest. Where half of the errors of
# 40 points are a random walk, it is reported in 57 % of fits (44 % without), and intervals cover
# 65 % (59 %); those of independent errors are 2 % wider.
LAGS = np.vstack([LAGS, (LAGS[2::2] + np.eye(1, 16)) / 2])
# Residuals over the sizes of the errors below which data are fitted exactly.
EXACT = math.sqrt(np.finfo(float).eps)

# Levels at which the intervals of an average of distributions and of Student's t must agree: those
# of a standard error, and of the printed interval.
LEVELS = (0.6827, 0.95)


@frozen
class NeighborCorrelation:
    """The distribution of the correlation of neighboring errors.

    Attributes
    ----------
    powers : (m, n) array
        Possible correlations of errors 0 to n - 1 points apart; the first are independent.
    weight : (m,) array
        Their probabilities.
    scale : (m,) array
        Variance of the errors over that of independent ones: fits take more from slow errors.
    """

    powers: Array
    weight: Array
    scale: Array

    @property
    def independent(self) -> float:
        """The probability that the errors are independent."""
        return float(self.weight[0])

    @property
    def mean(self) -> float:
        """The mean correlation of neighbors."""
        return float(self.weight @ self.powers[:, 1])


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
        None if errors count as independent: too few numbers remain, the data are fitted exactly, or
        the residuals show no correlation.
    """
    from scipy.linalg import get_lapack_funcs  # noqa: PLC0415  (imports slowly)

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

    rho = np.linspace(0.0, math.exp(-1 / n), VALUES)
    # The inverse of a matrix rho^|i - j| has three diagonals, so no matrix is formed.
    rows = np.ascontiguousarray(np.column_stack([errors, basis[:n] + 1j * basis[n:]]))
    squares_of_rows = (rows.conj().T @ rows).real
    ends = (rows[[0, -1]].conj().T @ rows[[0, -1]]).real
    beside = (rows[1:].conj().T @ rows[:-1]).real
    share = rho[:, None, None]
    moments = (1 + share**2) * squares_of_rows - share**2 * ends - share * (beside + beside.T)
    moments /= 1 - share**2
    means, factors = _means(n)
    # Without the checks of SciPy, which take as long as everything else here.
    (pbtrs,) = get_lapack_funcs(("pbtrs",))
    weighted = np.array([pbtrs(factor, rows.view(float), lower=1)[0] for factor in factors])
    moments = np.concatenate([moments, (rows.conj().T @ weighted.view(complex)).real])
    logarithms = [2 * np.log(factor[0]).sum() for factor in factors]
    # What remains of the first row's square without the others is a ratio of determinants.
    information = np.linalg.slogdet(moments[:, 1:, 1:])[1]
    squares = np.exp(np.linalg.slogdet(moments)[1] - information)

    # The parameters absorbed all of the errors, except for rounding.
    if not squares.min() > EXACT**2 * squares_of_rows[0, 0]:
        return None

    squares /= squares[0]
    if inflation is None:
        scale, score = squares, numbers * np.log(squares)
    else:
        size = np.maximum(inflation * squares, 1.0)
        scale, score = size / size[0], numbers * (np.log(size) + inflation * squares / size)

    # -2 log of the restricted likelihood: the last term is that of the fitted parameters.
    score += 2 * np.append((n - 1) * np.log(1 - rho**2), logarithms)
    score += information

    # Independent errors are as likely as correlated ones, and both kinds of correlation are, too.
    prior = np.repeat([0.25 / VALUES, 0.25 / len(means)], [VALUES, len(means)])
    prior[0] = 0.5
    weight = prior * np.exp((score.min() - score) / 2)
    weight /= weight.sum()
    # Above this posterior probability errors count as independent: intervals then change by less
    # than 8 %, and contain the truth half a per cent less often.
    if weight[0] > 0.8:
        return None

    powers = np.vstack([rho[:, None] ** np.arange(n), np.zeros((len(means), n))])
    powers[VALUES:, :16] = means
    return NeighborCorrelation(powers, weight, scale)


@lru_cache(4)  # members of a study mostly have equal numbers of points
def _means(n: int) -> tuple[Array, list[Array]]:
    """Return `LAGS` for n points, and the Cholesky factors of these matrices."""
    from scipy.linalg import cholesky_banded  # noqa: PLC0415  (imports slowly)

    # Errors that are alike over half of the points look like a gain.
    means = LAGS[np.count_nonzero(LAGS > 1e-3, axis=1) <= max(n / 2, 2), :n]
    bands = np.repeat(means[..., None], n, 2)
    return means, [cholesky_banded(band, lower=True) for band in bands]


def averaged_meat(
    scores: ComplexArray,
    root: Array,
    known: NeighborCorrelation,
    correlation: Callable[[Array], Array],
    dof: float,
) -> tuple[Array, float, float]:
    """Return the covariance of the sum of scores, its degrees of freedom, and a scale.

    Errors with the mean correlation, and variances larger than those of independent errors by this
    scale, make the estimate vary as much.

    Parameters
    ----------
    scores : (n, k) complex array
        Derivatives of the residuals times the deviations of their scores if the errors are
        independent, by frequency.
    root : (k, r) array
        Root of the inverse bread.
    known : NeighborCorrelation
    correlation : function of an array
        The correlation of scores by that of their errors.
    dof : float
        Degrees of freedom of the size of the errors.
    """
    n = known.powers.shape[1]
    size = 2 * n
    correlations = correlation(known.powers)
    # Sums over all pairs of points at one distance: a correlation, fast by Fourier transforms.
    transform = np.fft.fft(scores, size, axis=0)
    of_lags = np.fft.ifft(np.sum(np.abs(transform @ root) ** 2, axis=1)).real[:n]
    of_lags[1:] *= 2
    variances = known.scale * (correlations @ of_lags)

    mean = (known.weight * known.scale) @ correlations
    spectrum = 2 * np.fft.fft(mean, size).real - mean[0]
    meat = (transform.conj().T @ (spectrum[:, None] * transform)).real / size
    variance, dof = student_of_average(known.weight, variances, dof)
    average = float(known.weight @ variances)

    if not average > 0:
        return meat, dof, 1.0
    alike = float(correlation(known.mean ** np.arange(n)) @ of_lags)
    return meat * (variance / average), dof, variance / alike


def student_of_average(weight: Array, variance: Array, dof: float) -> tuple[float, float]:
    """Return variance and degrees of freedom of a Student's t that replaces an average of several.

    These have variances (m,) and the same degrees of freedom; the result has the same intervals as
    their average at `LEVELS`. With infinite degrees of freedom, the result is normal
    and has the variance of the average: such variances add over the parts of a problem. With four
    or more degrees of freedom, the 95 % interval of Student's t is within 2 % of that of a normal
    distribution of the same variance.
    """
    from scipy.optimize import brentq  # noqa: PLC0415  (takes a tenth of a second to import)
    from scipy.special import stdtr, stdtrit  # noqa: PLC0415

    if variance.size == 1 or not variance.min() > 0 or math.isinf(dof):
        return float(weight @ variance), dof

    # The interval of the average lies between those of the narrowest and the widest distribution.
    deviation = np.sqrt(variance)
    tails = (1 - np.array(LEVELS)) / 2
    ends = 0.99 * deviation.min(), 1.01 * deviation.max()
    roots: Any = (
        brentq(
            lambda size, tail=tail: stdtr(dof, -size / deviation) @ weight - tail,
            *(-stdtrit(dof, tail) * end for end in ends),
        )
        for tail in tails
    )
    inner, outer = roots

    # The ratio of both intervals falls as the degrees of freedom rise.
    few, most = 1 / dof, 1.0
    for _ in range(40):
        middle = (few + most) / 2
        narrow, wide = stdtrit(1 / middle, tails)
        few, most = (middle, most) if wide / narrow < outer / inner else (few, middle)
    return float((outer / stdtrit(1 / few, 1 - tails[1])) ** 2), 1 / few
