"""Converts measured numbers to read-only arrays, and limits how large and how small they may be.

Fourth powers of the numbers, as in squares of sums of squares, must be finite. No physical quantity
in any unit is outside this range, but damaged files have such numbers.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.data.files.arrays import Array, BoolArray


def checked_array(name: str, values: ArrayLike, kind: type = float) -> NDArray:
    """Return a read-only copy (n,) of measured numbers, in floating point or complex.

    Masked values are missing: they become NaN.

    Raises
    ------
    ValueError
        If the values are not a one-dimensional array of numbers, or complex but not expected to be.
    """
    try:
        # numpy would convert dates, and texts such as "1", to numbers without an error.
        dtype = getattr(values, "dtype", None)
        dtype = np.asanyarray(values).dtype if dtype is None else dtype
        if dtype.kind not in ("biufc" if kind is complex else "biuf"):
            raise TypeError(dtype)
        if hasattr(values, "filled"):  # a masked array
            values = values.astype(kind).filled(np.nan)  # type: ignore[union-attr]
        array = np.array(values, dtype=kind)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be a one-dimensional array of numbers, not {values!r:.60}: convert it."
        ) from None
    if array.ndim != 1:
        raise ValueError(f"{name} must be one-dimensional, but has shape {array.shape}.")
    array.setflags(write=False)

    return array


def finite_array(name: str, values: ArrayLike, kind: type = float) -> NDArray:
    """Return a `checked_array` whose numbers are finite, with squares that are finite, too.

    Raises
    ------
    ValueError
        For other numbers, and whatever a `checked_array` refuses.
    """
    array = checked_array(name, values, kind)
    require(name, array, np.isfinite(array), "leave out the points that were not measured")
    require(
        name,
        array,
        ~out_of_range(array),
        "squares of such numbers are beyond floating-point arithmetic; choose another unit, or "
        "leave the point out",
    )
    return array


def finite_numbers(name: str, values: ArrayLike) -> Array:
    """Return one number, or several, as a `finite_array`."""
    return finite_array(name, np.atleast_1d(values))


def require(name: str, values: NDArray, sound: BoolArray, cure: str) -> None:
    """Raise ValueError with the first of the values (n,) that is not `sound`."""
    if not sound.all():
        index = np.argmin(sound)
        raise ValueError(f"{name} is {values[index]:g} at index {index}: {cure}.")


def require_size(name: str, values: NDArray, first: str, size: int) -> None:
    """Raise ValueError if the values have another size than those of the `first` name."""
    if values.size != size:
        raise ValueError(
            f"{first} has {size} values but {name} has {values.size}: they must match."
        )


def within_range(values: Array) -> Array:
    """Return the values (n,), read-only: larger ones as NaN, smaller ones as zero."""
    outside = out_of_range(values)
    if not outside.any():
        return values
    limit = np.where(np.abs(values) > 1, np.nan, 0.0)
    inside = np.where(outside, limit, values)
    inside.setflags(write=False)
    return inside


def out_of_range(values: NDArray) -> BoolArray:
    """Return which values (n,), real or complex, are too large, or too small but not zero."""
    size = np.abs(values)
    # Its fourth power is 1e300; floating-point numbers end at 1.8e308.
    return (size > 1e75) | ((size > 0) & (size < 1e-75))
