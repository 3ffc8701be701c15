"""Equation error: known truths recovered, unmeasured states, delays, gaps, and bad input."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.engine.regression.equation_error import (
    EquationErrorEstimate,
    UsedEquation,
)
from greybox.engine.regression.linear_in_parameters import regressions
from greybox.modeling.realization import dynamics
from greybox.models.controller import AttitudeController
from greybox.models.multirotor import RigidBody, Torques
from greybox.models.rotor import Rotor
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt

TILT = {"a1": -2.0, "a2": 4.0, "a3": 3.0, "a4": 200.0}
WAVES = np.geomspace(0.5, 16, 9)
PHASES = np.random.default_rng(5).uniform(0, 2 * np.pi, 9)


class Slider(gb.StateSpace):
    """A mass on a spring with viscous and Coulomb friction; `d` delays the force."""

    states = ("x", "v")
    inputs = ("F",)
    outputs = ("x",)
    delays = {"F": "d"}
    k = gb.Parameter(1.0, bounds=(0, 100), unit="1/s²", about="stiffness per mass")
    c = gb.Parameter(1.0, bounds=(0, 10), unit="1/s", about="viscous friction per mass")
    mu = gb.Parameter(0.1, bounds=(0, 10), unit="m/s²", about="Coulomb friction per mass")
    b = gb.Parameter(1.0, bounds=(0, 10), unit="1/kg", about="acceleration per force")
    d = gb.Parameter(0.0, bounds=(0, 0.3), unit="s", about="delay of the force", fixed=True)

    def derivative(self, x, u, p):
        return (x.v, -p.k * x.x - p.c * x.v - p.mu * gb.sign(x.v) + p.b * u.F)

    def output(self, x, u, p):
        return (x.x,)


class Integrator(gb.StateSpace):
    """The one regressor is the input, which is exact."""

    states = ("y",)
    b = gb.Parameter(1.0, bounds=(-10, 10))

    def derivative(self, x, u, p):
        return (p.b * u.u,)

    def output(self, x, u, p):
        return (x.y,)


SLIDER = {"k": 9.0, "c": 1.2, "mu": 0.5, "b": 4.0}


def force(t):
    return np.sin(np.multiply.outer(t, WAVES) + PHASES) @ np.ones(9) / 3


def solved(derivative, start, time, **options):
    options = {"rtol": 1e-7, "atol": 1e-9, "max_step": 0.05, **options}
    return solve_ivp(derivative, (time[0], time[-1]), start, t_eval=time, **options).y


@cache
def slider(mu=0.5, delay=0.0, seconds=40.0, step=0.01):
    time = np.arange(round(seconds / step)) * step

    def derivative(t, y):
        friction = mu * np.tanh(y[1] * 1e3)
        return y[1], -9 * y[0] - 1.2 * y[1] - friction + 4 * force(max(t - delay, 0.0))

    x, v = solved(derivative, [0, 0], time)
    return gb.Record(time, {"F": force(time), "x": x, "v": v}, name="slider")


def tilt(model, values, seconds=40.0, step=0.01):
    """Closed loop u = K (reference - state), which keeps the unstable plant near hover."""
    time = np.arange(round(seconds / step)) * step
    p = model.values({**TILT, **values, "T_delay": 0.0})

    def control(t, y):
        return 0.25 * (0.1 * force(t) - y[2]) - 0.035 * y[1] - 0.004 * y[0]

    def derivative(t, y):
        v, q, theta, rotor = y
        drag = p.C_x * abs(v) * v - PAPER_G * (np.tan(theta) - theta) if "C_x" in p else p.a5 * v
        acceleration = -p.a1 * theta - p.a2 * q - p.a3 * v + p.a4 * rotor
        return PAPER_G * theta - drag, acceleration, q, (control(t, y) - rotor) / p.T_rotor

    y = solved(derivative, [0, 0, 0, 0], time, method="DOP853", max_step=0.2)
    u = np.array([control(t, column) for t, column in zip(time, y.T, strict=True)])
    return gb.Record(
        time, {"u": u, "v": y[0], "q": y[1], "theta": y[2], "rotor": y[3]}, name="tilt"
    )


@pytest.fixture(scope="module")
def sliding():
    return slider()


@pytest.fixture(scope="module")
def flown():
    return tilt(LinearTilt(), {"a5": 0.3})


def measured(record, names, noise=0.0, seed=0, exact=("u", "F")):
    """Some signals of a record, with white noise relative to their size."""
    random = np.random.default_rng(seed)
    errors = {
        n: 0 if n in exact else noise * np.std(record[n]) * random.normal(size=len(record))
        for n in names
    }
    return gb.Record(record.time, {n: record[n] + errors[n] for n in names}, name=record.name)


def assert_near(result, truth, rel):
    assert {n: result.estimate[n] for n in truth} == pytest.approx(truth, rel=rel)


# --- known truths


@pytest.mark.parametrize(
    ("names", "noise", "rel"),
    [(("u", "v", "q", "theta", "rotor"), 0.0, 2e-3), (("u", "v", "theta", "rotor"), 0.01, 0.02)],
)
def test_linear_tilt(flown, names, noise, rel):
    record = measured(flown, names, noise)
    result = gb.regression.equation_error(LinearTilt(), record, fixed={"T_delay": 0.0}, free=["a5"])
    assert_near(result, {**TILT, "a5": 0.3}, rel)
    assert all(e.r_squared > 0.99 for e in result.equations)


def test_a_virtual_flight_under_a_sampled_controller():
    time = np.arange(12 * 200) / 200
    noise = {"theta": 0.001, "q": 0.01, "v": 0.02}
    flight = {
        "controller": AttitudeController(rate=200),
        "excitation": {"reference": 0.15 * force(time)},
    }
    record = gb.virtual_flight(
        LinearTilt(), {**TILT, "a5": 0.3, "T_delay": 0.0042}, noise=noise, **flight
    )
    lag = {"T_rotor": LinearTilt.parameters["T_rotor"].start, "T_delay": 0.0042}
    # A state that is not measured, but that known signals drive, is simulated.
    rotor = gb.simulate(Rotor(), lag | {"K_Omega": 1.0}, record)["Omega"]
    found = gb.regression.equation_error(
        LinearTilt(), record.with_signals(rotor=rotor), fixed={"T_delay": 0.0042}
    )
    assert_near(found, TILT, 0.04)


@pytest.mark.parametrize("delay", [0.0, 0.031])
def test_a_held_control_on_slow_samples(delay):
    """Exact in the mean of the held input, delayed by a fraction of a step too; interpolation is 25 ms late."""
    time = np.arange(800) / 20
    flown = gb.virtual_flight(
        Slider(),
        {**SLIDER, "mu": 0.0, "d": delay},
        {"F": np.round(force(time), 1)},
        rate=20.0,
        noise={"v": 0.0},
    )
    known = {"mu": 0.0, "d": delay}
    found = gb.regression.equation_error(Slider(), flown, fixed=known)
    assert_near(found, {"k": 9.0, "c": 1.2, "b": 4.0}, 0.01)
    assert found.inputs == {"F": "held until the next sample, as the record says"}
    interpolated = gb.regression.equation_error(Slider(), flown, fixed=known, inputs="linear")
    later = gb.regression.equation_error(
        Slider(), flown, fixed=known | {"d": delay + 0.025}, inputs="linear"
    )
    assert later.equations[0].residual < 0.5 * interpolated.equations[0].residual


def test_what_the_record_does_not_say_is_printed_as_an_assumption():
    record = measured(slider(delay=0.083), ("F", "x", "v"), 1e-3)
    found = gb.regression.equation_error(Slider(), record, fixed={"d": 0.083})
    assert "as assumed without a hold; if wrong, delays change by half a step, 5 ms" in str(found)


def test_a_log_of_every_fourth_control_acts_half_a_loop_later():
    fast = np.arange(40 * 200) / 200
    flown = gb.virtual_flight(
        Slider(), {**SLIDER, "mu": 0.0, "d": 0.03}, {"F": force(fast)}, rate=200.0
    )
    rows = np.arange(0, len(flown), 4)
    thinned = replace(flown.rows(rows), hold={**flown.hold, "F": 1 / 200})
    known = {"mu": 0.0, "d": 0.03}
    found = gb.regression.equation_error(Slider(), thinned, fixed=known)
    assert_near(found, {"k": 9.0, "c": 1.2, "b": 4.0}, 2e-3)
    early = replace(thinned, hold={"F": 0.0})
    at_once = gb.regression.equation_error(Slider(), early, fixed=known)
    assert found.equations[0].residual < 0.5 * at_once.equations[0].residual


def test_nonlinear_tilt():
    record = measured(tilt(NonlinearTilt(), {"C_x": 0.08}), ("u", "v", "theta", "rotor"), 0.01)
    result = gb.regression.equation_error(NonlinearTilt(), record, fixed={"T_delay": 0.0})
    assert_near(result, {**TILT, "C_x": 0.08}, 0.02)


def test_a_parameter_that_does_not_enter_linearly_is_held_at_its_start_and_named(flown):
    record = measured(flown, ("u", "v", "theta", "rotor"), 1e-3)
    result = gb.regression.equation_error(
        LinearTilt(), record, fixed={"T_delay": 0.0}, free=["a5", "T_rotor"]
    )
    start = LinearTilt.parameters["T_rotor"].start
    fixed = gb.regression.equation_error(
        LinearTilt(), record, fixed={"T_delay": 0.0, "T_rotor": start}, free=["a5"]
    )
    assert result.missing == {"T_rotor": f"it does not enter linearly: held at its start {start:g}"}
    assert result.estimate == pytest.approx(fixed.estimate, rel=1e-6)


@pytest.mark.parametrize(("noise", "rel"), [(0.0, 0.02), (0.01, 0.06)])
def test_coulomb_friction(sliding, noise, rel):
    assert_near(
        gb.regression.equation_error(Slider(), measured(sliding, ("F", "x", "v"), noise)),
        SLIDER,
        rel,
    )


def test_a_known_delay():
    record = measured(slider(delay=0.083), ("F", "x", "v"), 1e-3)
    assert_near(gb.regression.equation_error(Slider(), record, fixed={"d": 0.083}), SLIDER, 0.02)


def test_a_transfer_function_with_one_pole_and_a_delay():
    time = np.arange(4000) * 0.005
    (speed,) = solved(lambda t, y: (900 * force(max(t - 0.02, 0.0)) - y) / 0.08, [0.0], time)
    record = gb.Record(time, {"u": force(time), "Omega": speed})
    known = {"T_rotor": 0.08, "T_delay": 0.02}
    found = gb.regression.equation_error(Rotor(), record, fixed=known)
    assert_near(found, {"K_Omega": 900.0}, 0.01)


def test_a_static_model():
    random = np.random.default_rng(0)
    speeds = {f"Omega_{k}": random.uniform(300, 900, 500) for k in (1, 2, 3, 4)}
    one, two, three, four = (w**2 for w in speeds.values())
    torques = {
        "tau_phi": 3e-6 * (two + three - one - four) + 0.1 * random.normal(size=500),
        "tau_psi": 4e-7 * (one + two - three - four),
    }
    result = gb.regression.equation_error(
        Torques(), gb.Record(np.arange(500) * 0.01, {**speeds, **torques})
    )
    assert_near(result, {"K_tau": 3e-6, "K_psi": 4e-7}, 0.02)
    assert [e.left for e in result.equations] == ["tau_phi", "tau_psi"]
    assert "all" in str(result)


# --- what the record lacks


def test_nothing_crosses_gaps_and_missing_samples(sliding):
    signals = dict(measured(sliding, ("F", "x", "v"), 1e-3).signals)
    signals = {n: v.copy() for n, v in signals.items()}
    signals["x"][np.random.default_rng(0).choice(4000, 40, replace=False)] = np.nan
    signals["v"][1500:1600] = np.nan
    time = sliding.time + np.where(sliding.time >= 25, 12.3, 0.0)
    rows = (sliding.time < 22) | (sliding.time >= 25)
    result = gb.regression.equation_error(
        Slider(), gb.Record(time, signals).rows(np.flatnonzero(rows))
    )
    assert_near(result, SLIDER, 0.03)
    assert result.equations[0].rows < 3600


def test_a_state_follows_from_a_derivative_where_no_free_parameter_is_in_the_way(flown):
    record = measured(flown, ("u", "v", "q", "rotor"), 1e-3)
    result = gb.regression.equation_error(LinearTilt(), record, fixed={"T_delay": 0.0, "a5": 0.3})
    assert_near(result, TILT, 0.02)
    assert "theta from the derivative of v" in result.states
    with pytest.raises(
        ValueError,
        match=r"no equation .* \(v' \(it needs theta, not known\); q' \(it needs theta, not",
    ):
        gb.regression.equation_error(LinearTilt(), record, free="a5")


def test_equations_with_unknown_states_are_left_out(flown):
    result = gb.regression.equation_error(
        NonlinearTilt(), measured(flown, ("u", "v", "theta", "rotor")), fixed={"T_rotor": 0.048}
    )
    assert set(result.estimate) == {*TILT, "C_x"}
    with pytest.raises(ValueError, match=r"can be used \(.*q' \(it needs v, not known\)"):
        gb.regression.equation_error(LinearTilt(), measured(flown, ("u", "theta", "q", "rotor")))


def test_what_is_not_determined_is_said():
    class Doubled(Slider):
        b2 = gb.Parameter(1.0, bounds=(0, 10))
        idle = gb.Parameter(1.0, bounds=(0, 10))

        def derivative(self, x, u, p):
            v, a = super().derivative(x, u, p)
            return v, a + p.b2 * u.F + p.idle * (x.v - x.v)

    result = gb.regression.equation_error(Doubled(), slider(seconds=20.0))
    assert set(result.missing) == {"b", "b2", "idle"}
    assert "only a combination of b, b2 is determined" in result.missing["b"]
    assert result.estimate["k"] == pytest.approx(9.0, rel=0.02)


def test_bounds_hold(sliding):
    class Bounded(Slider):
        k = gb.Parameter(5.0, bounds=(0, 8), unit="1/s²")

    result = gb.regression.equation_error(Bounded(), sliding)
    assert result.estimate["k"] == 8.0
    assert result.at_bound == ("k",)
    assert "AT BOUND" in str(result)


def test_a_parameter_inside_a_sign_is_not_linear():
    class Threshold(Slider):
        v0 = gb.Parameter(0.1, bounds=(-1, 1), unit="m/s")

        def derivative(self, x, u, p):
            return x.v, -p.k * x.x - p.mu * gb.sign(x.v - p.v0) + p.b * u.F

    form = dynamics(Threshold())
    found = regressions(form, ["F", "x", "v"], {"c": 1.0, "d": 0.0})
    assert (set(found.linear), found.nonlinear) == ({"k", "mu", "b"}, ("v0",))
    hidden = regressions(form, ["F"], {"c": 1.0, "d": 0.0})
    assert not hidden.equations  # friction is not linear, so that the states cannot be solved


def test_parameters_are_sorted_into_linear_and_nonlinear():
    def sort(model, signals, **fixed):
        form = dynamics(model)
        found = regressions(form, signals, fixed)
        return set(found.linear), set(found.nonlinear)

    assert sort(Slider(), ["F", "x", "v"]) == ({"k", "c", "mu", "b"}, {"d"})
    assert sort(LinearTilt(), ["u", "theta", "v", "rotor"], T_delay=0.0) == (
        {*TILT, "a5"},
        {"T_rotor"},
    )
    body = RigidBody()
    assert sort(body, [*body.states, *body.inputs]) == (set(), {"J_x", "J_y", "J_z"})


# --- as a start


def test_the_estimate_is_a_start(flown):
    result = gb.regression.equation_error(
        LinearTilt(), measured(flown, ("u", "v", "theta", "rotor"), 0.01), fixed={"T_delay": 0.0}
    )
    truth = {**TILT, "a5": 0.16, "T_delay": 0.0}
    data = gb.frequency_response(
        LinearTilt(), truth, np.geomspace(1, 20, 12), input="u", output="theta"
    )
    fit = gb.fit(gb.Problem(LinearTilt(), data, fixed={"T_delay": 0.0}), starts=[result.estimate])
    assert fit.converged


def test_it_prints_itself(flown):
    text = str(
        gb.regression.equation_error(
            LinearTilt(),
            measured(flown, ("u", "v", "theta", "rotor"), 0.01),
            fixed={"T_delay": 0.0},
        )
    )
    assert text.startswith("LinearTilt, tilt: equation error\n")
    for part in (
        "a4",
        "1/(m·s)",
        "q' ",
        "state q from the derivative of theta",
        "state rotor from the signal rotor",
    ):
        assert part in text


# --- bad input


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        (
            {"F": None},
            {},
            "Slider needs the input 'F', which the record does not have: rename one of its signals, x, v",
        ),
        (
            {"F": 0.3, "x": 0.1, "v": 0.0},
            {},
            "the record determines none of k, c, mu, b: the signals",
        ),
        (
            {"x": None, "v": None},
            {},
            r"no equation of Slider can be used \(v' \(the state v is not known\)\)",
        ),
        ({"v": 0.0, "x": 0.0}, {"fixed": {"b": 4.0}}, "the record determines none of k, c, mu"),
        ({}, {"fixed": SLIDER}, "Slider has no free parameter here"),
        ({}, {"fixed": {"nu": 1}}, "Slider has no parameter 'nu'"),
        ({}, {"free": ["nu"]}, "Slider has no parameter 'nu'"),
        ({}, {"fixed": {"d": 0.1}, "free": "d"}, "'d' is both fixed and free"),
        (
            {},
            {"fixed": {"d": 7.0}},
            r"fixed gives 'd' the value 7 outside its bounds \(0, 0\.3\)",
        ),
        ({}, {"inputs": "cubic"}, "inputs 'cubic' is not known: use 'linear' or 'held'"),
    ],
)
def test_bad_input(sliding, change, options, sentence):
    signals = {
        n: np.full(len(sliding), change[n]) if n in change else v
        for n, v in sliding.signals.items()
        if change.get(n, 0.0) is not None
    }
    with pytest.raises(ValueError, match=sentence):
        gb.regression.equation_error(Slider(), gb.Record(sliding.time, signals), **options)


def test_bad_records(sliding):
    uneven = sliding.time + 0.3 * 0.01 * np.sin(np.arange(len(sliding)))
    with pytest.raises(ValueError, match="not uniformly sampled"):
        gb.regression.equation_error(Slider(), gb.Record(uneven, sliding.signals))
    with pytest.raises(ValueError, match="no stretch of 12 samples"):
        gb.regression.equation_error(Slider(), sliding.rows(np.arange(5)))
    with pytest.raises(TypeError, match="give an instance such as"):
        gb.regression.equation_error(Slider, sliding)
    with pytest.raises(TypeError, match="give a Record"):
        gb.regression.equation_error(Slider(), sliding.signals)


def test_a_transfer_function_of_higher_order_is_refused(flown):
    with pytest.raises(
        ValueError, match=r"Tilt needs derivatives of 'theta' .* declare it as a StateSpace"
    ):
        gb.regression.equation_error(Tilt(), flown)


# --- constant errors of sensors, and inputs that do not move


class Short(gb.StateSpace):
    """The short period of an airplane at an airspeed that is an input, with a measured acceleration."""

    states = ("alpha", "q")
    inputs = ("delta", "V")
    outputs = ("alpha", "q", "az")
    Z0 = gb.Parameter(0.0, bounds=(-5, 5), unit="m/s²")
    Za = gb.Parameter(-1.0, bounds=(-10, 10), unit="1/s")
    Ma = gb.Parameter(-5.0, bounds=(-50, 50), unit="1/s²")
    Mq = gb.Parameter(-1.0, bounds=(-10, 10), unit="1/s")
    Md = gb.Parameter(-5.0, bounds=(-50, 50), unit="1/s²")

    def derivative(self, x, u, p):
        return (
            x.q + (p.Z0 + p.Za * u.V * x.alpha) / u.V,
            p.Ma * x.alpha + p.Mq * x.q + p.Md * u.delta,
        )

    def output(self, x, u, p):
        return (x.alpha, x.q, p.Z0 + p.Za * u.V * x.alpha)


SHORT = {"Z0": -0.8, "Za": -1.4, "Ma": -7.0, "Mq": -2.0, "Md": -11.0}


def short_period():
    """20 s with steps of the elevator at a constant airspeed of 60 m/s."""
    time = np.arange(1000) / 50
    delta = 0.03 * np.sign(np.sin(1.3 * time)) + 0.02 * np.sin(4 * time)
    excitation = {"delta": delta, "V": np.full(time.size, 60.0)}
    noise = {"alpha": 2e-4, "q": 5e-4, "az": 0.01}
    return gb.virtual_flight(Short(), SHORT, excitation, rate=50.0, noise=noise)


def test_a_known_constant_input_is_no_fault():
    """The airspeed never moves, and every parameter is determined all the same."""
    found = gb.regression.equation_error(Short(), short_period())
    assert_near(found, SHORT, 0.01)
    assert found.warnings == ()


def test_a_free_motion_needs_no_input_that_moves():
    flown = gb.virtual_flight(
        Short(),
        SHORT,
        {"delta": np.full(500, 0.02), "V": np.full(500, 60.0)},
        rate=50.0,
        initial={"alpha": 0.1},
    )
    found = gb.regression.equation_error(Short(), flown)
    assert_near(found, {name: SHORT[name] for name in ("Za", "Ma", "Mq")}, 0.02)


class StaticSum(gb.StateSpace):
    """Two gains of one input, which only their sum tells, beside an offset."""

    states, inputs, outputs = (), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(-10, 10))
    b = gb.Parameter(1.0, bounds=(-10, 10))
    c = gb.Parameter(0.0, bounds=(-10, 10))

    def output(self, x, u, p):
        return ((p.a + p.b) * u.u + p.c,)


def test_gains_that_only_their_sum_tells_count_as_one():
    random = np.random.default_rng(0)
    u = random.normal(size=14)
    record = gb.Record(
        np.arange(14) * 0.1, {"u": u, "y": 2 * u + 0.3 + 0.1 * random.normal(size=14)}
    )
    found = gb.regression.equation_error(StaticSum(), record)
    held = gb.regression.equation_error(StaticSum(), record, fixed={"b": 0.5})
    assert set(found.missing) == {"a", "b"}
    assert found.estimate["c"] == pytest.approx(held.estimate["c"])


def test_every_row_of_what_is_printed():
    parameters = {
        "k": gb.Parameter(1.0, bounds=(0, 100), unit="1/s²", about="stiffness per mass"),
        "c": gb.Parameter(1.0, bounds=(0, 10), unit="1/s", about="viscous friction"),
    }
    found = EquationErrorEstimate(
        name="Slider, ground",
        estimate={"k": 12.345678, "c": 10.0},
        equations=(
            UsedEquation("v'", ("k", "c"), 0.98765, 1234, 3.21098, 0.045678),
            UsedEquation("az", ("k",), 0.5, 7, np.inf, 1.5),
        ),
        left_out=("w' (it needs w, not known)",),
        missing={"m": "it has no effect in these data"},
        at_bound=("c",),
        states=("v from the derivative of x",),
        parameters=parameters,
        warnings=("c ended at its bound.",),
        inputs={"F": "held until the next sample"},
    )
    lines = str(found).splitlines()
    (row,) = [line.split() for line in lines if line.split()[:1] == ["c"]]
    assert row == ["c", "10", "1/s", "AT", "BOUND", "viscous", "friction"]
    assert "  not estimated: m, it has no effect in these data" in lines
    assert "  v'        k c  0.9877  1234      3.21    0.0457" in lines
    assert "  az        k    0.5000     7       all       1.5" in lines
    assert "  left out: w' (it needs w, not known)" in lines
    assert "  state v from the derivative of x" in lines
    assert "  input F held until the next sample" in lines
    assert "  warning: c ended at its bound." in lines


def sampled(count=14, **more):
    random = np.random.default_rng(0)
    u = random.normal(size=count)
    signals = {"u": u, "y": 2 * u + 0.3 + 0.1 * random.normal(size=count)}
    return gb.Record(np.arange(count) * 0.1, signals | more)


@pytest.mark.parametrize("value", [-10, 10, np.float64(3.0)])
def test_what_is_fixed_may_lie_at_its_bound(value):
    found = gb.regression.equation_error(StaticSum(), sampled(), fixed={"b": value})
    u, y = sampled()["u"], sampled()["y"]
    gain, offset = np.polyfit(u, y - value * u, 1)
    if abs(gain) < 10:
        assert found.estimate == pytest.approx({"a": gain, "c": offset})
    assert found.equations[0].band == np.inf  # nothing was smoothed


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        ({"fixed": {"b": 10.1}}, ValueError, r"outside its bounds \(-10, 10\)"),
        ({"fixed": {"b": "1"}}, ValueError, r"fixed gives 'b' the value '1'"),
        ({"fixed": ["b"]}, TypeError, r"fixed is \['b'\]: give \{name: value\}"),
    ],
)
def test_options_that_are_refused(options, error, sentence):
    with pytest.raises(error, match=sentence):
        gb.regression.equation_error(StaticSum(), sampled(), **options)
