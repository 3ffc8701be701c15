"""Responses from magnitude and phase, held against MATLAB's conventions and plain complex numbers."""

import cmath
import math

import numpy as np
import pytest

import greybox as gb

HERTZ = [0.5, 1.0, 4.0]
RESPONSE = np.array([1.2 - 0.3j, -0.4 - 0.9j, 0.01 + 0.02j])
POLAR = [cmath.polar(value) for value in RESPONSE]
MAGNITUDE, RADIANS = ([pair[k] for pair in POLAR] for k in (0, 1))
make = gb.FrequencyResponse.from_magnitude_phase


@pytest.mark.parametrize(
    ("unit", "magnitude"),
    [("absolute", MAGNITUDE), ("dB", [20 * math.log10(m) for m in MAGNITUDE])],
)
@pytest.mark.parametrize(
    ("turn", "phase"), [("rad", RADIANS), ("deg", [math.degrees(p) - 360 for p in RADIANS])]
)
@pytest.mark.parametrize(("clock", "factor"), [("Hz", 1), ("rad/s", 2 * math.pi), ("kHz", 1e-3)])
def test_all_units_give_the_same_response(unit, magnitude, turn, phase, clock, factor):
    frequency = [factor * f for f in HERTZ]
    found = make(
        frequency, magnitude, phase, frequency_unit=clock, magnitude_unit=unit, phase_unit=turn
    )
    np.testing.assert_allclose(found.omega, 2 * math.pi * np.array(HERTZ))
    np.testing.assert_allclose(found.response, RESPONSE, rtol=1e-12)


def test_the_defaults_are_those_of_bode_and_the_rest_is_passed_on():
    found = make(
        [1, 2], [2, 1], [-90, -180], input="u", output="theta", coherence=[1, 0.9], name="sweep"
    )
    np.testing.assert_allclose(found.response, [-2j, -1], atol=1e-15)
    assert (found.input, found.output, found.name) == ("u", "theta", "sweep")
    assert list(found.coherence) == [1, 0.9]


@pytest.mark.parametrize(
    ("arguments", "units", "words"),
    [
        (
            ([1], [-3], [0]),
            {},
            "magnitude is -3 at index 0: if these are decibels, give magnitude_unit='dB'",
        ),
        (([1], [1, 2], [0]), {}, "magnitude has 2 values but phase has 1"),
        (([1], ["x"], [0]), {}, "magnitude must be a one-dimensional array of numbers"),
        (
            ([1], [1], [0]),
            {"frequency_unit": "furlong"},
            "unit of frequency is 'furlong': give 'rad/s' or 'Hz'",
        ),
        (([1], [1], [0]), {"frequency_unit": "deg"}, "unit of frequency is 'deg'"),
        (
            ([1], [1], [0]),
            {"magnitude_unit": "neper"},
            "unit of magnitude is 'neper': give 'absolute' or 'dB'",
        ),
        (([1], [1], [0]), {"phase_unit": "Hz"}, "unit of phase is 'Hz': give 'deg' or 'rad'"),
        (([1], [1], [0]), {"phase_unit": None}, "unit of phase is None"),
        (([0], [1], [0]), {}, "omega is 0 at index 0"),
        (([1], [1e9], [0]), {"magnitude_unit": "dB"}, "response is .* at index 0"),
    ],
)
def test_what_cannot_be_meant_is_refused(arguments, units, words):
    with pytest.raises(ValueError, match=words):
        make(*arguments, **units)
