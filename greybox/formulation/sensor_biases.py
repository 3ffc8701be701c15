"""Sensor biases in a sum of problems: they belong to the record, whose number their names get."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, Self, TypeVar

import numpy as np

from greybox.data.record import Record
from greybox.formulation.held_estimate import Estimated
from greybox.modeling.model import Model
from greybox.modeling.parameter import Parameter


class Summand(Protocol):
    """What is looked at of a problem."""

    @property
    def model(self) -> Model:
        """The structure."""
        ...

    @property
    def data(self) -> Any:
        """A record, or a frequency response."""
        ...

    @property
    def rename(self) -> Mapping[str, str]:
        """Names outside."""
        ...

    @property
    def declared(self) -> Mapping[str, Parameter]:
        """The parameters of the model and the criterion."""
        ...

    @property
    def given(self) -> Mapping[str, Any]:
        """The fixed values."""
        ...

    def with_(self, **changes: Any) -> Self:
        """Return the same problem with some fields changed."""
        ...


Part = TypeVar("Part", bound=Summand)


def with_own_biases(parts: Sequence[Part]) -> tuple[Part, ...]:
    """Return the parts with biases of one name numbered by the record, where more than one record has that name.

    Parts of one record share its biases. A bias that a part renames, be it to its own name, or that is fixed at an
    earlier fit, which knows it by its name, keeps that name, so that it can be shared.
    """
    numbers, unnamed = _numbers([part.data for part in parts]), [_unnamed(part) for part in parts]
    outside = [{part.rename.get(name, name) for name in part.declared} for part in parts]
    taken = set(itertools.chain(*outside))
    chosen: dict[tuple[str, int], str] = {}
    for name in dict.fromkeys(itertools.chain(*unnamed)):
        owners = sorted({number for number, names in zip(numbers, unnamed, strict=True) if name in names})
        everywhere = {number for number, names in zip(numbers, outside, strict=True) if name in names}
        for number in owners if len(everywhere) > 1 else ():
            chosen[name, number] = next(n for k in itertools.count(number) if (n := f"{name}_{k}") not in taken)
            taken.add(chosen[name, number])
    result = []
    for part, number, names in zip(parts, numbers, unnamed, strict=True):
        own = {name: chosen[name, number] for name in names if (name, number) in chosen}
        result.append(part.with_(rename={**part.rename, **own}) if own else part)
    return tuple(result)


def _unnamed(part: Summand) -> list[str]:
    """Return the biases of a part that may get a name of their own."""
    added = [name for name in part.declared if name.endswith("_bias") and name not in part.model.parameters]
    return [n for n in added if n not in part.rename and not isinstance(part.given.get(n), Estimated)]


def _numbers(data: Sequence[Any]) -> list[int]:
    """Return the number of every record among the different ones; 0 for what is none."""
    different: list[Record] = []
    for item in data:
        if isinstance(item, Record) and not any(_is_same(item, record) for record in different):
            different.append(item)
    return [next((k for k, record in enumerate(different, 1) if _is_same(item, record)), 0) for item in data]


def _is_same(a: Any, b: Record) -> bool:
    if not isinstance(a, Record):
        return False
    return a is b or (a.checksum == b.checksum and np.array_equal(a.time, b.time))
