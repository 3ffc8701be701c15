"""Several motions under one sine, against simulations that begin elsewhere and the amplitude raised slowly."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.modeling import periodic_motions as periodic
from greybox.modeling.harmonic_balance import MOST_HARMONICS, harmonic_function
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


def found(model, amplitude, **options):
    return periodic_motions(
        model, {}, np.array([OMEGA]), gb.modeling.Sine("u", amplitude, **options)
    )


def test_the_motion_that_is_used_is_that_of_an_amplitude_raised_slowly():
    """Below the fold the small motion, though the large one exists as well and a push from outside reaches it."""
    motions = found(Spring(), 0.5)
    small, large = swung(0.5, [0.0, 0.0], raised=60.0), swung(0.5, [1.9, 0.0])
    assert_allclose(motions.response, [small], rtol=1e-3)
    assert abs(large) > 3 * abs(small)
    (sentence,) = motions.several
    assert (
        "has 3 periodic motions at omega = 2 rad/s in which u is a sine of amplitude 0.5"
        in sentence
    )
    for response, kind in ((small, "stable"), (large, "stable")):
        assert f"{abs(response):.4g}"[:4] in sentence
        assert kind in sentence
    assert sentence.count("unstable") == 1


def test_a_motion_without_symmetry_is_found_as_well():
    assert_allclose(
        found(Leaning(), 0.4).response,
        [swung(0.4, [0.0, 0.0], raised=60.0, quadratic=0.5)],
        rtol=2e-3,
    )


def test_a_small_amplitude_has_one_motion_and_nothing_is_said():
    motions = found(Spring(), 0.01)
    assert motions.several == ()
    assert_allclose(
        motions.response, gb.frequency_response(Spring(), {}, [OMEGA]).response, rtol=1e-3
    )


def test_a_linear_model_is_not_searched():
    omega = np.array([1.0, 3.0])
    sine = gb.modeling.Sine("u", 40.0)
    motions = periodic_motions(LinearTilt(), {}, omega, sine, output="theta")
    assert motions.several == ()
    assert_allclose(
        motions.response, gb.frequency_response(LinearTilt(), {}, omega, output="theta").response
    )


def test_a_number_of_harmonics_is_kept():
    """One harmonic of a cubic spring under a sine of its position: the describing function, exactly."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    motions = periodic_motions(Spring(), {}, np.array([OMEGA]), sine)
    assert_allclose(
        motions.response, [1 / (1 + 0.75 * 4.0 - OMEGA**2 + 1j * OMEGA * DAMPING)], rtol=1e-6
    )


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
    with pytest.warns(UserWarning, match="Spring has 3 periodic motions"):
        gb.modeling.harmonic_response(Spring(), {}, OMEGA, amplitude={"u": 0.5})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gb.modeling.harmonic_response(Spring(), {}, OMEGA, amplitude={"u": 0.01})


# --- one harmonic, of which the motions are the roots of a cubic


def level_of(model, amplitude, harmonics, omega=OMEGA):
    sine = gb.modeling.Sine("u", amplitude, harmonics=harmonics)
    options = {"input": "u", "output": model.output_names[0], "pade": None}
    return periodic._Levels(
        model, list(model.values({}).values()), np.array([omega]), sine, options
    )


def describing_responses(amplitude, b=1.0):
    """All x with (1 - ω² + 3/4 b |x|² + 0.1 jω) x = amplitude, over the amplitude, the smallest first."""
    stiffness, damping = 1 - OMEGA**2, OMEGA * DAMPING
    roots = np.roots(
        [9 / 16 * b**2, 1.5 * b * stiffness, stiffness**2 + damping**2, -(amplitude**2)]
    )
    squares = np.sort(roots[np.abs(roots.imag) < 1e-9].real)
    return 1 / (stiffness + 0.75 * b * squares + 1j * damping)


@pytest.mark.parametrize("amplitude", [0.02, 0.45, 0.55])
def test_the_curve_meets_all_motions_in_their_order(amplitude):
    wanted = describing_responses(amplitude)
    level = level_of(Spring(), amplitude, 1)
    balance, given = level.balance(1), level.given(1, 0)
    followed = periodic._followed(balance, given, 1 / periodic.RANGE)
    assert_allclose([periodic._response(balance, x, given) for x in followed], wanted, rtol=1e-7)
    candidates = periodic._candidates(balance, given)
    assert_allclose([periodic._response(balance, x, given) for x in candidates], wanted, rtol=1e-7)
    from_above = periodic._followed(balance, given, periodic.RANGE)
    assert_allclose(
        [periodic._response(balance, x, given) for x in from_above], wanted[::-1], rtol=1e-7
    )


