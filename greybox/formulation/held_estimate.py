"""An earlier answer, as a problem takes it for values that it holds."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class Estimated(Protocol):
    """An earlier answer, as `fixed` takes it: values and their covariance."""

    @property
    def estimate(self) -> Mapping[str, float]:
        """Values by name."""
        ...

    @property
    def dof(self) -> float:
        """Degrees of freedom of the covariance."""
        ...

    def covariance_of(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return the covariance matrix of the named parameters."""
        ...
