"""How large and how small a measured number may be: fourth powers of it, as in sums of squares' squares, are finite.

No physical quantity in any unit is outside; damaged files have such numbers.
"""

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array, BoolArray

LARGEST = 1e75  # its fourth power is 1e300; floating-point numbers end at 1.8e308
SMALLEST = 1e-75


def within_range(values: Array) -> Array:
    """Return the values (n,), read-only: larger ones as infinite, which counts as missing, and smaller ones as zero."""
    if not out_of_range(values).any():
        return values
    size = np.abs(values)
    inside = np.where(
        size > LARGEST, np.copysign(np.inf, values), np.where(size < SMALLEST, 0.0, values)
    )
    inside.setflags(write=False)
    return inside


def out_of_range(values: NDArray) -> BoolArray:
    """Tell which of the values (n,), real or complex, are too large, or too small without being zero."""
    size = np.abs(values)
    return (size > LARGEST) | ((size > 0) & (size < SMALLEST))
