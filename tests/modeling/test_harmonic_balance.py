"""Finite amplitudes: describing functions, simulated and periodic solutions, the linear limit, derivatives, fits."""

import math
import re
from functools import cache
from itertools import cycle, pairwise

import casadi as ca
import numpy as np
import pytest
from evaluation import numeric_jacobian
from numpy.testing import assert_allclose
from scipy.integrate import solve_bvp, solve_ivp
from scipy.optimize import brentq

import greybox as gb
from greybox.modeling import harmonic_balance
from greybox.modeling.harmonic_balance import compiled_balance, directly_found
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt
from greybox.models.yaw import YawStates

TRUTH = {
    "a1": -11.0,
    "a2": 2.6,
    "a3": 8.0,
    "a4": 290.0,
    "T_rotor": 0.048,
    "T_delay": 0.0042,
    "C_x": 0.3,
}
TRUTH_FREE = {name: value for name, value in TRUTH.items() if not name.startswith("T_")}
OMEGA = np.array([1.0, 1.7, 2.8, 4.5, 8.0, 16.0])
SWING = float(np.radians(6))
PERIODS = 40  # until the drag, the slowest thing here, has forgotten the beginning


def static(formula):
    body = {
        "inputs": ("u",),
        "outputs": ("y",),
        "K": gb.Parameter(1.0),
        "output": lambda self, x, u, p: (formula(u.u),),
    }
    return type("Static", (gb.StateSpace,), body)()


class Slider(gb.StateSpace):
    """Velocity from the tilt angle, the first line of (4.23)."""

    states, inputs, outputs = ("v",), ("theta",), ("v",)
    C_x = gb.Parameter(0.3, bounds=(0.001, 2), unit="1/m", scale="log")

    def derivative(self, x, u, p):
        return (PAPER_G * gb.tan(u.theta) - p.C_x * abs(x.v) * x.v,)

    def output(self, x, u, p):
        return (x.v,)


def first_harmonic(signal):
    """Complex amplitude of exp(jωt) from samples of one period."""
    return 2 * np.fft.fft(signal)[1] / signal.size


@cache
def simulated_velocity(omega, swing, middle=0.0, C_x=TRUTH["C_x"]):
    """First harmonic of the velocity while the angle is middle + swing cos ωt, by simulation until it repeats."""
    period = 2 * np.pi / omega

    def slope(t, v):
        return PAPER_G * math.tan(middle + swing * math.cos(omega * t)) - C_x * abs(v[0]) * v[0]

    begin = np.sign(middle) * np.sqrt(PAPER_G * np.tan(abs(middle)) / C_x)
    periods = PERIODS if omega >= 1 else 4  # in a slow one the drag has longer to forget
    last = (periods + np.arange(256) / 256) * period
    found = solve_ivp(
        slope, (0, last[-1]), [begin], t_eval=last, rtol=1e-9, atol=1e-11, method="LSODA"
    )
    return first_harmonic(found.y[0])


def simulated_response(omega, swing, middle=0.0, truth=TRUTH):
    """Angle over control: the angle and the simulated velocity, put into the other lines of (4.23) one by one."""
    p, s = truth, 1j * omega
    v = simulated_velocity(omega, swing, middle, p["C_x"])
    torque = ((s**2 + p["a2"] * s + p["a1"]) * swing + p["a3"] * v) / p["a4"]
    return swing / (torque * (1 + p["T_rotor"] * s) * np.exp(s * p["T_delay"]))


# --- numbers


@pytest.mark.parametrize("amplitude", [0.1, 3.0])
@pytest.mark.parametrize(
    ("formula", "gain"),
    [
        (lambda u: abs(u) * u, lambda V: 8 / (3 * np.pi) * V),
        (lambda u: u**3 + 2 * u, lambda V: 0.75 * V**2 + 2),
    ],
    ids=["|u| u", "u³ + 2 u"],
)
def test_the_response_of_a_static_model_is_its_describing_function(formula, gain, amplitude):
    response = gb.modeling.harmonic_response(
        static(formula), {}, [0.5, 7.0], amplitude={"u": amplitude}
    ).response
    assert_allclose(response, gain(amplitude), rtol=3e-5)


