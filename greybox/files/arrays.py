"""Types of arrays; parts, lengths and divisors of arrays."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer]
AnyArray = NDArray[Any]  # of numbers or of objects
NamedStrings = Mapping[str, str]  # by the names of signals, columns or facts
NamedArrays = Mapping[str, Array]  # by the names of signals
Named = Mapping[str, Any]  # by the names of parameters, signals, settings or facts
Fields = dict[str, Any]  # by the names of columns, options or attributes
ArrayPair = tuple[Array, Array]
ArrayTriple = tuple[Array, Array, Array]
ComplexPair = tuple[ComplexArray, ComplexArray]
StringPair = tuple[str, str]  # such as a text and its cure
Arrays = Sequence[Array]
FloatPair = tuple[float, float]  # such as a value and its standard error
Interval = FloatPair  # its low and its high end
Indices = tuple[int, ...]  # of parameters, states, rows or runs
Strings = tuple[str, ...]  # mostly names of signals and parameters, or texts
Labels = Sequence[str]  # the same, in a list or a tuple


def all_finite(*arrays: Any) -> bool:
    """Return whether every number of these arrays is finite."""
    return all(np.all(np.isfinite(values)) for values in arrays)


def nans(shape: int | Sequence[int]) -> Array:
    """Return an array without any value yet, as `np.zeros` returns one of zeros."""
    return np.full(shape, np.nan)


def positive_or_one(sizes: Array) -> Array:
    """Return the sizes as divisors: one in place of those that are not above zero."""
    return np.where(sizes > 0, sizes, 1.0)


def real_root(squares: Array) -> Array:
    """Return square roots: zero of those that rounding left below zero."""
    return np.sqrt(np.maximum(squares, 0.0))


def as_arrays(matrices: Iterable[Any]) -> list[Array]:
    """Return matrices of CasADi as dense arrays."""
    return [matrix.full() for matrix in matrices]


def evenly_spread(count: int, most: int) -> IntArray:
    """Return at most this many of `count` places, evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))


def sum_of_squares(values: AnyArray) -> float:
    """Return the sum of the squared magnitudes of an array."""
    return float(np.sum(np.abs(values) ** 2))


def column_lengths(columns: Any) -> Array:
    """Return the lengths of the columns of a matrix."""
    return np.linalg.norm(columns, axis=0)


def unit_length(vectors: Array, axis: int) -> Array:
    """Return vectors along an axis divided by their lengths; zeros stay."""
    return vectors / positive_or_one(np.linalg.norm(vectors, axis=axis, keepdims=True))


def real_and_imaginary(values: ComplexArray, axis: int = 0) -> Array:
    """Return real parts, then imaginary parts, along an axis, which becomes twice as long."""
    return np.concatenate([values.real, values.imag], axis=axis)


def of_diagonal(matrices: Array) -> Array:
    """Return the diagonals (..., k) of matrices (..., k, k)."""
    return np.linalg.diagonal(matrices)


def diagonal(values: AnyArray) -> AnyArray:
    """Return diagonal matrices (..., k, k) of values (..., k)."""
    return values[..., None] * np.eye(values.shape[-1])


def complex_array(real: Array, imaginary: Array) -> ComplexArray:
    """Return complex numbers, without the warnings and NaN of ``1j *`` infinity."""
    values = np.array(real, dtype=np.complex128)
    values.imag = imaginary
    return values
