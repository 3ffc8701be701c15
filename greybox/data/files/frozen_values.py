"""Frozen dataclasses that hold arrays."""

from dataclasses import dataclass, field
from typing import TypeVar, dataclass_transform

Kind = TypeVar("Kind")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def frozen(kind: type[Kind]) -> type[Kind]:
    """Make a class a frozen dataclass without an equality of its own.

    Values with arrays have none: whether two arrays are equal is an array, too. Those that print
    themselves have the `repr` of `Printed`.
    """
    return dataclass(frozen=True, eq=False, repr=not hasattr(kind, "_repr_html_"))(kind)
