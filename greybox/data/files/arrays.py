"""Types of arrays; parts, lengths and divisors of arrays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer]
AnyArray = NDArray[Any]  # of numbers or of objects
Interval = tuple[float, float]  # its low and its high end


def all_finite(*arrays: Any) -> bool:
    """Return whether every number of these arrays is finite."""
    return all(np.all(np.isfinite(values)) for values in arrays)


def positive_or_one(sizes: Array) -> Array:
    """Return the sizes as divisors: one in place of those that are not above zero."""
    return np.where(sizes > 0, sizes, 1.0)


def real_root(squares: Array) -> Array:
    """Return square roots: zero of those that rounding left below zero."""
    return np.sqrt(np.maximum(squares, 0.0))


def evenly_spread(count: int, most: int) -> IntArray:
    """Return at most this many of `count` places, evenly from the first to the last."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))


def sum_of_squares(values: AnyArray) -> float:
    """Return the sum of the squared magnitudes of an array."""
    return float(np.sum(np.abs(values) ** 2))


def unit_length(vectors: Array, axis: int) -> Array:
    """Return vectors along an axis divided by their lengths; zeros stay."""
    return vectors / positive_or_one(np.linalg.norm(vectors, axis=axis, keepdims=True))


def real_and_imaginary(values: ComplexArray, axis: int = 0) -> Array:
    """Return real parts, then imaginary parts, along an axis, which becomes twice as long."""
    return np.concatenate([values.real, values.imag], axis=axis)


def diagonal(values: AnyArray) -> AnyArray:
    """Return diagonal matrices (..., k, k) of values (..., k)."""
    return values[..., None] * np.eye(values.shape[-1])


def complex_array(real: Array, imaginary: Array) -> ComplexArray:
    """Return complex numbers, without the warnings and NaN of ``1j *`` infinity."""
    values = np.array(real, dtype=np.complex128)
    values.imag = imaginary
    return values
