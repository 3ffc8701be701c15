"""Types of numpy arrays for annotations."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.integer]


def complex_array(real: Array, imaginary: Array) -> ComplexArray:
    """Return complex numbers, without the warnings and NaN of ``1j *`` infinity."""
    values = np.array(real, dtype=np.complex128)
    values.imag = imaginary
    return values
