"""Frozen values as JSON with arrays beside it, written by their fields and read by annotations.

A dataclass and a mapping are objects in JSON, a tuple is a list. An array of numbers is null there:
its numbers are a dataset at the path of its names, such as ``/parts/0/response``. A complex one has
two parts, real and imaginary. What is read has the annotated kind, and its texts can be printed.
"""

import dataclasses
import types
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import complex_array
from greybox.files.sealed_files import Node, Stored
from greybox.files.text_table import printable

ITEMS = {np.bool_: bool, np.integer: int, np.floating: float}
LINES = "\n\t"  # control characters of docstrings, source and warnings


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


def write(value: Any, file: Node | None = None, path: str = "") -> Any:
    """Return a value for JSON, and write the arrays in it to datasets below a path.

    Without a file they are shape and numbers in the JSON.
    """
    if isinstance(value, np.ndarray) and value.dtype != object:
        # Two real parts: not every reader of HDF5 knows the compound type of complex numbers.
        parts = np.array([value.real, value.imag]) if np.iscomplexobj(value) else value
        if file is None:
            return {"shape": parts.shape, "numbers": parts.ravel().tolist()}
        file[path] = parts
        return None
    if dataclasses.is_dataclass(value):
        value = {name: getattr(value, name) for name in fields_of(type(value))}  # type: ignore[arg-type]

    if isinstance(value, Mapping):
        return {name: write(item, file, f"{path}/{_key(name)}") for name, item in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [write(item, file, f"{path}/{k}") for k, item in enumerate(value)]
    return value.item() if isinstance(value, np.generic) else value


def read(value: Any, kind: Any, place: Stored | None = None) -> Any:
    """Return a value of an annotated kind from JSON, and from the group or dataset at its path.

    Raises
    ------
    LookupError, TypeError, ValueError
        If it is of another kind.
    """
    if get_origin(kind) in (Union, types.UnionType):
        kind = _alike(get_args(kind), value, place)
    # Settings of criteria are plain values; the classes of the criteria check them.
    if kind is Any or (value is None and kind is type(None)):
        return value
    if (item := _item(kind)) is not None:
        return _array(value, item, place)
    if dataclasses.is_dataclass(kind) or get_origin(kind) in (tuple, Mapping, dict):
        return _container(value, kind, {} if place is None else place.members)
    return _scalar(value, kind)


def _container(value: Any, kind: Any, inner: Mapping[str, Stored]) -> Any:
    """Return a dataclass, a tuple or a mapping."""
    kinds = get_args(kind)
    if get_origin(kind) is tuple:
        require(isinstance(value, list), f"{value!r:.40} is not a list")
        if kinds[-1] is Ellipsis:
            kinds = kinds[:1] * len(value)
        pairs = zip(value, kinds, strict=True)
        return tuple(read(item, k, inner.get(str(n))) for n, (item, k) in enumerate(pairs))

    require(isinstance(value, dict), f"{value!r:.40} has no names")
    if dataclasses.is_dataclass(kind):
        fields = fields_of(kind).items()  # type: ignore[arg-type]
        return kind(**{n: read(value[n], k, inner.get(n)) for n, k in fields})  # type: ignore[operator]
    return {printable(n): read(item, kinds[1], inner.get(_key(n))) for n, item in value.items()}


def _alike(kinds: tuple[Any, ...], value: Any, place: Stored | None) -> Any:
    """Return the kind among several that a stored value has."""
    # A class name in a file of a stranger could be anything: the names of the fields decide.
    for kind in kinds:
        if dataclasses.is_dataclass(kind):
            is_alike = isinstance(value, dict) and {*value} == {*fields_of(kind)}  # type: ignore[arg-type]
        elif _item(kind) is not None:
            is_alike = place is not None or isinstance(value, dict)
        else:
            is_alike = (value is None) == (kind is type(None))
        if is_alike:
            return kind
    raise ValueError(f"{value!r:.40} is of no kind that it may have")


def _array(value: Any, item: Any, place: Stored | None) -> Any:
    """Return an array of the annotated items."""
    if item is np.object_:
        require(isinstance(value, list), f"{value!r:.40} is not a list")
        return np.array([_scalar(text, str) for text in value], dtype=object)

    if isinstance(value, dict):
        values = np.array(value["numbers"]).reshape(value["shape"])
    else:
        values = None if place is None else place.values
    if not isinstance(values, np.ndarray):
        raise ValueError("numbers are missing")
    if issubclass(item, np.complexfloating):
        require(values.ndim > 1 and len(values) == 2, "complex numbers have two parts")
        return complex_array(*values)
    return values.astype(next(kind for scalar, kind in ITEMS.items() if issubclass(item, scalar)))


def _scalar(value: Any, kind: Any) -> Any:
    if kind is str:
        require(isinstance(value, str), f"{value!r:.40} is not text")
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


def _key(name: str) -> str:
    """Return a name without the slash, which HDF5 reads as a path."""
    return quote(name, safe=" ")
