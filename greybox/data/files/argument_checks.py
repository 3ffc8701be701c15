"""Checks of arguments, whose messages name the value and say what to give."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set, ValuesView
from numbers import Integral, Real
from typing import Any

import numpy as np


def as_names(names: str | Iterable[str]) -> tuple[str, ...]:
    """Return one name or several as a tuple."""
    return (names,) if isinstance(names, str) else tuple(names)


def require_kind(what: str, value: object, kinds: Any, cure: str) -> None:
    """Raise TypeError for a value that is not of these kinds; the message says to give `cure`."""
    if not isinstance(value, kinds):
        raise TypeError(f"{what} is {value!r:.80}: give {cure}.")


def is_finite_number(value: Any) -> bool:
    """Return whether a value is a finite real number, of Python or of numpy."""
    return isinstance(value, Real) and math.isfinite(value)


def require_whole(name: str, value: Any, least: int, most: float = math.inf) -> None:
    """Raise ValueError for anything but a whole number within these limits."""
    is_whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not is_whole or not least <= value <= most:  # type: ignore[operator]
        limits = f"of at least {least}" if math.isinf(most) else f"from {least} to {most}"
        raise ValueError(f"{name} is {value!r}: give a whole number {limits}.")


def checked_items(what: str, items: Any, kinds: Any, cure: str) -> tuple[Any, ...]:
    """Return one item or several as a tuple, each checked by `require_kind`."""
    # Records and messages of a log can be iterated as well: they yield names.
    is_several = isinstance(items, Sequence | Set | Mapping | ValuesView | Iterator | np.ndarray)
    is_single = isinstance(items, kinds | str) or not is_several
    listed = (items,) if is_single else tuple(items)
    for item in listed:
        require_kind(what, item, kinds, cure)
    return listed
