"""What noise makes of a sum of relative errors: its bias, its curvature and the spread of its gradient, exactly.

A measurement P̂ = P (1 + ε) with ε isotropic normal of standard deviation σ in each component
leaves the error of a model g P a function of g and ε alone, whatever P is: e = g / (1 + ε) - 1 over
the measured magnitude, and 1 - (1 + ε) / g over the model's. So the factor g to which the criterion
draws the gain, the mean curvature and the variance of the gradient are numbers that depend on σ
alone. They are means over errors up to a magnitude that one point in 2n exceeds, which the largest
of n falls short of as often as not: moments of 1 / (1 + ε) over all errors are infinite, since a
measurement may come out as zero.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from greybox.files.arrays import Array

FEWEST, MOST = 8, 100  # points: means over errors up to 2.4 σ at least, and 3.3 σ at most
RADII = 12  # of errors, in a quadrature of Gauss
ANGLES = (
    16  # of an error: means over a circle that comes as close as 0.4 to zero are then exact to 3e-4
)
LARGEST_NOISE = 0.3  # beyond, errors are as large as what is measured, and nothing that is divided by it has a mean
SMALLEST_NOISE = 1e-4  # below, rounding is felt, and all is proportional to σ to eight digits
ITERATIONS = (
    30  # of reweighted least squares for the gain, at most: each leaves half of what was left of it
)
ACCURATE = 1e-3  # of σ², to which it is found

# Relative errors below cannot be told from rounding: those of data that a model reproduces exactly.
ROUNDING = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class RelativeScore:
    """What the gradient of a sum of relative errors is like, of one point, by the logarithm of the response.

    Attributes
    ----------
    gain_bias : float
        The part of the estimated gain by which it is too large in the mean.
    curvature : float
        Of the mean cost, along the response as across it.
    variance : (2,) array
        Of the gradient, along and across the response.
    """

    gain_bias: float
    curvature: float
    variance: Array


@lru_cache(maxsize=64)
def relative_score(
    noise: float, points: int, power: int, normalized: Literal["measured", "model"]
) -> RelativeScore:
    """Return what noise of standard deviation `noise` in each component makes of the sum of |e|^`power` of points."""
    size = min(max(noise, SMALLEST_NOISE), LARGEST_NOISE)
    node, share = np.polynomial.legendre.leggauss(RADII)
    radius = (node + 1) / 2 * math.sqrt(2 * math.log(2 * min(max(points, FEWEST), MOST)))
    share = share * radius * np.exp(-(radius**2) / 2)
    share = (share / share.sum() / ANGLES)[:, None]
    # What is cut off would be missed by small errors too, of which everything is known: their mean
    # of |ε|^power.
    known = 2 ** (power / 2) * math.gamma(1 + power / 2)
    radius *= (known / (ANGLES * float(share[:, 0] @ radius**power))) ** (1 / power)
    angles = 2 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    error = size * radius[:, None] * np.exp(1j * angles)
    factor = 1 / (1 + error) if normalized == "measured" else 1 + error
    gain = 1.0
    for _ in range(ITERATIONS):
        weight = share * np.abs(gain * factor - 1) ** (power - 2)
        before, gain = (
            gain,
            float(np.sum(weight * factor.real) / np.sum(weight * np.abs(factor) ** 2)),
        )
        if abs(gain - before) < ACCURATE * size**2:
            break
    ratio = gain * factor
    score = power * np.abs(ratio - 1) ** (power - 2) * (ratio - 1) * ratio.conj()
    # The mean curvature is the covariance of this gradient with that of the likelihood, whichever
    # the criterion.
    likelihood = error * (1 + error).conj() / size**2 - 2
    curvature = abs(float(np.sum(share * (score * likelihood.conj()).real))) / 2
    variance = np.array([np.sum(share * score.real**2), np.sum(share * score.imag**2)])
    away = 1 - 1 / gain if normalized == "measured" else 1 - gain
    # What is below or beyond the range scales as small noise does, but for a bias that would reach
    # the gain itself.
    times = max(noise, ROUNDING) / size
    return RelativeScore(
        away * min(times, 1.0) ** 2,
        curvature * times ** (power - 2),
        variance * times ** (2 * power - 2),
    )
