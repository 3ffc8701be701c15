"""An earlier fit whose values a problem uses as constants; its covariance widens the errors."""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values


@runtime_checkable
class HeldEstimate(Protocol):
    """Values and their covariance, as a `Fit` has them."""

    @property
    def estimate(self) -> Values:
        """Values by name."""
        ...

    @property
    def dof(self) -> float:
        """Degrees of freedom of the covariance."""
        ...

    def covariance_of(self, names: Sequence[str]) -> Array:
        """Return the covariance matrix of the named parameters."""
        ...


def shared_parameters(
    held: HeldEstimate, outside: Mapping[str, str], what: str
) -> dict[str, HeldEstimate]:
    """Return the estimate by the name of every parameter that it has under its outside name.

    An earlier fit may have other parameters, which a problem does not need.

    Raises
    ------
    ValueError
        If it has none of them; `what` is the option.
    """
    shared = {name: held for name, label in outside.items() if label in held.estimate}
    if not shared:
        raise ValueError(
            f"the Fit given as {what} has {', '.join(held.estimate)}, and none of these is a "
            f"parameter here: {', '.join(outside.values())}."
        )
    return shared
