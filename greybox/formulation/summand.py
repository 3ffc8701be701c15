"""What a sum asks of the problems in it; `Problem` answers it."""

from collections.abc import Mapping
from typing import Any, Protocol, Self, TypeVar

from greybox.formulation.criterion import AnyCriterion
from greybox.formulation.held_estimate import HeldEstimate
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameter


class Summand(Protocol):
    """One model with its data: names inside (of the model and the criterion) and outside (of the sum)."""

    @property
    def name(self) -> str:
        """A label."""
        ...

    @property
    def model(self) -> Model:
        """The structure."""
        ...

    @property
    def data(self) -> Any:
        """A record, or a frequency response."""
        ...

    @property
    def criterion(self) -> AnyCriterion:
        """The rule that measures the mismatch."""
        ...

    @property
    def has_default_criterion(self) -> bool:
        """Whether nothing else was asked for."""
        ...

    @property
    def rename(self) -> Mapping[str, str]:
        """From names inside to names outside, where they differ."""
        ...

    @property
    def tied(self) -> Mapping[str, Any]:
        """Parameters that are expressions of the others, by names inside."""
        ...

    @property
    def declared(self) -> Mapping[str, Parameter]:
        """The parameters of the model and of the criterion, by names inside."""
        ...

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Parameters by names outside, without tied ones."""
        ...

    @property
    def fixed_values(self) -> Mapping[str, Any]:
        """Numbers and earlier answers, by names inside."""
        ...

    @property
    def held_estimates(self) -> Mapping[str, HeldEstimate]:
        """The earlier answers among the fixed values, by names outside."""
        ...

    def outside(self, name: str) -> str:
        """Return the name outside of a parameter."""
        ...

    def local_values(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Name the values of the model's parameters, given those by names outside."""
        ...

    def with_(self, **changes: Any) -> Self:
        """Return the same problem with some fields changed."""
        ...


Part = TypeVar("Part", bound=Summand)
