"""How the errors of a record are distributed, and so how much large ones count in an estimate.

An estimate is robust if errors count as ψ(e), with a function ψ that grows less than e. Least
squares on the *pseudo-values* model + ψ(e) / mean(ψ') have the same estimate, and the covariance of
that M-estimator. So everything made for least squares, including correlated errors, works with
outliers, too.

Source: Huber and Ronchetti (2009), Robust Statistics, 2nd ed., sections 7.4 and 7.8.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from greybox.data.files.arrays import Array


class ErrorDistribution(ABC):
    """A distribution of the errors of outputs, by its influence function ψ.

    A subclass is a frozen dataclass with its settings as fields. For the density exp(-ρ(e)), ψ is
    the derivative of ρ.

    Attributes
    ----------
    description : str
        Words that follow the rule of a criterion, such as "large errors bounded".
    is_normal : bool
        Whether ψ(e) = e, so that an estimate is one of least squares.
    """

    description: ClassVar[str] = ""
    is_normal: ClassVar[bool] = False

    @abstractmethod
    def influence(self, errors: Array) -> Array:
        """Return ψ of errors in standard deviations (k, n), NaN if missing."""

    @abstractmethod
    def slope(self, errors: Array) -> Array:
        """Return the derivative of ψ at errors in standard deviations (k, n)."""

    def pseudo_errors(self, stretches: Sequence[Array]) -> list[Array]:
        """Return ψ(e) / mean(ψ') of the errors (k, n) of several stretches, NaN if missing."""
        errors = np.hstack(stretches)
        deviation = robust_deviation(errors)
        # Errors without a scale stay as they are.
        has_scale = np.isfinite(deviation)
        scale = np.where(has_scale, deviation, 1.0)

        measured = np.isfinite(errors)
        slopes = np.where(measured, self.slope(errors / scale), 0.0)
        mean_slope = slopes.sum(axis=1, keepdims=True) / measured.sum(axis=1, keepdims=True)
        return [
            np.where(has_scale, scale * self.influence(e / scale) / mean_slope, e)
            for e in stretches
        ]


@dataclass(frozen=True)
class NormalErrors(ErrorDistribution):
    """Normal errors: all count as they are."""

    is_normal: ClassVar[bool] = True

    def influence(self, errors: Array) -> Array:
        """Return the errors."""
        return errors

    def slope(self, errors: Array) -> Array:
        """Return ones."""
        return np.ones_like(errors)


def robust_deviation(errors: Array) -> Array:
    """Return the standard deviations (k, 1) of errors (k, n), NaN if missing, by their medians."""
    # The median size of normal errors times 1.4826 is their standard deviation.
    deviation = 1.4826 * np.nanmedian(np.abs(errors), axis=1, keepdims=True)
    # Where more than half of all errors are zero, as in rounded signals, there is no scale.
    return np.where(deviation > 0, deviation, np.inf)
