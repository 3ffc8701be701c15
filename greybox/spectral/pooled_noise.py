"""Noise levels of several sine tests of one flight, each from a few lines: what they have in common.

With eight degrees of freedom, one standard error in twenty is less than half of what it should be.
The noise of one flight has a smooth spectrum, so that the other tests tell of each: the levels
scatter about a curve over frequency, by what their degrees of freedom explain and by what they
really differ, as in a gust. The first is weighed against the second (Smyth, Linear models and
empirical Bayes methods, Statistical Applications in Genetics and Molecular Biology 3(1), 2004):
every level becomes the mean of its own and that of the curve, weighted by degrees of freedom. Where
the levels differ by more than chance, the curve has few, and each test keeps its own.
"""

import numpy as np
from numpy.typing import ArrayLike

from greybox.files.arrays import Array

LEAST = (
    5  # tests, below which three that are left beside a line do not tell how much levels scatter
)
CURVED = 8  # tests, from which the curve may bend


def pooled_levels(omega: ArrayLike, level: ArrayLike, dof: ArrayLike) -> tuple[Array, Array]:
    """Return the levels with what the other tests tell of them, and their degrees of freedom.

    Parameters
    ----------
    omega : (n,) array, rad/s
    level : (n,) array
        Power of the noise for each Hz, in any unit; estimates with a χ² distribution. What is zero
        or NaN is kept.
    dof : (n,) array

    Returns
    -------
    level, dof : (n,) arrays
        The degrees of freedom of one level are at most those of all together.
    """
    from scipy.special import digamma, polygamma  # noqa: PLC0415  (scipy takes longer to import than this package)

    omega, level, dof = (np.array(values, dtype=float) for values in (omega, level, dof))
    used = (level > 0) & (dof > 0)
    order = 2 if used.sum() >= CURVED else 1
    if used.sum() < LEAST or np.unique(omega[used]).size <= order + 1:
        return level, dof

    # The logarithm of a χ² estimate is biased by ψ(d/2) - log(d/2), and has the variance ψ'(d/2).
    half = dof[used] / 2
    logs = np.log(level[used]) - digamma(half) + np.log(half)
    x = np.log(omega[used])
    curve = np.polynomial.Polynomial.fit(x, logs, order)(x)
    spread = np.sum((logs - curve) ** 2) / (used.sum() - order - 1) - np.mean(polygamma(1, half))
    prior = np.inf if spread <= 0 else 2 * _inverse_trigamma(float(spread))
    own = dof[used] / (prior + dof[used])

    # Levels that differ are taken as a number over a χ² variable, whose logarithm is biased
    # likewise.
    center = curve if np.isinf(prior) else curve + digamma(prior / 2) - np.log(prior / 2)
    result, freedom = level.copy(), dof.copy()
    result[used] = own * level[used] + (1 - own) * np.exp(center)
    freedom[used] = np.minimum(prior + dof[used], dof[used].sum())
    return result, freedom


def _inverse_trigamma(value: float) -> float:
    """Return x with ψ'(x) = `value`: ψ'(x) lies between 1/x and 1/x + 1/x²."""
    from scipy.optimize import root_scalar  # noqa: PLC0415  (as above)
    from scipy.special import polygamma  # noqa: PLC0415  (as above)

    low, high = 0.5 / value, 1 / value + 1 / np.sqrt(value)
    return root_scalar(lambda x: float(polygamma(1, x)) - value, bracket=(low, high)).root
