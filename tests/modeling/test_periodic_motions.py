"""Several motions under one sine, against simulations that begin elsewhere and the amplitude raised slowly."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.modeling.periodic_motions import periodic_motions, response_of_test
from greybox.models.tilt import LinearTilt

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


def swung(amplitude, begin, raised=0.0, quadratic=0.0):
    """First harmonic over the amplitude, which is raised from zero in the time `raised`, after 80 more periods."""
    period = 2 * np.pi / OMEGA
    end = raised + 80 * period
    t = end + period * np.arange(128) / 128

    def slope(t, s):
        force = amplitude * min(1.0, t / raised if raised else 1.0) * np.cos(OMEGA * (t - end))
        return [s[1], -s[0] - s[0] ** 3 - quadratic * s[0] ** 2 - DAMPING * s[1] + force]

    motion = solve_ivp(
        slope, (0, t[-1]), begin, t_eval=t, rtol=1e-7, atol=1e-9, max_step=period / 20
    ).y[0]
    return 2 * np.fft.fft(motion)[1] / motion.size / amplitude


def motions(model, amplitude, **options):
    return periodic_motions(
        model, {}, np.array([OMEGA]), gb.modeling.Sine("u", amplitude, **options)
    )


def test_the_motion_that_is_used_is_that_of_an_amplitude_raised_slowly():
    """Below the fold the small motion, though the large one exists as well and a push from outside reaches it."""
    response, (message,) = motions(Spring(), 0.5)
    small, large = swung(0.5, [0.0, 0.0], raised=60.0), swung(0.5, [1.9, 0.0])
    assert_allclose(response, [small], rtol=1e-3)
    assert abs(large) > 3 * abs(small)
    assert "several periodic motions at omega = 2 rad/s" in message
    for motion in (small, large):
        assert f"{abs(motion):.4g}"[:4] in message


def test_a_motion_without_symmetry_is_found_as_well():
    assert_allclose(
        motions(Leaning(), 0.4)[0],
        [swung(0.4, [0.0, 0.0], raised=60.0, quadratic=0.5)],
        rtol=2e-3,
    )


def test_a_small_amplitude_has_one_motion_and_nothing_is_said():
    response, messages = motions(Spring(), 0.01)
    assert messages == []
    assert_allclose(response, gb.frequency_response(Spring(), {}, [OMEGA]).response, rtol=1e-3)


def test_a_linear_model_is_not_searched():
    omega = np.array([1.0, 3.0])
    sine = gb.modeling.Sine("u", 40.0)
    response, messages = periodic_motions(LinearTilt(), {}, omega, sine, output="theta")
    assert messages == []
    assert_allclose(
        response, gb.frequency_response(LinearTilt(), {}, omega, output="theta").response
    )


def test_a_number_of_harmonics_is_kept():
    """One harmonic of a cubic spring under a sine of its position: the describing function, exactly."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    response, _ = periodic_motions(Spring(), {}, np.array([OMEGA]), sine)
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


def test_a_warning_names_the_motions_only_where_there_are_several():
    with pytest.warns(UserWarning, match="Spring has several periodic motions"):
        gb.modeling.harmonic_response(Spring(), {}, OMEGA, amplitude={"u": 0.5})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gb.modeling.harmonic_response(Spring(), {}, OMEGA, amplitude={"u": 0.01})


# --- one harmonic: the motions are the roots of a cubic


def describing_responses(amplitude):
    """All x with (1 - ω² + 3/4 |x|² + 0.1 jω) x = amplitude, over the amplitude, the smallest first."""
    stiffness = 1 - OMEGA**2
    damping = OMEGA * DAMPING
    roots = np.roots([9 / 16, 1.5 * stiffness, stiffness**2 + damping**2, -(amplitude**2)])
    squares = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    return 1 / (stiffness + 0.75 * squares + 1j * damping)


@pytest.mark.parametrize("amplitude", [0.02, 0.45, 0.55, 2.0])
def test_the_smallest_motion_is_used_and_the_largest_is_named(amplitude):
    """Between the jumps there are three motions; below and above them there is one."""
    exact = describing_responses(amplitude)
    response, messages = motions(Spring(), amplitude, harmonics=1)
    assert_allclose(response, exact[:1], rtol=1e-6)
    assert len(messages) == (len(exact) > 1)
    if messages:
        assert f"may show {abs(exact[-1]):.4g} at" in messages[0]


def test_a_signal_that_a_loop_holds_to_a_sine_keeps_its_mean():
    """About zero: the mean of the force meets what pushes the position to one side."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    response, _ = periodic_motions(Leaning(), {}, np.array([OMEGA]), sine)
    assert_allclose(response, [1 / (1 + 0.75 * 4.0 - OMEGA**2 + 1j * OMEGA * DAMPING)], rtol=1e-6)
