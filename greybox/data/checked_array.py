"""Converts measured numbers to read-only arrays, and limits how large and how small they may be.

Fourth powers of the numbers, as in squares of sums of squares, must be finite. No physical quantity
in any unit is outside this range, but damaged files have such numbers.

Checksums of the arrays, by which equal data are recognized.
"""

import hashlib
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from greybox.files.arrays import Array, BoolArray, Interval


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


def number_pair(value: object, what: str) -> Interval:
    """Return two numbers (low, high), neither of them NaN; ValueError for anything else."""
    try:
        low, high = value  # type: ignore[misc]
        low, high = float(low), float(high)
    except (TypeError, ValueError):
        raise ValueError(f"{what} {value!r} must be a pair of numbers.") from None
    if math.isnan(low) or math.isnan(high):
        raise ValueError(f"{what} {value!r} contain a NaN: give two numbers (low, high).")
    return low, high


def require_band(band: Interval) -> Interval:
    """Return a lower and a higher frequency, rad/s; ValueError for anything else."""
    low, high = number_pair(band, "band")
    if not 0 <= low < high < math.inf:
        raise ValueError(
            f"band={low:g} {high:g} must be two frequencies of at least 0 rad/s, the lower one "
            "first."
        )
    return low, high


def seconds_from_first(values: Any) -> Any:
    """Return dates and time differences in s from the first one; anything else as it is."""
    if getattr(values, "tz", None) is not None:  # numpy has dates with a time zone as objects
        values = values.tz_convert("UTC").tz_localize(None)
    if getattr(getattr(values, "dtype", None), "kind", "") not in ("M", "m"):
        return values
    array = np.asarray(values)
    # A slice, because an empty array has no first value.
    return (array - array[:1]) / np.timedelta64(1, "s")


def within_range(values: Array) -> Array:
    """Return the values (n,), read-only: larger ones as NaN, smaller ones as zero."""
    outside = out_of_range(values)
    if not outside.any():
        return values
    limit = np.where(np.abs(values) > 1, np.nan, 0.0)
    inside = np.where(outside, limit, values)
    inside.setflags(write=False)
    return inside


def checksum_of(*items: str | NDArray) -> str:
    """Return the SHA-256 of names and arrays, one after the other."""
    digest = hashlib.sha256()
    for item in items:
        digest.update(item.encode() if isinstance(item, str) else item.tobytes())
    return digest.hexdigest()


def out_of_range(values: NDArray) -> BoolArray:
    """Return which values (n,), real or complex, are too large, or too small but not zero."""
    size = np.abs(values)
    # Its fourth power is 1e300; floating-point numbers end at 1.8e308.
    return (size > 1e75) | ((size > 0) & (size < 1e-75))
