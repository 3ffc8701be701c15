"""Frozen values as JSON, written by their fields and read by annotations.

A dataclass and a mapping are objects in JSON, a tuple is a list. An array of numbers is an object
with its shape and its numbers. A complex one has two parts, real and imaginary. What is read has
the annotated kind, and its texts can be printed.
"""

import dataclasses
import types
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import complex_array
from greybox.data.files.control_characters import printable

ITEMS = {np.bool_: bool, np.integer: int, np.floating: float}
LINES = "\n\t"  # control characters of docstrings, source and warnings
LONGEST = 100_000  # characters of one text: a table pads every cell of a column to the longest


def require(condition: bool, message: str) -> None:
    """Raise ValueError for a file whose values do not fit together."""
    if not condition:
        raise ValueError(message)


@cache
def fields_of(kind: type) -> dict[str, Any]:
    """Return the annotations of the stored fields of a dataclass by name."""
    hints = get_type_hints(kind)
    stored = [field for field in dataclasses.fields(kind) if field.metadata.get("stored", True)]
    return {field.name: hints[field.name] for field in stored}


def write(value: Any) -> Any:
    """Return a value for JSON."""
    if isinstance(value, str | float | int | None):  # most values
        return value
    if isinstance(value, np.ndarray) and value.dtype != object:
        parts = np.array([value.real, value.imag]) if np.iscomplexobj(value) else value
        return {"shape": parts.shape, "numbers": parts.ravel().tolist()}
    if dataclasses.is_dataclass(value):
        value = {name: getattr(value, name) for name in fields_of(type(value))}  # type: ignore[arg-type]

    if isinstance(value, Mapping):
        return {name: write(item) for name, item in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [write(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def read(value: Any, kind: Any) -> Any:
    """Return a value of an annotated kind from JSON.

    Raises
    ------
    LookupError, TypeError, ValueError
        If it is of another kind.
    """
    if get_origin(kind) in (Union, types.UnionType):
        kind = _alike(get_args(kind), value)
    # Settings of criteria are plain values; the classes of the criteria check them.
    if kind is Any or (value is None and kind is type(None)):
        return value
    if (item := _item(kind)) is not None:
        return _array(value, item)
    if dataclasses.is_dataclass(kind) or get_origin(kind) in (tuple, Mapping, dict):
        return _container(value, kind)
    return _scalar(value, kind)


def _require_type(value: Any, kind: type, problem: str) -> None:
    # The text of a whole record takes ten times as long as all else: only an error needs it.
    if not isinstance(value, kind):
        raise ValueError(f"{value!r:.40} {problem}")


def _container(value: Any, kind: Any) -> Any:
    """Return a dataclass, a tuple or a mapping."""
    kinds = get_args(kind)
    if get_origin(kind) is tuple:
        _require_type(value, list, "is not a list")
        if kinds[-1] is Ellipsis:
            kinds = kinds[:1] * len(value)
        return tuple(read(item, k) for item, k in zip(value, kinds, strict=True))

    _require_type(value, dict, "has no names")
    if dataclasses.is_dataclass(kind):
        fields = fields_of(kind).items()  # type: ignore[arg-type]
        return kind(**{name: read(value[name], k) for name, k in fields})  # type: ignore[operator]
    return {printable(name): read(item, kinds[1]) for name, item in value.items()}


def _alike(kinds: tuple[Any, ...], value: Any) -> Any:
    """Return the kind among several that a stored value has."""
    # A class name in a file from a stranger could be anything: the names of the fields decide.
    is_array = isinstance(value, dict) and {*value} == {"shape", "numbers"}
    for kind in kinds:
        if dataclasses.is_dataclass(kind):
            is_alike = isinstance(value, dict) and {*value} == {*fields_of(kind)}  # type: ignore[arg-type]
        elif _item(kind) is not None:
            is_alike = is_array
        else:
            is_alike = not is_array and (value is None) == (kind is type(None))
        if is_alike:
            return kind
    raise ValueError(f"{value!r:.40} has a type that is not allowed here")


def _array(value: Any, item: Any) -> Any:
    """Return an array of the annotated items."""
    if item is np.object_:
        _require_type(value, list, "is not a list")
        return np.array([_scalar(text, str) for text in value], dtype=object)

    values = np.array(value["numbers"]).reshape(value["shape"])
    if issubclass(item, np.complexfloating):
        require(values.ndim > 1 and len(values) == 2, "complex numbers have two parts")
        return complex_array(*values)
    return values.astype(next(kind for scalar, kind in ITEMS.items() if issubclass(item, scalar)))


def _scalar(value: Any, kind: Any) -> Any:
    if kind is str:
        _require_type(value, str, "is not text")
        require(len(value) <= LONGEST, f"a text has more than {LONGEST} characters")
        return printable(value, LINES)
    if get_origin(kind) is Literal:
        options = get_args(kind)
        require(value in options, f"{value!r:.40} is none of {', '.join(map(repr, options))}")
        return value
    return kind(value)


def _item(kind: Any) -> Any:
    """Return the type of the items of an annotated array; None for another annotation."""
    if get_origin(kind) is NDArray:  # a type alias of its own since numpy 2.5
        return get_args(kind)[0]
    return get_args(get_args(kind)[1])[0] if get_origin(kind) is np.ndarray else None