@pytest.mark.parametrize("middle", [0.0, float(np.radians(5))])
def test_the_velocity_is_that_of_a_simulation(middle):
    sine = gb.modeling.Sine("theta", SWING, harmonics=9)
    response = gb.modeling.harmonic_response(
        Slider(), {}, OMEGA, amplitude=sine, at={"theta": middle}
    ).response
    assert_allclose(
        response, [simulated_velocity(w, SWING, middle) / SWING for w in OMEGA], rtol=2e-5
    )


@pytest.mark.parametrize("middle", [0.0, float(np.radians(5))])
def test_the_tilt_with_an_angle_held_to_a_sine_is_that_of_a_simulation(middle):
    options = {"output": "theta", "at": {"theta": middle}}
    response = gb.modeling.harmonic_response(
        NonlinearTilt(), TRUTH, OMEGA, amplitude={"theta": SWING}, **options
    ).response
    wanted = [simulated_response(w, SWING, middle) for w in OMEGA]
    assert_allclose(response, wanted, rtol=1e-3)  # of three harmonics
    more = gb.modeling.Sine("theta", SWING, harmonics=9)
    response = gb.modeling.harmonic_response(
        NonlinearTilt(), TRUTH, OMEGA, amplitude=more, **options
    ).response
    assert_allclose(response, wanted, rtol=1e-5)
    linear = gb.frequency_response(NonlinearTilt(), TRUTH, OMEGA, **options).response
    assert np.abs(linear / wanted - 1).max() > 0.02


@pytest.mark.parametrize("omega", [2.0, 5.0])
def test_the_tilt_with_a_sine_for_control_solves_the_periodic_boundary_value_problem(omega):
    """The plant is unstable, so no simulation gets there; collocation on the whole orbit does."""
    amplitude, p = 0.02, TRUTH

    def slope(t, x):
        v, q, theta, rotor = x
        control = amplitude * np.cos(omega * t)
        acceleration = -p["a1"] * theta - p["a2"] * q - p["a3"] * v + p["a4"] * rotor
        drag = p["C_x"] * np.abs(v) * v
        return np.array(
            [PAPER_G * np.tan(theta) - drag, acceleration, q, (control - rotor) / p["T_rotor"]]
        )

    t = np.linspace(0, 2 * np.pi / omega, 101)
    found = solve_bvp(
        slope, lambda a, b: a - b, t, np.zeros((4, t.size)), tol=1e-8, max_nodes=20000
    )
    assert found.success
    theta = found.sol(t[-1] * np.arange(256) / 256)[2]
    wanted = first_harmonic(theta) / amplitude * np.exp(-1j * omega * p["T_delay"])
    sine = gb.modeling.Sine("u", amplitude, harmonics=7)
    response = gb.modeling.harmonic_response(
        NonlinearTilt(), p, omega, amplitude=sine, output="theta"
    ).response
    assert_allclose(response, wanted, rtol=1e-4)


@pytest.mark.parametrize("model", [LinearTilt(), YawStates()], ids=repr)
@pytest.mark.parametrize("delay", ["exact", "pade:2"])
def test_a_linear_model_keeps_its_linear_response_whatever_moves_sinusoidally(model, delay):
    signals = dict.fromkeys((*model.inputs, *model.outputs, *model.states))
    for signal, output in zip(signals, cycle(model.outputs), strict=False):
        options = {"output": output, "delay": delay}
        response = gb.modeling.harmonic_response(
            model, {}, OMEGA, amplitude={signal: 40.0}, **options
        ).response
        linear = gb.frequency_response(model, {}, OMEGA, **options).response
        assert_allclose(response, linear, rtol=1e-10)


