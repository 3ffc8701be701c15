"""Values by name: some of them, and their places and values in arrays."""

from collections.abc import Container, Iterable, Mapping
from types import MappingProxyType
from typing import Any, NoReturn, TypeVar

import numpy as np

from greybox.data.files.arrays import AnyArray, IntArray
from greybox.data.files.spelling import alternatives

Value = TypeVar("Value")

Values = Mapping[str, float]  # of parameters or signals
NOTHING: Values = MappingProxyType({})  # as a default


class ByName(dict[str, Value]):
    """Values by name, which answer an unknown name with the closest one."""

    def __missing__(self, name: str) -> NoReturn:
        raise KeyError(f"{name!r} is none of the names {alternatives(name, self)}")


def attributes(value: Any, *names: str) -> dict[str, Any]:
    """Return some attributes by name."""
    return {name: getattr(value, name) for name in names}


def selected(values: Mapping[str, Any], names: Container[str]) -> dict[str, Any]:
    """Return the values whose names are among these, in their own order."""
    return {name: value for name, value in values.items() if name in names}


def without(values: Mapping[str, Any], names: Container[str]) -> dict[str, Any]:
    """Return the values whose names are not among these, in their own order."""
    return {name: value for name, value in values.items() if name not in names}


def array_of(values: Any, names: Iterable[Any]) -> AnyArray:
    """Return the values of these names, numbers or arrays of equal lengths, in one array."""
    return np.array([values[name] for name in names])


def places_of(names: Iterable[str], among: tuple[str, ...]) -> IntArray:
    """Return the places of some names among others."""
    return np.array([among.index(name) for name in names], dtype=int)


def non_empty(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are not empty: no zero, empty text or table, and not None."""
    return {name: value for name, value in values.items() if value}