def test_points_of_the_curve_are_motions_and_its_tangent_leads_along_it():
    level = level_of(Spring(), 0.4, 1)
    balance, given = level.balance(1), level.given(1, 0)
    curve = periodic._Curve(balance, given)
    at = np.log(0.3)
    y = np.append(periodic._solved(balance, np.zeros(7), curve.given_at(at)), at)
    scale = np.append(np.full(7, 0.5), 1.0)
    tangent = curve.tangent(y, np.append(np.zeros(7), 1.0), scale)
    assert np.linalg.norm(tangent / scale) == pytest.approx(1)
    assert tangent[-1] > 0
    assert_allclose(curve.tangent(y, np.append(np.zeros(7), -1.0), scale), -tangent)
    near = [
        np.append(periodic._solved(balance, y[:-1], curve.given_at(at + h)), at + h)
        for h in (-1e-4, 1e-4)
    ]
    assert_allclose(tangent / tangent[-1], (near[1] - near[0]) / 2e-4, rtol=1e-5, atol=1e-6)

    guess = y + 0.05 * tangent
    point = curve.corrected(guess, tangent, scale)
    assert abs((point - guess) / scale @ (tangent / scale)) < 1e-9
    assert periodic._response(balance, point[:-1], curve.given_at(point[-1])) == pytest.approx(
        describing_responses(np.exp(point[-1]))[0], rel=1e-7
    )


@pytest.mark.parametrize("harmonics", [1, 3])
def test_a_stated_number_of_harmonics_of_the_input_is_kept(harmonics):
    motions = periodic_motions(
        Spring(), {}, np.array([OMEGA]), gb.modeling.Sine("u", 0.5, harmonics=harmonics)
    )
    one = describing_responses(0.5)[0]
    assert (abs(motions.response[0] - one) < 1e-9) == (harmonics == 1)
    assert_allclose(motions.response, [one], rtol=1e-5)


class Scaled(Spring):
    """The position in another unit."""

    unit = 1e-3

    def output(self, x, u, p):
        return (self.unit * x.x,)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_the_number_of_harmonics_does_not_depend_on_the_unit(unit):
    """Seven suffice for two states, of which each has a mean as well."""
    model = type("Scaled", (Scaled,), {"unit": unit})()
    motion = periodic._motions(level_of(model, 0.5, 3), 3, 0, True)[0]
    assert motion.harmonics.size == 2 * (2 * 7 + 1) + 1


class Swing(gb.StateSpace):
    """x'' + c x' + (d + u) x = 0, whose motion x = 0 a sine for u makes unstable (Mathieu)."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    c = gb.Parameter(0.1)
    d = gb.Parameter(1.3)

    def derivative(self, x, u, p):
        return (x.v, -(p.d + u.u) * x.x - p.c * x.v)

    def output(self, x, u, p):
        return (x.x,)


def multiplier(amplitude, omega, c=0.1, d=1.3, steps=100):
    """The largest over a period, by Runge and Kutta's method."""

    def slope(t, z):
        return np.array([z[1], -(d + amplitude * np.cos(omega * t)) * z[0] - c * z[1]])

    z, h = np.eye(2), 2 * np.pi / omega / steps
    for k in range(steps):
        a = slope(k * h, z)
        b = slope((k + 0.5) * h, z + h / 2 * a)
        e = slope((k + 0.5) * h, z + h / 2 * b)
        z = z + h / 6 * (a + 2 * b + 2 * e + slope((k + 1) * h, z + h * e))
    return np.abs(np.linalg.eigvals(z)).max()


def test_a_motion_is_stable_where_its_multipliers_are_below_one():
    omega = 2.1
    low, high = 0.0, 2.0
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (middle, high) if multiplier(middle, omega) < 1 else (low, middle)
    for amplitude, stable in ((low - 0.01, True), (low + 0.01, False)):
        level = level_of(Swing(), amplitude, 3, omega)
        balance, given = level.balance(3), level.given(3, 0)
        at_rest = np.zeros(balance.balance.unknown.numel())
        assert periodic._is_stable(balance, at_rest, given) == stable


class Rubbing(gb.StateSpace):
    """A mass with viscous and Coulomb friction."""

    states, inputs, outputs = ("v",), ("u",), ("v",)
    c = gb.Parameter(0.5, bounds=(0, 10))

    def derivative(self, x, u, p):
        return (u.u - 0.3 * x.v - p.c * gb.sign(x.v),)

    def output(self, x, u, p):
        return (x.v,)


def test_the_response_of_a_motion_with_jumps_is_extrapolated_as_that_of_a_fit():
    level = level_of(Rubbing(), 5.0, 7, omega=0.8)
    balance, given = level.balance(7), level.given(7, 0)
    motion = level.solved(7, np.asarray(balance.guess(given)).ravel(), 0)
    re, im = harmonic_function(Rubbing(), np.array([0.8]), gb.modeling.Sine("u", 5.0, harmonics=7))(
        [0.5]
    )
    assert level.response(7, motion, 0) == pytest.approx(complex(re, im), rel=1e-9)
    assert abs(level.response(7, motion, 0) / periodic._response(balance, motion, given) - 1) > 1e-3


def test_of_unstable_motions_the_stable_one_next_to_the_first_is_meant():
    def motion(response, stable):
        return periodic._Motion(np.zeros(1), response, stable)

    first, near, far = motion(1.0, False), motion(1.5j, True), motion(-3.0, True)
    assert periodic._chosen([first, far, near]) is near
    assert periodic._chosen([motion(1.0, True), near]).response == 1.0
    assert periodic._chosen([motion(2.0, None), near]).response == 2.0
    assert periodic._chosen([first, motion(1.1, False)]) is first