@pytest.mark.parametrize("signal", ["theta", "u"])
@pytest.mark.parametrize("degrees", [0, 5])
def test_a_vanishing_amplitude_gives_the_linear_response(signal, degrees):
    options = {"output": "theta", "at": {"theta": float(np.radians(degrees))}}
    linear = gb.frequency_response(NonlinearTilt(), TRUTH, OMEGA, **options).response
    error = [
        np.abs(
            gb.modeling.harmonic_response(
                NonlinearTilt(), TRUTH, OMEGA, amplitude={signal: a}, **options
            ).response
            / linear
            - 1
        )
        for a in (1e-3, 1e-5)
    ]
    # With the square of the amplitude where the model is smooth, with the amplitude itself where
    # |v| v has its kink.
    assert error[1].max() < (0.02 if degrees == 0 else 2e-4) * error[0].max()
    assert error[1].max() < (2e-4 if degrees == 0 else 1e-8)


def test_every_frequency_has_its_own_amplitude():
    amplitudes = np.linspace(0.02, 0.2, OMEGA.size)
    together = gb.modeling.harmonic_response(
        NonlinearTilt(), TRUTH, OMEGA, amplitude={"theta": amplitudes}, output="theta"
    )
    for omega, amplitude, wanted in zip(OMEGA, amplitudes, together.response, strict=True):
        alone = gb.modeling.harmonic_response(
            NonlinearTilt(), TRUTH, omega, amplitude={"theta": amplitude}, output="theta"
        )
        assert_allclose(alone.response, wanted, rtol=1e-9)


def test_a_sine_that_is_a_formula_of_the_states_is_met():
    """The output is theta / 2: half the amplitude there is the same motion."""

    class Halved(NonlinearTilt):
        outputs = ("half", "v")

        def output(self, x, u, p):
            return (x.theta / 2, x.v)

    half = gb.modeling.harmonic_response(
        Halved(), TRUTH, OMEGA, amplitude={"half": SWING / 2}, output="v"
    ).response
    whole = gb.modeling.harmonic_response(
        NonlinearTilt(), TRUTH, OMEGA, amplitude={"theta": SWING}, output="v"
    ).response
    assert_allclose(half, whole, rtol=1e-9)


@pytest.mark.parametrize(("signal", "amplitude"), [("theta", SWING), ("u", 0.01)])
def test_jacobian_and_hessian_through_the_balance(signal, amplitude):
    sine = gb.modeling.Sine(signal, amplitude, harmonics=7)
    function = compiled_balance(NonlinearTilt(), OMEGA[:3], sine, output="theta").function()
    p, point = ca.MX.sym("p", 7), np.array(list(TRUTH.values()))
    column = ca.vertcat(*function(p))
    weights = ca.DM(np.cos(np.arange(6)))
    hessian = ca.hessian(ca.dot(weights, column), p)[0]
    value, jacobian, hessian = (
        ca.Function("f", [p], [e]) for e in (column, ca.jacobian(column, p), hessian)
    )
    wanted = numeric_jacobian(lambda x: np.asarray(value(x)).ravel(), point, 1e-4)
    assert_allclose(
        jacobian(point), wanted, rtol=1e-7, atol=1e-8 * np.abs(wanted).max(axis=0).min()
    )
    wanted = numeric_jacobian(
        lambda x: np.asarray(weights).ravel() @ np.asarray(jacobian(x)), point, 1e-4
    )
    assert_allclose(hessian(point), wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())


def test_an_angle_held_to_a_sine_has_a_response_in_the_whole_box():
    parameters = NonlinearTilt().parameters
    points = gb.solve.Sobol(128).draw(parameters)
    for swing in (0.01, 0.5):
        sine = gb.modeling.Sine("theta", swing, harmonics=7)
        function = compiled_balance(NonlinearTilt(), OMEGA[::2], sine, output="theta").function()
        assert np.all(np.isfinite(np.asarray(function(points.T)[0])))


# --- switches


SWITCHED = {
    "relay": gb.sign,
    "relay beside a gain": lambda u: 2 * u + 3 * gb.sign(u),
    "choice": lambda u: gb.where(u > 0.4, 1.0, -2.0),
    "choice within a choice": lambda u: gb.where(u > 0, 1.0, gb.where(u < 0, -1.0, 0.0)),
    "comparison": lambda u: (u > 0.3) * u,
    "sign in a product": lambda u: gb.sign(u - 0.2) * u**2,
    "saturation": lambda u: gb.maximum(gb.minimum(u, 0.7), -0.7),
    "dead zone": lambda u: u - gb.maximum(gb.minimum(u, 0.7), -0.7),
    "magnitude": lambda u: abs(u) + abs(u - 0.5),
}


