"""The sine of a test: amplitudes at the frequencies, and what is refused."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.sine import as_sine

OMEGA = np.array([8.0, 1.0, 2.0])


def test_one_amplitude_holds_at_every_frequency():
    sine = gb.modeling.Sine("u", 2)
    assert_allclose(sine.amplitudes(OMEGA), [2, 2, 2])
    assert sine.between(OMEGA, np.array([3.0])) is sine
    assert (sine.signal, sine.amplitude, sine.harmonics) == ("u", 2.0, None)


def test_amplitudes_between_frequencies_are_linear_in_their_logarithm():
    sine = gb.modeling.Sine("u", [4.0, 1.0, 2.0], harmonics=5)
    other = sine.between(OMEGA, np.array([np.sqrt(2), 4.0, 100.0]))
    assert_allclose(other.amplitude, [1.5, 3.0, 4.0])
    assert other.harmonics == 5
    assert sine.amplitude.tolist() == [4.0, 1.0, 2.0]
    assert not sine.amplitude.flags.writeable


def test_amplitudes_are_one_for_each_frequency():
    with pytest.raises(
        ValueError, match=r"amplitude of 'u' has 2 values for 3 frequencies: give one for each"
    ):
        gb.modeling.Sine("u", [1.0, 2.0]).amplitudes(OMEGA)


@pytest.mark.parametrize(
    "amplitude", [0, -1.0, np.nan, np.inf, "much", None, [], [1.0, 0.0], [[1.0]], 1j]
)
def test_amplitudes_are_finite_and_above_zero(amplitude):
    with pytest.raises(ValueError, match=r"amplitude of 'u' is .*: give a finite number above 0"):
        gb.modeling.Sine("u", amplitude)


@pytest.mark.parametrize("harmonics", [0, 51, 2.0, True, "3"])
def test_harmonics_are_a_whole_number(harmonics):
    with pytest.raises(ValueError, match="give a whole number from 1 to 50"):
        gb.modeling.Sine("u", 1.0, harmonics)


def test_a_mapping_names_one_signal():
    assert as_sine({"theta": 0.1}).signal == "theta"
    sine = gb.modeling.Sine("u", 1.0)
    assert as_sine(sine) is sine
    with pytest.raises(ValueError, match="amplitude names 'u', 'v': give the one signal"):
        as_sine({"u": 1.0, "v": 1.0})
    with pytest.raises(ValueError, match="amplitude names nothing"):
        as_sine({})
    with pytest.raises(TypeError, match=r"amplitude is 0\.1: give \{signal: amplitude\} or a Sine"):
        as_sine(0.1)
    with pytest.raises(TypeError, match="the signal of a sine is 3: give its name"):
        gb.modeling.Sine(3, 1.0)


@pytest.mark.parametrize(
    ("amplitude", "harmonics", "said"),
    [
        (2.0, None, "<Sine u, amplitude 2, as many harmonics as matter>"),
        ([1.0, 0.25, 3.0], 1, "<Sine u, amplitude 0.25 to 3, 1 harmonic>"),
        ([2.0, 2.0], 50, "<Sine u, amplitude 2, 50 harmonics>"),
    ],
)
def test_a_sine_in_one_line(amplitude, harmonics, said):
    sine = gb.modeling.Sine("u", amplitude, harmonics)
    assert repr(sine) == said
    assert sine.harmonics == harmonics
