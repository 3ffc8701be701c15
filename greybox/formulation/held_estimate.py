"""An earlier fit whose values a problem uses as constants; its covariance widens the errors."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from greybox.files.arrays import Array


@runtime_checkable
class HeldEstimate(Protocol):
    """Values and their covariance, as a `Fit` has them."""

    @property
    def estimate(self) -> Mapping[str, float]:
        """Values by name."""
        ...

    @property
    def dof(self) -> float:
        """Degrees of freedom of the covariance."""
        ...

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Return the covariance matrix of the named parameters."""
        ...
