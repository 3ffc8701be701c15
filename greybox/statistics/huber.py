"""Huber's distribution: errors beyond a bound count as the bound, so outliers do not decide."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from greybox.data.files.arrays import Array
from greybox.statistics.error_distribution import ErrorDistribution


@dataclass(frozen=True)
class HuberErrors(ErrorDistribution):
    """Normal errors with exponential tails: ψ is linear up to a bound, and constant beyond it.

    Parameters
    ----------
    bound : float
        In standard deviations. 1.345 is 95 % efficient for normal errors.

    Source: Huber and Ronchetti (2009), Robust Statistics, 2nd ed., section 7.8.
    """

    bound: float = 1.345
    description: ClassVar[str] = "large errors bounded"

    def influence(self, errors: Array) -> Array:
        """Return the errors within the bound, and the bound for those beyond it."""
        return np.clip(errors, -self.bound, self.bound)

    def slope(self, errors: Array) -> Array:
        """Return one within the bound, and zero beyond it."""
        return np.where(np.abs(errors) > self.bound, 0.0, 1.0)
