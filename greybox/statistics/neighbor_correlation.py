"""The correlation of errors of neighboring points along frequency, from the residuals of a fit.

The correlation is taken to fall exponentially with the number of points between, rho^|i - j|, real
and imaginary parts alike: so do errors of points that are closer than the resolution of their
transform, and of a model that leaves something smooth out. Twenty points tell rho to about 0.15,
which no one value stands for: standard errors and intervals are averaged over all values that it
may have, each with its restricted likelihood, which counts what the fitted parameters took from the
errors. That there is none is as likely before as that there is one, and where it is twice as likely
afterwards, errors count as independent: of independent ones in nine of ten fits of 48 points, two
of three of
12. `benchmarks/neighbor_coverage.py` shows what that costs.

Sources: Patterson and Thompson (1971), Recovery of inter-block information when block sizes are
unequal, Biometrika 58 (restricted likelihood); Tunnicliffe Wilson (1989), On the use of marginal
likelihood in time series model estimation, JRSS B 51 (of an autoregression); Hoeting, Madigan,
Raftery and Volinsky (1999), Bayesian Model Averaging: A Tutorial, Statistical Science 14.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from greybox.files.arrays import Array, ComplexArray
from greybox.statistics.column_space import column_basis

INDEPENDENT = 0.5  # how likely independent errors are before
# How likely afterwards, where they are taken for sure: intervals then change by less than 8 %, and
# hold half a per cent less of the truths.
TAKEN_FOR_SURE = 2 / 3
# Values of rho, evenly up to a correlation over all points: steps are below its error up to 10 000
# points.
VALUES = 200
LEAST_WEIGHT = 1e-6  # of a value of rho: what is below does not show
LEAST_LEFT = 4  # numbers beyond the parameters: fewer tell nothing of a correlation
# Residuals over the sizes of the errors below which data are fitted exactly.
EXACT = math.sqrt(np.finfo(float).eps)

# Levels of the two intervals by which an average of distributions becomes one of Student's t: that
# of a standard error, and the one that is printed.
LEVELS = (0.6827, 0.95)
BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class NeighborCorrelation:
    """What is known of the correlation of neighboring errors.

    Attributes
    ----------
    points : int
    rho : (m,) array
        Values that it may have, from zero on.
    weight : (m,) array
        How likely they are, in all one.
    scale : (m,) array
        How many times larger the variance of the errors is than if they were independent: fits take
        more from slow ones.
    """

    points: int
    rho: Array
    weight: Array
    scale: Array

    @property
    def independent(self) -> float:
        """The probability that the errors are independent."""
        return float(self.weight[self.rho == 0].sum())

    @property
    def mean(self) -> float:
        """The mean correlation of neighbors."""
        return float(self.weight @ self.rho)

    @property
    def lengths(self) -> float:
        """Number of points over the correlation length, where the mean correlation falls to 1/e."""
        return -math.log(self.mean) * self.points if self.mean > 0 else math.inf

    @cached_property
    def powers(self) -> Array:
        """Correlations (m, n) of errors 0 to n - 1 points apart."""
        return self.rho[:, None] ** np.arange(self.points)


def neighbor_correlation(
    errors: ComplexArray, design: Array, inflation: float | None = None
) -> NeighborCorrelation | None:
    """Return what the residuals of a fit tell of the correlation of their errors.

    Parameters
    ----------
    errors : (n,) complex array
        Residuals over the sizes of the errors, by frequency.
    design : (2n, p) array
        What the fit may have taken from them, in the same units: derivatives, real parts first.
    inflation : float, optional
        How many times larger than they should be the squares are, where sizes were given: these are
        believed where the residuals are smaller. Without it the residuals tell the size.

    Returns
    -------
    NeighborCorrelation or None
        None where errors count as independent: too few numbers are left, the data are fitted
        exactly, or the residuals say so.
    """
    n = errors.size
    if n < 2 or not (np.all(np.isfinite(design)) and np.all(np.isfinite(errors))):
        return None
    if not np.sqrt(np.mean(np.abs(errors) ** 2)) > EXACT:
        return None

    # What the parameters took from the errors is missing in the residuals.
    basis = column_basis(design)
    numbers = 2 * n - basis.shape[1]
    if numbers < LEAST_LEFT:
        return None

    rho = np.linspace(0.0, math.exp(-1 / n), VALUES)
    # The inverse of a matrix rho^|i - j| has three diagonals.
    rows = np.column_stack([errors, basis[:n] + 1j * basis[n:]])
    squares_of_rows = (rows.conj().T @ rows).real
    ends = (rows[[0, -1]].conj().T @ rows[[0, -1]]).real
    beside = (rows[1:].conj().T @ rows[:-1]).real
    share = rho[:, None, None]
    moments = (1 + share**2) * squares_of_rows - share**2 * ends - share * (beside + beside.T)
    moments /= 1 - share**2
    gradient, information = moments[:, 1:, :1], moments[:, 1:, 1:]
    squares = moments[:, 0, 0] - np.sum(
        gradient * np.linalg.solve(information, gradient), axis=(1, 2)
    )

    if (
        not squares.min() > EXACT**2 * squares_of_rows[0, 0]
    ):  # what is left was all taken, but for rounding
        return None

    squares /= squares[0]
    if inflation is None:
        scale, score = squares, numbers * np.log(squares)
    else:
        size = np.maximum(inflation * squares, 1.0)
        scale, score = size / size[0], numbers * (np.log(size) + inflation * squares / size)

    score += 2 * (n - 1) * np.log(1 - rho**2) + np.linalg.slogdet(information)[1]

    prior = np.full(VALUES, (1 - INDEPENDENT) / (VALUES - 1))
    prior[0] = INDEPENDENT
    weight = prior * np.exp(-(score - score.min()) / 2)
    weight /= weight.sum()
    if weight[0] > TAKEN_FOR_SURE:
        return None

    # Most values have no weight, and each costs a column of powers.
    likely = weight > LEAST_WEIGHT
    weight = weight[likely] / weight[likely].sum()
    return NeighborCorrelation(n, rho[likely], weight, scale[likely])


def averaged_meat(
    scores: ComplexArray,
    root: Array,
    known: NeighborCorrelation,
    correlation: Callable[[Array], Array],
    dof: float,
) -> tuple[Array, float, float]:
    """Return the covariance of the sum of scores, its degrees of freedom, and a scale.

    The last number is how many times larger than those of independent errors the variances of
    errors are that have the mean correlation and make the estimate vary as much.

    Parameters
    ----------
    scores : (n, k) complex array
        Derivatives of the residuals times the deviations of their scores if the errors are
        independent, by frequency.
    root : (k, r) array
        Of the inverse bread.
    known : NeighborCorrelation
    correlation : function of an array
        The correlation of scores whose errors have a correlation.
    dof : float
        Degrees of freedom of the size of the errors.
    """
    n = known.points
    size = 1 << (2 * n - 1).bit_length()
    correlations = correlation(known.powers)
    # Sums over all pairs of points by their distance: a correlation, fast by transforms.
    turned = np.fft.fft(scores @ root, size, axis=0)
    of_lags = np.fft.ifft(np.sum(np.abs(turned) ** 2, axis=1)).real[:n]
    of_lags[1:] *= 2
    variances = known.scale * (correlations @ of_lags)

    mean = (known.weight * known.scale) @ correlations
    spectrum = np.fft.fft(np.concatenate([mean, np.zeros(size - 2 * n + 1), mean[:0:-1]])).real
    transform = np.fft.fft(scores, size, axis=0)
    meat = (transform.conj().T @ (spectrum[:, None] * transform)).real / size
    variance, dof = student_of_average(known.weight, np.maximum(variances, 0.0), dof)
    average = float(known.weight @ variances)

    if not average > 0:
        return meat, dof, 1.0
    alike = float(correlation(np.power(known.mean, np.arange(n, dtype=float))) @ of_lags)
    return meat * (variance / average), dof, variance / alike


def student_of_average(weight: Array, variance: Array, dof: float) -> tuple[float, float]:
    """Return variance and degrees of freedom of Student's t like an average of such distributions.

    These have variances (m,) and the same degrees of freedom; the result has the same intervals at
    `LEVELS`.
    """
    from scipy.special import stdtr, stdtrit  # noqa: PLC0415  (takes a tenth of a second to import)

    dof = min(dof, 1e9)
    if variance.size == 1 or not variance.min() > 0:
        return float(weight @ variance), dof

    deviation = np.sqrt(variance)
    tails = (1 - np.array(LEVELS)) / 2
    unit = -stdtrit(dof, tails)
    low, high = deviation.min() * unit, deviation.max() * unit

    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        outside = stdtr(dof, -middle[:, None] / deviation) @ weight
        low, high = np.where(outside > tails, middle, low), np.where(outside > tails, high, middle)

    inner, outer = (low + high) / 2

    # The ratio of both intervals falls as the degrees of freedom rise.
    few, many = 1 / dof, 1.0
    for _ in range(BISECTIONS):
        middle = (few + many) / 2
        ratio = stdtrit(1 / middle, tails)
        few, many = (middle, many) if ratio[1] / ratio[0] < outer / inner else (few, middle)

    dof = 1 / few
    return float((outer / stdtrit(dof, 1 - tails[1])) ** 2), float(dof)
