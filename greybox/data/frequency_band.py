"""Pairs of numbers, such as the ends of a frequency band."""

import math

from greybox.data.files.arrays import Interval


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