def test_a_motion_of_a_symmetric_model_has_its_twin(monkeypatch):
    """The other way up, half a period later: odd harmonics stay, the mean and the even ones change their sign."""
    level = level_of(Spring(), 0.4, 3)
    balance, given = level.balance(3), level.given(3, 0)
    number = (balance.balance.places % (2 * MOST_HARMONICS + 1) + 1) // 2
    x = np.random.default_rng(0).normal(size=number.size)
    twin = np.where(number % 2 == 1, x, -x)
    monkeypatch.setattr(periodic, "_followed", lambda *_: [x])
    monkeypatch.setattr(
        periodic, "_solved", lambda _, guess, __: guess if np.allclose(guess, twin) else None
    )
    found = periodic._candidates(balance, given)
    assert len(found) == 2
    assert found[0] is x
    assert_allclose(found[1], twin)


def test_motions_are_distinct_by_a_thousandth_of_their_size():
    x = np.array([3.0, 4.0])
    near, far, rest = np.array([3.0, 4.0049]), np.array([3.0, 4.0051]), np.zeros(2)
    assert [m is x for m in periodic._distinct([x, near])] == [True]
    assert [id(m) for m in periodic._distinct([x, near, far, rest, rest])] == [
        id(m) for m in (x, far, rest)
    ]


def test_equations_without_a_solution_of_any_use_have_none():
    matrix, right = np.array([[2.0, 1.0], [0.0, 4.0]]), np.array([5.0, 8.0])
    assert_allclose(periodic._solution(matrix, right), [1.5, 2.0])
    assert periodic._solution(np.ones((2, 2)), right) is None
    assert periodic._solution(np.where(matrix == 4, np.nan, matrix), right) is None
    assert periodic._solution(matrix, np.array([5.0, np.inf])) is None
    assert periodic._solution(np.eye(2), np.array([-0.99e6, 0.0])) is not None
    assert periodic._solution(np.eye(2), np.array([-1.01e6, 0.0])) is None


def test_all_motions_are_said_with_gain_phase_and_stability():
    motions = [
        periodic._Motion(np.zeros(1), r, s)
        for r, s in ((1.5j, True), (-0.25, False), (2 + 0j, None))
    ]
    omega, sine = np.array([1.0, 2.0]), gb.modeling.Sine("u", [0.1, 0.5])
    said = periodic._said(Spring(), sine, omega, 1, [*motions, motions[0]], motions[2])
    assert said == (
        "Spring has 4 periodic motions at omega = 2 rad/s in which u is a sine of amplitude 0.5, with the responses "
        "1.5 at 90.0°, stable; 0.25 at 180.0°, unstable; 2 at 0.0°: that of 2 is used, but a test may show another, "
        "depending on how it began."
    )


def test_the_first_frequency_without_a_motion_is_named():
    sine = gb.modeling.Sine("u", [0.1, 0.5, 0.7])
    omega, response = np.array([1.0, 2.0, 3.0]), np.array([1.0, np.nan, np.nan + 0j])
    with pytest.raises(
        ValueError,
        match=r"no periodic motion at omega = 2 rad/s in which u is a sine of amplitude 0.5:",
    ):
        periodic._require_finite(Spring(), omega, sine, response)
    periodic._require_finite(Spring(), omega[:1], gb.modeling.Sine("u", 0.1), response[:1])


def test_harmonics_have_places_that_do_not_depend_on_their_number():
    """Mean, cosines and sines of both states, and the mean of the input, whose sine is given."""
    few, many = level_of(Spring(), 0.5, 3), level_of(Spring(), 0.5, 7)
    balance = few.balance(3).balance
    coefficients = [*range(7), *range(7), 0]
    signals = [0] * 7 + [1] * 7 + [2]
    assert balance.places.tolist() == [
        (2 * MOST_HARMONICS + 1) * s + c for s, c in zip(signals, coefficients, strict=True)
    ]
    numbers = np.array([(c + 1) // 2 for c in coefficients])
    np.testing.assert_array_equal(balance.orders, np.maximum(numbers, 1) ** 2)
    np.testing.assert_array_equal(balance.mirror, np.where(numbers % 2, 1, -1))
    padded = periodic._padded(np.arange(1.0, 16.0), few.balance(3), many.balance(7))
    wanted = np.zeros(31)
    wanted[[*range(7), *range(15, 22), 30]] = np.arange(1.0, 16.0)
    np.testing.assert_array_equal(padded, wanted)


def test_a_signal_that_a_loop_holds_to_a_sine_keeps_its_mean():
    """Of the position, about zero: what pushes to one side is met by the mean of the force, and no first harmonic."""
    sine = gb.modeling.Sine("x", 2.0, harmonics=1)
    motions = periodic_motions(Leaning(), {}, np.array([OMEGA]), sine)
    assert_allclose(
        motions.response, [1 / (1 + 0.75 * 4.0 - OMEGA**2 + 1j * OMEGA * DAMPING)], rtol=1e-6
    )