@pytest.mark.parametrize("name", SWITCHED)
def test_a_switched_static_model_has_its_describing_function(name):
    """Against the integral over a period, by the midpoint rule."""
    formula, amplitude = SWITCHED[name], 1.6
    phase = 2 * np.pi * (np.arange(40_000) + 0.5) / 40_000
    wanted = 2 * np.mean(formula(amplitude * np.cos(phase)) * np.cos(phase)) / amplitude
    response = gb.modeling.harmonic_response(
        static(formula), {}, [1.0], amplitude={"u": amplitude}
    ).response
    assert_allclose(response, [wanted], rtol=2e-3)


class Rubbing(gb.StateSpace):
    """A mass with viscous and Coulomb friction."""

    states, inputs, outputs = ("v",), ("F",), ("v",)
    m = gb.Parameter(1.0, bounds=(0.1, 10), unit="kg")
    b = gb.Parameter(0.3, bounds=(0, 10), unit="kg/s", fixed=True)
    c = gb.Parameter(0.5, bounds=(0, 10), unit="N")

    def derivative(self, x, u, p):
        return ((u.F - p.b * x.v - p.c * gb.sign(x.v)) / p.m,)

    def output(self, x, u, p):
        return (x.v,)


def rubbing_exactly(force, omega, m, b, c):
    """First harmonic of the speed over the force: the linear equation is solved on half a period without sticking."""
    half = np.pi / omega

    def speed(t, phase):
        motion = [
            (force * np.exp(1j * (omega * at + phase)) / (1j * omega * m + b)).real - c / b
            for at in (t, 0.0)
        ]
        return motion[0] - motion[1] * np.exp(-b / m * t)

    t = half * (np.arange(20_000) + 0.5) / 20_000
    phases = np.linspace(-np.pi, np.pi, 401)
    end = speed(half, phases)
    for k in np.flatnonzero(end[1:] * end[:-1] < 0):
        phase = brentq(lambda x: speed(half, x), phases[k], phases[k + 1])
        if speed(t, phase).min() > 0:
            return 2 * np.mean(speed(t, phase) * np.exp(-1j * (omega * t + phase))) / force
    raise AssertionError("the mass sticks")


def test_friction_under_a_force_is_the_exact_motion():
    values = {"m": 2.0, "b": 0.3, "c": 1.0}
    sine = gb.modeling.Sine("F", 5.0, harmonics=9)
    function = compiled_balance(Rubbing(), np.array([1.0]), sine).function()
    re, im = (float(part) for part in function(list(values.values())))
    assert_allclose(re + 1j * im, rubbing_exactly(5.0, 1.0, **values), rtol=5e-3)


def rubbing_with_stops(force, omega, m, b, c):
    """First harmonic of the speed over the force: small steps, in which a mass stops that would turn."""
    t = np.linspace(0, 4 * np.pi / omega, 40_001)
    speeds, speed = np.zeros(t.size), 0.0
    push, step = (force * np.cos(omega * (t + t[1] / 2))).tolist(), t[1]
    for k in range(t.size - 1):
        rest = push[k] - b * speed
        side = np.sign(speed) or np.sign(push[k]) * (abs(push[k]) > c)
        after = speed + step / m * (rest - c * side) if side else 0.0
        speed = 0.0 if speed * after < 0 else after
        speeds[k + 1] = speed
    last = slice(20_000, 40_000)
    return 2 * np.mean(speeds[last] * np.exp(-1j * omega * t[last])) / force


