"""A Student's t distribution in place of an average of several."""

import math
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array

# Levels at which the intervals of an average of distributions and of Student's t must agree: those
# of a standard error, and of the printed interval.
LEVELS = (0.6827, 0.95)


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

    def half_width(tail: float) -> Any:
        """Return the half-width of the interval that leaves this share at each side."""
        widest = -1.01 * stdtrit(dof, tail) * deviation.max()
        return brentq(lambda size: stdtr(dof, -size / deviation) @ weight - tail, 0, widest)

    inner = half_width(tails[0])
    outer = half_width(tails[1])
    if math.isinf(dof):
        return float((inner / stdtrit(dof, tails[0])) ** 2), dof

    # The ratio of both intervals falls as the degrees of freedom rise.
    few, most = 1 / dof, 1.0
    for _ in range(40):
        middle = (few + most) / 2
        narrow, wide = stdtrit(1 / middle, tails)
        few, most = (middle, most) if wide / narrow < outer / inner else (few, middle)
    return float((outer / stdtrit(1 / few, 1 - tails[1])) ** 2), 1 / few
