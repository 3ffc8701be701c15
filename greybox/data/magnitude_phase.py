"""Complex responses from magnitude and phase in the units of instruments and other programs."""

import math

import numpy as np

from greybox.data.checked_array import require
from greybox.data.units import known_unit
from greybox.files.arrays import AnyArray, Array, ComplexArray


def angular_frequency(frequency: Array, unit: str) -> Array:
    """Return frequencies (n,) in `unit`, of rad/s or Hz, in rad/s.

    Raises
    ------
    ValueError
        For another unit.
    """
    conversion = known_unit(unit)
    # In tables of responses Hz is a frequency in cycles; `to_si` keeps it as a unit of its own.
    if conversion and conversion.si == "Hz":
        return 2 * math.pi * conversion.factor * frequency
    if conversion and conversion.si == "rad/s":
        return conversion.apply(frequency)
    raise ValueError(f"the unit of frequency is {unit!r:.40}: give 'rad/s' or 'Hz'.")


def complex_response(
    magnitude: AnyArray, phase: Array, magnitude_unit: str, phase_unit: str
) -> ComplexArray:
    """Return the response (n,) of magnitudes, absolute or in dB (20 log10), and phases.

    Raises
    ------
    ValueError
        For other units, or a negative absolute magnitude.
    """
    conversion = known_unit(phase_unit)
    if conversion is None or conversion.si != "rad":
        raise ValueError(f"the unit of phase is {phase_unit!r:.40}: give 'deg' or 'rad'.")

    if magnitude_unit.lower() == "db":
        # A magnitude that overflows is refused later, as a response that is too large.
        with np.errstate(over="ignore"):
            magnitude = np.minimum(10 ** (magnitude / 20), np.finfo(float).max)
    elif magnitude_unit not in ("", "1", "abs", "absolute"):
        raise ValueError(
            f"the unit of magnitude is {magnitude_unit!r:.40}: give 'absolute' or 'dB'."
        )
    # Decibels without their unit are the usual mistake, and decibels are usually negative.
    cure = "if these are decibels, give magnitude_unit='dB'"
    require("magnitude", magnitude, magnitude >= 0, cure)

    return magnitude * np.exp(1j * conversion.apply(phase))
