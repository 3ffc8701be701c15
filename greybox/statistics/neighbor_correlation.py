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

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray, all_finite, real_and_imaginary
from greybox.data.files.frozen_values import frozen
from greybox.statistics.column_space import column_basis
from greybox.statistics.neighbor_spectra import error_kinds
from greybox.statistics.student_average import student_of_average

# Probability of independent errors below which a correlation is reported: in simulated fits of 10
# to 100 points it is reported in at most 1 % of those with independent errors.
UNLIKELY = 0.1
# Residuals over the sizes of the errors below which data are fitted exactly.
EXACT = math.sqrt(np.finfo(float).eps)


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

    judged: list[NeighborCorrelation | None] = []
    for errors, posterior, prior in zip(responses, together, alone, strict=True):
        # Above this posterior probability errors count as independent. Intervals of a response with
        # 8 to 40 points of independent errors are then 2 to 18 % wider in the mean, and cover 95 to
        # 97 %.
        if posterior > 0.6:
            judged.append(None)
            continue
        correlated = errors.weight[1:] * (1 - posterior) / (1 - prior)
        judged.append(replace(errors, weight=np.append(posterior, correlated)))
    return judged


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
