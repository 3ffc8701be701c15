"""Noise levels of several sine tests of one flight, pooled over frequency.

With eight degrees of freedom, one standard error in twenty is less than half of the true one. The
noise of one flight has a smooth spectrum, so each test has information on the others. The levels
scatter about a curve over frequency, partly by chance (their degrees of freedom), partly because
they differ, as in a gust. Empirical Bayes weighs the two (Smyth, Linear models and empirical Bayes
methods, Statistical Applications in Genetics and Molecular Biology 3(1), 2004): every level becomes
the mean of its own value and that of the curve, weighted by degrees of freedom. If the levels
differ by more than chance, the curve has few degrees of freedom, and each test keeps its own level.
"""

import numpy as np
from numpy.typing import ArrayLike

from greybox.data.files.arrays import Array


def pooled_levels(omega: ArrayLike, level: ArrayLike, dof: ArrayLike) -> tuple[Array, Array]:
    """Return the pooled levels and their degrees of freedom.

    Parameters
    ----------
    omega : (n,) array, rad/s
    level : (n,) array
        Power density of the noise, in any unit; estimates with a χ² distribution. Zeros and NaN
        are returned unchanged.
    dof : (n,) array

    Returns
    -------
    level, dof : (n,) arrays
        The degrees of freedom of a level are at most the sum of all.
    """
    from scipy.special import digamma, polygamma  # noqa: PLC0415  (slow import)

    omega, level, dof = (np.array(values, dtype=float) for values in (omega, level, dof))
    used = (level > 0) & (dof > 0)
    order = 2 if used.sum() >= 8 else 1  # with many tests the curve may bend
    # Fewer tests leave less than three degrees of freedom beside a line.
    if used.sum() < 5 or np.unique(omega[used]).size <= order + 1:
        return level, dof

    # With d degrees of freedom, the logarithm of an estimate has the bias ψ(d/2) - log(d/2) and the
    # variance ψ'(d/2).
    half = dof[used] / 2
    logs = np.log(level[used]) - digamma(half) + np.log(half)
    x = np.log(omega[used])
    curve = np.polynomial.Polynomial.fit(x, logs, order)(x)
    spread = np.sum((logs - curve) ** 2) / (used.sum() - order - 1) - np.mean(polygamma(1, half))
    prior = np.inf if spread <= 0 else 2 * _inverse_trigamma(float(spread))
    weight = dof[used] / (prior + dof[used])

    # Levels that differ are modeled as a constant over a χ² variable, whose logarithm is biased
    # too.
    center = curve if np.isinf(prior) else curve + digamma(prior / 2) - np.log(prior / 2)
    level[used] = weight * level[used] + (1 - weight) * np.exp(center)
    dof[used] = np.minimum(prior + dof[used], dof[used].sum())
    return level, dof


def _inverse_trigamma(value: float) -> float:
    """Return x with ψ'(x) = `value`: ψ'(x) lies between 1/x and 1/x + 1/x²."""
    from scipy.optimize import root_scalar  # noqa: PLC0415  (slow import)
    from scipy.special import polygamma  # noqa: PLC0415  (slow import)

    low, high = 0.5 / value, 1 / value + 1 / np.sqrt(value)
    return root_scalar(lambda x: float(polygamma(1, x)) - value, bracket=(low, high)).root
