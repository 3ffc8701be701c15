"""Frozen values in groups of an HDF5 file, written and read by the annotations of their fields.

| annotation | in the file |
| --- | --- |
| `str`, `float`, `int`, `bool`, `Literal` | attribute |
| array, tuple of floats | dataset of numbers; a complex one has two parts, real and imaginary |
| tuple or array of `str` | dataset of texts |
| dataclass, mapping of arrays | group with a member for each field or name |
| tuple of values of different kinds, or of dataclasses | group with members 0, 1 ... |
| other mappings, tuples and a `Sine` | attribute in JSON, in which null is NaN |

None is left out. What is read has the annotated kind, and its texts can be printed.
"""

import dataclasses
import json
import math
import types
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from greybox.files.sealed_files import Node, Stored
from greybox.files.text_table import printable
from greybox.modeling.sine import Sine

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


def write_fields(group: Node, value: Any, kinds: Mapping[str, Any]) -> None:
    """Write these attributes of a value by their annotations."""
    for name, kind in kinds.items():
        write(group, name, getattr(value, name), kind)


def read_fields(group: Stored, kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Return what `write_fields` wrote, by name."""
    return {name: read(group, name, kind) for name, kind in kinds.items()}


def write(group: Node, name: str, value: Any, kind: Any) -> None:
    """Write a value of an annotated kind under a name."""
    # The annotation decides, not the value: an empty tuple does not show what it would contain.
    kind = _without_none(kind)
    if value is None:
        return
    if _is_scalar(kind):
        group.attrs[name] = value
    elif _is_text_list(kind):
        _write_texts(group, name, value)
    elif _is_array(kind):
        # Two real parts: not every reader of HDF5 knows the compound type of complex numbers.
        array: Any = np.asarray(value)
        group[name] = np.array([array.real, array.imag]) if array.dtype.kind == "c" else array
    elif (members := _members(kind, value)) is not None:
        inner = group.create_group(name, track_order=True)
        for key, member, member_kind in members:
            write(inner, escaped(key), member, member_kind)
    else:
        group.attrs[name] = json.dumps(_plain(value))


def read(group: Stored, name: str, kind: Any) -> Any:
    """Return the value that `write` wrote; None where it was left out.

    Raises
    ------
    LookupError, TypeError, ValueError
        If it is of another kind.
    """
    inner = _without_none(kind)
    if name not in group:
        if inner is not kind and name not in group.attrs:
            return None
        value = group.attrs[name]
        return as_kind(value if _is_scalar(inner) else json.loads(value), inner)

    stored = group[name]
    if _is_text_list(inner):
        texts = [as_kind(text, str) for text in stored[()]]
        return np.array(texts, dtype=object) if _item(inner) is not None else tuple(texts)
    return _read_array(stored[()], inner) if _is_array(inner) else _read_group(stored, inner)


def _read_group(group: Stored, kind: Any) -> Any:
    """Return a dataclass, a mapping of arrays or a tuple from the members of its group."""
    if dataclasses.is_dataclass(kind):
        return kind(**read_fields(group, fields_of(kind)))  # type: ignore[operator, arg-type]
    kinds = get_args(kind)
    if get_origin(kind) is Mapping:
        arrays = read_fields(group, dict.fromkeys(group.members, kinds[1]))
        return {as_kind(unescaped(key), str): array for key, array in arrays.items()}

    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(group)
    return tuple(read(group, str(k), member) for k, member in enumerate(kinds))


def write_table(group: Node, rows: Any, kinds: Mapping[str, Any]) -> None:
    """Write values of one dataclass by columns: a dataset for each of these fields."""
    for name, kind in kinds.items():
        column = [getattr(row, name) for row in rows]
        if _holds_text(kind):
            _write_texts(group, name, column)
        else:
            empty = np.zeros((0, 2) if get_origin(kind) is tuple else 0)
            group[name] = np.array(column) if column else empty


def read_table(group: Stored, kinds: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a table as mappings by column."""
    # Whole columns at once: HDF5 reads single numbers slowly.
    columns = [group[name][()] for name in kinds]
    return [
        {
            name: as_kind(
                value.tolist() if isinstance(value, np.generic | np.ndarray) else value, kind
            )
            for (name, kind), value in zip(kinds.items(), row, strict=True)
        }
        for row in zip(*columns, strict=True)
    ]


def as_kind(value: Any, kind: Any) -> Any:
    """Return a plain value as one of the annotated kind.

    Raises
    ------
    ValueError, TypeError
        If it is something else.
    """
    # Settings of criteria are plain values; the classes of the criteria check them.
    if kind is Any:
        return value
    if _is_scalar(kind):
        return _as_scalar(value, kind)

    members = get_args(kind)
    if get_origin(kind) is tuple:
        require(isinstance(value, list), f"{value!r:.40} is not a list")
        kinds = members[:1] * len(value) if members[-1] is Ellipsis else members
        return tuple(as_kind(item, k) for item, k in zip(value, kinds, strict=True))

    require(isinstance(value, dict), f"{value!r:.40} has no names")
    if kind is Sine:
        return Sine(**value)
    return {printable(name): as_kind(item, members[1]) for name, item in value.items()}


def _as_scalar(value: Any, kind: Any) -> Any:
    if kind is str:
        require(isinstance(value, str), f"{value!r:.40} is not text")
        return printable(value, LINES)
    if get_origin(kind) is Literal:
        options = get_args(kind)
        require(value in options, f"{value!r:.40} is none of {', '.join(map(repr, options))}")
        return value
    # JSON has no NaN: null stands for it.
    return math.nan if value is None and kind is float else kind(value)


def _members(kind: Any, value: Any) -> list[tuple[str, Any, Any]] | None:
    """Return name, value and kind of the members of a group; None for what is written as JSON."""
    inner = get_args(kind)
    if dataclasses.is_dataclass(kind) and kind is not Sine:
        kinds = fields_of(type(value))
        return [(name, getattr(value, name), inner) for name, inner in kinds.items()]
    if _is_mapping_of_arrays(kind):
        return [(name, array, inner[1]) for name, array in value.items()]
    if get_origin(kind) is tuple and any(
        _is_array(k) or dataclasses.is_dataclass(k) for k in inner
    ):
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return [(str(k), v, kind) for k, (v, kind) in enumerate(zip(value, kinds, strict=True))]

    return None


def _without_none(kind: Any) -> Any:
    """Return X of the annotation `X | None`."""
    # None is left out of the file: HDF5 has no such value.
    if get_origin(kind) in (Union, types.UnionType) and type(None) in get_args(kind):
        return next(member for member in get_args(kind) if member is not type(None))
    return kind


def _is_scalar(kind: Any) -> bool:
    return kind in (str, float, int, bool) or get_origin(kind) is Literal


def _holds_text(kind: Any) -> bool:
    return kind is str or get_origin(kind) is Literal


def _is_array(kind: Any) -> bool:
    return _item(kind) is not None or kind == tuple[float, float]


def _is_mapping_of_arrays(kind: Any) -> bool:
    return get_origin(kind) is Mapping and _item(get_args(kind)[1]) is not None


def _is_text_list(kind: Any) -> bool:
    return kind == tuple[str, ...] or _item(kind) is np.object_


def _item(kind: Any) -> Any:
    """Return the type of the items of an annotated array; None for another annotation."""
    if get_origin(kind) is NDArray:  # a type alias of its own since numpy 2.5
        return get_args(kind)[0]
    return get_args(get_args(kind)[1])[0] if get_origin(kind) is np.ndarray else None


def _read_array(values: Any, kind: Any) -> Any:
    """Return an array of the annotated items, or a pair of floats."""
    require(isinstance(values, np.ndarray), "numbers are missing")
    if get_origin(kind) is tuple:
        low, high = values.tolist()
        return float(low), float(high)

    item = _item(kind)
    if issubclass(item, np.complexfloating):
        require(values.ndim > 1 and len(values) == 2, "complex numbers have two parts")
        return values[0] + 1j * values[1]
    return values.astype(next(kind for scalar, kind in ITEMS.items() if issubclass(item, scalar)))


def _plain(value: Any) -> Any:
    """Return what JSON can hold, null for NaN."""
    if isinstance(value, Sine):
        return value.plain
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, float | np.floating):
        return None if math.isnan(value) else float(value)
    return value.item() if isinstance(value, np.integer) else value


def escaped(name: str) -> str:
    """Return a name without the slash, which HDF5 reads as a path."""
    return name.replace("%", "%25").replace("/", "%2F")


def unescaped(key: str) -> str:
    """Return the name that was escaped."""
    return key.replace("%2F", "/").replace("%25", "%")


def _write_texts(group: Node, name: str, texts: Any) -> None:
    import h5py  # noqa: PLC0415  (reading does not need it)

    group.create_dataset(name, data=list(texts), dtype=h5py.string_dtype(), shape=(len(texts),))