@pytest.mark.parametrize(
    ("force", "b", "error"),
    [(1.3, 0.5, 0.02), (2.5, 0.5, 0.01), (0.8, 0.5, None), (1.05, 0.1, 0.15)],
)
def test_friction_with_stops_is_that_of_a_simulation_and_less_force_leaves_the_mass_at_rest(
    force, b, error
):
    values = {"m": 1.0, "b": b, "c": 1.0}
    sine = gb.modeling.Sine("F", force, harmonics=31)
    response, _ = directly_found(Rubbing(), values, np.array([2.0]), sine)
    exact = rubbing_with_stops(force, 2.0, **values)
    assert abs(exact) > 0.002 or error is None
    assert abs(response[0] - exact) < (0.001 if error is None else error * abs(exact))


def test_a_fit_finds_the_friction_and_a_threshold_inside_a_condition():
    omega = np.geomspace(0.3, 20, 4)
    speed = 0.5
    exact = 1 / (2j * omega + 0.3 + 4 * 1.0 / (np.pi * speed))
    data = gb.FrequencyResponse(omega, exact, input="F", output="v")
    sine = gb.modeling.Sine("v", speed, harmonics=1)
    fit = gb.fit(gb.Problem(Rubbing(), data, amplitude=sine), [{}], progress=False, profiles=False)
    assert fit.estimate["c"] == pytest.approx(1.0, rel=1.5e-4)
    assert fit.estimate["m"] == pytest.approx(2.0, rel=1e-4)

    class Gap(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        d = gb.Parameter(0.3, bounds=(0.05, 0.9))

        def output(self, x, u, p):
            return (gb.where(abs(u.u) > p.d, u.u, 0.0),)

    share = np.sqrt(1 - 0.6**2)
    gain = 1 - 2 / np.pi * (np.arcsin(0.6) - 0.6 * share)
    data = gb.FrequencyResponse([1.0, 2.0, 3.0], np.full(3, gain), input="u", output="y")
    sine = gb.modeling.Sine("u", 1.0, harmonics=1)
    fit = gb.fit(gb.Problem(Gap(), data, amplitude=sine), [{}], progress=False, profiles=False)
    assert fit.estimate["d"] == pytest.approx(0.6, rel=1e-3)


class Servo(gb.StateSpace):
    """A second-order lag behind a dead zone and a saturation."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    k = gb.Parameter(20.0, bounds=(1, 100), fixed=True)
    d = gb.Parameter(3.0, bounds=(0.1, 20))
    w = gb.Parameter(16.0, bounds=(1, 100))
    dead = gb.Parameter(0.1, bounds=(0, 0.5))
    limit = gb.Parameter(0.8, bounds=(0.3, 3))

    def derivative(self, x, u, p):
        error = u.u - 0.3 * x.x
        beyond = error - gb.minimum(gb.maximum(error, -p.dead), p.dead)
        force = gb.minimum(gb.maximum(beyond, -p.limit), p.limit)
        return (x.v, p.k * force - p.d * x.v - p.w * x.x)

    def output(self, x, u, p):
        return (x.x,)


SERVO = {"k": 20.0, "d": 4.0, "w": 20.0, "dead": 0.15, "limit": 0.5}


def test_a_dead_zone_and_a_saturation_are_found():
    """Two amplitudes of one servo: together they tell the dead zone from the saturation."""
    omega = np.geomspace(1, 15, 4)
    random = np.random.default_rng(0)
    problems = []
    for amplitude in (0.4, 1.5):
        sine = gb.modeling.Sine("u", amplitude, harmonics=3)
        exact, _ = directly_found(Servo(), SERVO, omega, sine)
        errors = random.normal(size=4) + 1j * random.normal(size=4)
        data = gb.FrequencyResponse(omega, exact * (1 + 0.005 * errors), input="u", output="x")
        problems.append(gb.Problem(Servo(), data, amplitude=sine))
    fit = gb.fit(problems[0] + problems[1], 1, progress=False, profiles=False)
    for name in ("d", "w", "dead", "limit"):
        error = fit.estimate[name] - SERVO[name]
        assert abs(error) < 4 * fit.standard_error[name] < 0.2 * SERVO[name]


# --- several motions


class Duffing(gb.StateSpace):
    """A hardening spring."""

    states, inputs, outputs = ("x", "v"), ("u",), ("x",)
    b = gb.Parameter(1.0, bounds=(0, 10))

    def derivative(self, x, u, p):
        return (x.v, -x.x - p.b * x.x**3 - 0.2 * x.v + u.u)

    def output(self, x, u, p):
        return (x.x,)


def settled(amplitude, omega):
    """The first harmonic over the amplitude after 60 periods from rest."""
    period = 2 * np.pi / omega
    t = (60 + np.arange(256) / 256) * period

    def slope(t, z):
        return [z[1], -z[0] - z[0] ** 3 - 0.2 * z[1] + amplitude * np.cos(omega * t)]

    return (
        first_harmonic(solve_ivp(slope, (0, t[-1]), [0, 0], t_eval=t, rtol=1e-8, atol=1e-10).y[0])
        / amplitude
    )


@pytest.mark.parametrize(("amplitude", "omega"), [(2.0, 1.0)])
def test_a_strong_spring_has_as_many_harmonics_as_it_needs(amplitude, omega):
    response = gb.modeling.harmonic_response(
        Duffing(), {}, [omega], amplitude={"u": amplitude}
    ).response
    assert_allclose(response, [settled(amplitude, omega)], rtol=1e-3)


# --- fits


def made(swing, middle=0.0, noise=0.005, seed=0, omega=OMEGA):
    """A sine test with the simulated truth."""
    random = np.random.default_rng(seed)
    exact = np.array([simulated_response(w, swing, middle) for w in omega])
    error = noise * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size))
    return gb.FrequencyResponse(
        omega, exact * (1 + error), input="u", output="theta", name=f"sines about {middle:g}"
    )


@cache
def fitted():
    problem = gb.Problem(NonlinearTilt(), made(SWING), amplitude={"theta": SWING})
    return gb.fit(problem, [{}, TRUTH_FREE], progress=False, profiles=False)


def test_the_drag_shows_in_hover_at_finite_amplitude():
    fit = fitted()
    assert fit.agreeing >= 2
    assert fit.warnings == ()
    for name in fit.free:
        assert abs(fit.estimate[name] - TRUTH[name]) < 3 * fit.standard_error[name]
    assert fit.standard_error["C_x"] < 0.1 * fit.estimate["C_x"]


def test_the_linearization_does_not_see_it():
    fit = gb.fit(gb.Problem(NonlinearTilt(), made(SWING)), 4, progress=False, profiles=False)
    assert any("C_x is not determined" in text for text in fit.warnings)
    assert fit.cost > 1.5 * fitted().cost


@cache
def dragged():
    """The response of a slider to sines so slow and wide that drag makes it anything but a sine, by simulation."""
    omega = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
    exact = np.array([simulated_velocity(w, 0.3) / 0.3 for w in omega])
    random = np.random.default_rng(0)
    error = 1e-3 * (random.normal(size=omega.size) + 1j * random.normal(size=omega.size))
    return gb.FrequencyResponse(omega, exact * (1 + error), input="theta", output="v")


def slid(harmonics):
    amplitude = gb.modeling.Sine("theta", 0.3, harmonics=harmonics)
    problem = gb.Problem(Slider(), dragged(), gb.SquaredRelativeError(), amplitude=amplitude)
    return gb.fit(problem, [{}], progress=False, profiles=False)


def test_harmonics_that_do_not_suffice_are_told_with_the_change_that_more_bring():
    """A second fit, with as many harmonics as the sentence names, ends elsewhere."""
    few = slid(1)
    (said,) = [text for text in few.warnings if "harmonics" in text]
    found = re.search(
        r"with (\d+) the response changes by up to ([\d.]+) %; use .*harmonics=(\d+)\)", said
    )
    assert found[1] == found[3]
    many = slid(int(found[1]))
    assert abs(many.estimate["C_x"] - few.estimate["C_x"]) > many.standard_error["C_x"]


def test_small_and_large_sines_and_two_operating_points_are_one_fit():
    middle = float(np.radians(5))
    parts = [
        gb.Problem(
            NonlinearTilt(),
            made(SWING / 6, seed=2, omega=OMEGA[::2]),
            amplitude={"theta": np.full(3, SWING / 6)},
        ),
        gb.Problem(
            NonlinearTilt(),
            made(SWING, middle, seed=3, omega=OMEGA[::2]),
            amplitude={"theta": SWING},
            at={"theta": middle},
        ),
    ]
    fit = gb.fit(parts[0] + parts[1], [TRUTH_FREE], progress=False, profiles=False)
    for name in fit.free:
        assert abs(fit.estimate[name] - TRUTH[name]) < 3 * fit.standard_error[name]


def test_a_saved_fit_answers_at_the_amplitude_it_was_tested_with(tmp_path):
    fit = fitted()
    gb.save(fit, tmp_path / "fit.h5")
    loaded = gb.load(tmp_path / "fit.h5")
    assert_allclose(loaded.response(OMEGA).response, fit.parts[0].response, rtol=1e-9)
    linear = gb.frequency_response(NonlinearTilt(), fit.estimate, OMEGA, output="theta")
    assert np.abs(linear.response / fit.parts[0].response - 1).max() > 0.02
    assert fit.parts[0].curve is fit.parts[0].curve is not None  # evaluated once
    ends = fit.parts[0].curve.response[[0, -1]]
    assert_allclose(ends, fit.parts[0].response[[0, -1]], rtol=1e-6)  # for figures: six digits


def test_between_the_frequencies_the_amplitude_is_interpolated():
    sine = gb.modeling.Sine("theta", np.array([0.3, 0.1])).between(
        np.array([4.0, 1.0]), np.array([1.0, 2.0, 4.0, 9.0])
    )
    assert_allclose(sine.amplitude, [0.1, 0.2, 0.3, 0.3])


# --- what is refused


def respond(amplitude, model=None, **options):
    gb.modeling.harmonic_response(
        model or NonlinearTilt(), {}, OMEGA, amplitude=amplitude, **{"output": "theta", **options}
    )


@pytest.mark.parametrize(
    ("amplitude", "sentence"),
    [
        (
            {"speed": 0.1},
            r"NonlinearTilt has no signal for a sine 'speed'; it has u, theta, v, q, rotor",
        ),
        ({"theta": 0.0}, r"amplitude of 'theta' is 0\.0: give a finite number above 0"),
        ({"theta": np.nan}, r"amplitude of 'theta' is nan"),
        ({"theta": "5"}, r"amplitude of 'theta' is"),
        ({"theta": -0.1}, r"amplitude of 'theta' is -0\.1"),
        ({"theta": [0.1, 0.2]}, r"has 2 values for 6 frequencies: give one for each"),
        ({"theta": 0.1, "u": 0.2}, r"amplitude names 'theta', 'u': give the one signal"),
        ({}, r"amplitude names nothing"),
        (0.1, r"amplitude is 0\.1: give \{signal: amplitude\} or a Sine"),
    ],
)
def test_a_wrong_amplitude_is_refused_alike_in_numbers_and_in_a_problem(amplitude, sentence):
    data = gb.FrequencyResponse(OMEGA, np.ones(OMEGA.size), input="u", output="theta")
    for use in (respond, lambda given: gb.Problem(NonlinearTilt(), data, amplitude=given)):
        with pytest.raises((ValueError, TypeError), match=sentence):
            use(amplitude)


def test_a_sine_needs_a_name_and_harmonics():
    for harmonics in (0, 2.5, True, 51):
        with pytest.raises(ValueError, match="whole number from 1 to 50"):
            gb.modeling.Sine("theta", 0.1, harmonics=harmonics)
    with pytest.raises(TypeError, match="the signal of a sine is 3"):
        gb.modeling.Sine(3, 0.1)


def test_a_transfer_function_has_no_amplitude():
    with pytest.raises(ValueError, match=r"Tilt is a transfer function.* omit the amplitude"):
        respond({"theta": 0.1}, Tilt())


def test_a_record_has_no_amplitude():
    record = gb.Record(np.arange(5) / 10, {"u": np.zeros(5), "theta": np.zeros(5)})
    with pytest.raises(ValueError, match="amplitude is for frequency responses"):
        gb.Problem(NonlinearTilt(), record, amplitude={"theta": 0.1})


def test_a_signal_that_the_input_does_not_drive_is_said():
    class Apart(NonlinearTilt):
        states = ("v", "q", "theta", "rotor", "alone")
        outputs = ("theta", "alone")

        def derivative(self, x, u, p):
            return (*super().derivative(x, u, p), -x.alone)

        def output(self, x, u, p):
            return (x.theta, x.alone)

    with pytest.raises(ValueError, match="the input u cannot make 'alone' a sine in Apart"):
        respond({"alone": 0.1}, Apart())


def test_a_motion_that_does_not_exist_is_said_and_prints_nothing(capfd):
    """A speed is never negative, so it is no sine about zero."""

    class Speed(NonlinearTilt):
        outputs = ("theta", "speed")

        def output(self, x, u, p):
            return (x.theta, abs(x.v) + 0.01 * x.v)

    with pytest.raises(
        ValueError,
        match=r"no periodic motion of Speed was found at omega = 1 rad/s in which speed is a sine of",
    ):
        gb.modeling.harmonic_response(Speed(), {}, [1.0], amplitude={"speed": 0.5}, output="theta")
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "")


# --- parts of the method


def test_what_is_given_at_every_frequency():
    class Leaned(Slider):
        states, inputs, outputs = ("v",), ("theta", "wind"), ("v",)

        def derivative(self, x, u, p):
            return (PAPER_G * gb.tan(u.theta) - p.C_x * (x.v - u.wind) * abs(x.v - u.wind),)

    omega, amplitudes = np.array([1.0, 3.0, 2.0]), np.array([0.1, 0.2, 0.3])
    sine = gb.modeling.Sine("theta", amplitudes, harmonics=1)
    at = {"theta": 0.05, "wind": 2.0}
    balance = harmonic_balance.compiled_balance(
        Leaned(), omega, sine, input="theta", output="v", at=at
    )
    given = np.asarray(ca.DM(balance.settings(ca.DM([0.4]))))
    speed = 2.0 + np.sqrt(PAPER_G * np.tan(0.05) / 0.4)
    rows = [[0.4] * 3, [speed] * 3, [0.05] * 3, [2.0] * 3, [1.0] * 3, omega, amplitudes]
    assert_allclose(given, rows, rtol=1e-9)


def test_harmonics_are_enough_where_the_next_number_hardly_changes_the_response():
    omega, values = np.array([0.6]), {"C_x": 0.3}
    tried = {}
    for number in (1, 3, 7, 15):
        sine = gb.modeling.Sine("theta", 0.3, harmonics=number)
        tried[number], used = harmonic_balance.directly_found(Slider(), values, omega, sine)
        assert used == number
    numbers = list(tried)
    enough = next(
        a for a, b in pairwise(numbers) if abs(tried[b] - tried[a])[0] <= 3e-4 * abs(tried[b])[0]
    )
    free = gb.modeling.Sine("theta", 0.3)
    response, number = harmonic_balance.directly_found(Slider(), values, omega, free)
    assert number == enough == 7
    assert_allclose(response, tried[15], rtol=1e-12)  # the more exact of the two that agree
    assert harmonic_balance.directly_found(Slider(), values, omega, free, most=3)[1] == 3
    assert (
        harmonic_balance.directly_found(Slider(), values, omega, gb.modeling.Sine("theta", 1e-6))[1]
        == 1
    )
    small = gb.modeling.Sine("theta", 1e-6)
    assert harmonic_balance.enough_harmonics(Slider(), omega, small).harmonics == 3
    assert (
        harmonic_balance.enough_harmonics(Slider(), omega, gb.modeling.Sine("theta", 0.3)).harmonics
        == 7
    )
    assert (
        harmonic_balance.enough_harmonics(
            Slider(), omega, gb.modeling.Sine("theta", 0.3, harmonics=2)
        ).harmonics
        == 2
    )
