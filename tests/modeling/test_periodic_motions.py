"""The response to a sine test, against linear responses and describing functions."""

import numpy as np
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.harmonic_balance import response_of_test

OMEGA = 2.0
DAMPING = 0.1


class Spring(gb.StateSpace):
    """A hardening spring, lightly damped."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    b = gb.Parameter(1.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        return (x.v, -x.x - p.b * x.x**3 - DAMPING * x.v + u.u)

    def output(self, x, u, p):
        return (x.x,)


class Leaning(Spring):
    """The same spring with a push that makes one side unlike the other."""

    def derivative(self, x, u, p):
        return (x.v, -x.x - p.b * x.x**3 - 0.5 * x.x**2 - DAMPING * x.v + u.u)


def test_a_small_amplitude_has_the_linear_response():
    response = gb.modeling.harmonic_response(Spring(), {}, [OMEGA], amplitude={"u": 0.01})
    linear = gb.frequency_response(Spring(), {}, [OMEGA])
    assert_allclose(response.response, linear.response, rtol=1e-3)


def test_a_number_of_harmonics_is_kept():
    """One harmonic of a cubic spring under a sine of its position: the describing function, exactly."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    response = gb.modeling.harmonic_response(Spring(), {}, [OMEGA], amplitude=sine).response
    assert_allclose(response, [1 / (1 + 0.75 * 4.0 - OMEGA**2 + 1j * OMEGA * DAMPING)], rtol=1e-6)


def test_the_response_of_a_test_is_linear_without_a_sine_and_interpolates_the_amplitude():
    measured = np.array([1.0, 3.0])
    linear = response_of_test(Spring(), {}, measured, None, measured)
    assert_allclose(linear.response, gb.frequency_response(Spring(), {}, measured).response)
    sine = gb.modeling.Sine("x", np.array([1.0, 3.0]))
    between = response_of_test(Spring(), {}, [2.0], sine, measured)
    amplitude = 1 + 2 * np.log(2) / np.log(3)  # over the logarithm of the frequency
    assert_allclose(
        between.response, [1 / (1 + 0.75 * amplitude**2 - 4.0 + 2j * DAMPING)], rtol=1e-6
    )


def test_a_signal_that_a_loop_holds_to_a_sine_keeps_its_mean():
    """About zero: the mean of the force meets what pushes the position to one side."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    response = gb.modeling.harmonic_response(Leaning(), {}, [OMEGA], amplitude=sine).response
    assert_allclose(response, [1 / (1 + 0.75 * 4.0 - OMEGA**2 + 1j * OMEGA * DAMPING)], rtol=1e-6)


def test_the_most_harmonics_say_what_half_as_many_change(monkeypatch):
    """With seven as the most, to be fast."""
    monkeypatch.setattr(gb.modeling.harmonic_balance, "MOST_HARMONICS", 7)
    few, many = (
        gb.modeling.harmonic_response(
            Spring(), {}, [OMEGA], amplitude=gb.modeling.Sine("u", 0.7, harmonics=number)
        )
        for number in (3, 7)
    )
    change = 100 * abs(few.response / many.response - 1).max()
    assert f"by up to {change:.2g} %" in many.about["truncation"]
    assert not few.about
