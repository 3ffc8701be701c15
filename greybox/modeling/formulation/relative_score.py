"""Bias, curvature and spread of the gradient of a sum of relative errors under noise, exactly.

If a measurement is P̂ = P (1 + ε), with ε isotropic, normal and of standard deviation σ in each
component, the error of a model g P depends only on g and ε: e = g / (1 + ε) - 1 relative to the
measured magnitude, and 1 - (1 + ε) / g relative to the model's. So the factor g toward which the
criterion biases the gain, the mean curvature, and the variance of the gradient depend on σ only.
They are means over errors up to a magnitude that one point in 2n exceeds, about the median of the
largest of n errors: moments of 1 / (1 + ε) over all errors are infinite, since a measurement may be
zero.
"""

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen

# Smaller relative errors are rounding errors, of data that a model reproduces exactly.
ROUNDING = float(np.finfo(float).eps)

NODES = np.polynomial.legendre.leggauss(12)


@frozen
class RelativeScore:
    """Statistics of one point of a sum of relative errors, by the logarithm of the response.

    Attributes
    ----------
    gain_bias : float
        Mean relative bias of the estimated gain.
    curvature : float
        Curvature of the mean cost, the same along and across the response.
    variance : (2,) array
        Variances of the gradient, along and across the response.
    """

    gain_bias: float
    curvature: float
    variance: Array


@lru_cache(maxsize=64)
def relative_score(
    noise: float, points: int, power: int, normalized: Literal["measured", "model"]
) -> RelativeScore:
    """Return the statistics of Σ |e|^`power` for `noise`, the deviation of each component."""
    # Below 1e-4, rounding errors matter, and everything is a power of σ to eight digits. Beyond
    # 0.3, errors are as large as the measurement, and nothing divided by it has a mean.
    size = min(max(noise, 1e-4), 0.3)
    # Means over a circle that comes as close as 0.4 to zero are exact to 3e-4 with 16 angles.
    # Errors reach 2.4 to 3.3 σ, for 8 to 100 points.
    angles = math.tau * (np.arange(16) + 0.5) / 16
    node, share = NODES
    radius = (node + 1) / 2 * math.sqrt(2 * math.log(2 * min(max(points, 8), 100)))
    share = share * radius * np.exp(-(radius**2) / 2)
    share = (share / share.sum() / angles.size)[:, None]
    # Scale the radii so that the mean of |ε|^power is exact although the tail is cut off.
    moment = 2 ** (power / 2) * math.gamma(1 + power / 2)
    radius *= (moment / (angles.size * float(share[:, 0] @ radius**power))) ** (1 / power)

    error = size * radius[:, None] * np.exp(1j * angles)
    factor = 1 / (1 + error) if normalized == "measured" else 1 + error

    gain = 1.0
    real = factor.real
    square = np.abs(factor) ** 2
    # Reweighted least squares: each iteration halves the remaining error.
    for _ in range(30):
        weight = share * np.abs(gain * factor - 1) ** (power - 2)
        previous = gain
        gain = float(np.vdot(weight, real) / np.vdot(weight, square))
        if abs(gain - previous) < 1e-3 * size**2:
            break

    ratio = gain * factor
    score = power * np.abs(ratio - 1) ** (power - 2) * (ratio - 1) * ratio.conj()
    # For any criterion, the mean curvature is the covariance of its gradient with that of the
    # likelihood.
    likelihood = error * (1 + error).conj() / size**2 - 2
    curvature = abs(float(np.sum(share * (score * likelihood.conj()).real))) / 2
    variance = np.array([np.sum(share * score.real**2), np.sum(share * score.imag**2)])
    away = 1 - 1 / gain if normalized == "measured" else 1 - gain

    # Outside the range everything scales as with small noise, but the bias is limited, since it
    # would otherwise reach the gain itself.
    times = max(noise, ROUNDING) / size
    return RelativeScore(
        away * min(times, 1.0) ** 2,
        curvature * times ** (power - 2),
        variance * times ** (2 * power - 2),
    )
