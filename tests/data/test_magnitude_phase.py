"""Responses from magnitude and phase, held against MATLAB's conventions and plain complex numbers."""

import cmath
import math

import numpy as np
import pytest

from greybox.data.response_columns import angular_frequency, complex_response

HERTZ = np.array([0.5, 1.0, 4.0])
RESPONSE = np.array([1.2 - 0.3j, -0.4 - 0.9j, 0.01 + 0.02j])
POLAR = [cmath.polar(value) for value in RESPONSE]
MAGNITUDE, RADIANS = (np.array([pair[k] for pair in POLAR]) for k in (0, 1))


@pytest.mark.parametrize(
    ("unit", "magnitude"),
    [("absolute", MAGNITUDE), ("dB", 20 * np.log10(MAGNITUDE))],
)
@pytest.mark.parametrize(("turn", "phase"), [("rad", RADIANS), ("deg", np.degrees(RADIANS) - 360)])
@pytest.mark.parametrize(("clock", "factor"), [("Hz", 1), ("rad/s", 2 * math.pi), ("kHz", 1e-3)])
def test_all_units_give_the_same_response(unit, magnitude, turn, phase, clock, factor):
    omega = angular_frequency(factor * HERTZ, clock)
    np.testing.assert_allclose(omega, 2 * math.pi * HERTZ)
    response = complex_response(magnitude, phase, unit, turn)
    np.testing.assert_allclose(response, RESPONSE, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ([-3], [0], "absolute", "deg"),
            "magnitude is -3 at index 0: if these are decibels, state dB",
        ),
        (([1], [0], "neper", "deg"), "unit of magnitude is 'neper': give 'absolute' or 'dB'"),
        (([1], [0], "absolute", "Hz"), "unit of phase is 'Hz': give 'deg' or 'rad'"),
        (([1], [0], "absolute", ""), "unit of phase is ''"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments, words):
    magnitude, phase, *units = arguments
    with pytest.raises(ValueError, match=words):
        complex_response(np.array(magnitude), np.array(phase), *units)


@pytest.mark.parametrize("unit", ["furlong", "deg"])
def test_other_units_of_frequency_are_refused(unit):
    with pytest.raises(ValueError, match=f"unit of frequency is '{unit}': give 'rad/s' or 'Hz'"):
        angular_frequency(np.ones(1), unit)
