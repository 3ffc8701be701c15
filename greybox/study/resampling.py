"""Intervals from replicates of an estimate, and blocks of a series in time."""

import math

import numpy as np
from numpy.typing import ArrayLike

from greybox.files.arrays import Array, IntArray


def percentile_interval(
    values: ArrayLike, level: float, dof: float = math.inf
) -> tuple[float, float]:
    """Return the interval between the quantiles of replicates (b,); NaN without any.

    With few degrees of freedom the quantiles lie as far out as Student's t: replicates scatter by
    errors whose size was estimated, and know nothing of how well. Source: Hesterberg (2015), What
    teachers should know about the bootstrap, The American Statistician 69 (the expanded percentile
    interval).
    """
    from scipy.special import ndtr  # noqa: PLC0415  (takes a tenth of a second to import)

    ends = ndtr(_normal_ends(level, dof))
    return _between(np.asarray(values, dtype=float), ends)


def bca_interval(
    values: ArrayLike, estimate: float, acceleration: float, level: float, dof: float = math.inf
) -> tuple[float, float]:
    """Return the bias-corrected and accelerated interval of replicates (b,); NaN where the estimate is beyond all.

    `dof` as of `percentile_interval`. Source: Efron (1987), Better bootstrap confidence intervals,
    JASA 82; Efron and Tibshirani (1993), An Introduction to the Bootstrap, section 14.3.
    """
    from scipy.special import ndtr, ndtri  # noqa: PLC0415  (as above)

    found = np.asarray(values, dtype=float)
    below = float(np.mean(found < estimate) + np.mean(found <= estimate)) / 2 if found.size else 0.0
    if not 0 < below < 1:
        return math.nan, math.nan
    bias = float(ndtri(below))
    normal = bias + _normal_ends(level, dof)
    return _between(found, ndtr(bias + normal / (1 - acceleration * normal)))


def tail(level: float, dof: float = math.inf) -> float:
    """Return the share of replicates beyond each end of a percentile interval."""
    from scipy.special import ndtr  # noqa: PLC0415  (as above)

    return float(ndtr(_normal_ends(level, dof)[0]))


def acceleration(left_out: ArrayLike) -> Array:
    """Return the acceleration (q,) of quantities from their values (m, q) with one observation left out each.

    Source: Efron and Tibshirani (1993), equation (14.15).
    """
    values = np.asarray(left_out, dtype=float)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 2:
        return np.zeros(values.shape[1])
    away = values.mean(axis=0) - values
    squares = (away**2).sum(axis=0)
    return np.where(
        squares > 0, (away**3).sum(axis=0) / (6 * np.where(squares > 0, squares, 1.0) ** 1.5), 0.0
    )


def drawn_blocks(random: np.random.Generator, count: int, size: int, length: int) -> IntArray:
    """Return `count` places of a series of `size` samples, in blocks of so many that follow each other on a circle."""
    first = random.integers(0, size, -(-count // length))
    return ((first[:, None] + np.arange(length)) % size).ravel()[:count]


def _normal_ends(level: float, dof: float) -> Array:
    """Return the ends of an interval of Student's t, in standard errors."""
    from scipy.special import stdtrit  # noqa: PLC0415  (as above)

    quantile = float(stdtrit(min(dof, 1e9), 0.5 + level / 2))
    return np.array([-quantile, quantile])


def _between(values: Array, shares: Array) -> tuple[float, float]:
    if not values.size or not np.all(np.isfinite(shares)):
        return math.nan, math.nan
    low, high = np.quantile(values, shares)
    return float(low), float(high)
