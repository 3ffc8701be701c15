"""Numbers of closed loops, held against python-control and dense computations on random loops."""

import control
import numpy as np
import pytest
from rate_control import RATE, RateDynamics, RateLoop
from scipy.optimize import brentq

import greybox as gb
from greybox.models.controller import AttitudeController, LinearLaw, control_system


class Measured(RateDynamics):
    """The same with a unit of the rate."""

    units = {"q": "rad/s"}


class Proportional(RateLoop):
    """Without the integral."""

    states = ()

    def update(self, x, u, p):
        return (), (p.K_P * (u.reference - u.q),)


def random_loops(number):
    rng = np.random.default_rng(3)
    for _ in range(number):
        values = {
            "K": rng.uniform(5, 80),
            "a": rng.uniform(-2, 10),
            "T": rng.uniform(0.02, 0.2),
            "tau": rng.integers(0, 5) / RATE,
        }
        gains = {"K_P": rng.uniform(0.05, 0.4), "K_I": rng.uniform(0.2, 1)}
        answer = gb.margins(Measured(), RateLoop(gains), values)
        if answer.is_stable:
            yield answer, in_python_control(values, gains)


def in_python_control(values, gains):
    """The broken loop: plant by zero-order hold, whole samples of delay, controller."""
    denominator = np.polymul([1, values["a"]], [values["T"], 1])
    plant = control.c2d(control.tf([values["K"]], denominator), 1 / RATE)
    delay = control.tf([1], [1, *[0] * round(values["tau"] * RATE)], 1 / RATE)
    law = control.tf([gains["K_P"], gains["K_I"] / RATE - gains["K_P"]], [1, -1], 1 / RATE)
    return plant * delay * law


def first_zero(function, omega):
    """The first zero of a function, to rounding."""
    values = function(omega)
    k = int(np.flatnonzero((values[:-1] < 0) != (values[1:] < 0))[0])
    return brentq(lambda w: float(function(np.array([w]))[0]), *omega[k : k + 2], xtol=1e-13)


def test_numbers_of_the_closed_loop_are_those_of_python_control():
    omega = np.geomspace(0.05, 0.99 * np.pi * RATE, 4000)
    compared = 0
    for answer, loop in random_loops(16):

        def response(w, loop=loop):
            gain = loop(np.exp(1j * w / RATE))
            return gain / (1 + gain)

        def phase(w):
            # The phase unwrapped along a dense grid that the points are added to.
            every = np.union1d(omega, w)
            return np.unwrap(np.angle(response(every)))[np.searchsorted(every, w)]

        expected = {
            "bandwidth": first_zero(lambda w: np.abs(response(w)) - 0.5**0.5, omega[::-1]),
            "-180 deg frequency": first_zero(lambda w: phase(w) + np.pi, omega),
        }
        # The attitude is the integral of the rate.
        reversal = first_zero(lambda w: phase(w) + np.pi / 2, omega)
        level = 10**0.3 * np.abs(response(reversal)) / reversal
        before = omega[omega < reversal][::-1]

        def above(w, level=level):
            return np.abs(response(w)) / w - level

        expected |= {
            "ADS-33 phase bandwidth": first_zero(lambda w: phase(w) + np.pi / 4, omega),
            "ADS-33 gain bandwidth": first_zero(above, before),
            "phase delay": -(phase(2 * reversal) + np.pi / 2) / (2 * reversal),
        }
        for name, value in expected.items():
            assert answer[name].value == pytest.approx(value, rel=1e-7), name
        bandwidths = (expected["ADS-33 phase bandwidth"], expected["ADS-33 gain bandwidth"])
        assert answer["ADS-33 bandwidth"].value == pytest.approx(min(bandwidths), rel=1e-7)
        assert answer["disturbance rejection peak"].value == pytest.approx(
            -20 * np.log10(answer["modulus margin"].value)
        )

        closed = control.feedback(loop, 1)
        frequency, damping, _ = control.damp(closed, doprint=False)
        near = np.argmin(np.abs(frequency - answer["natural frequency"].value))
        assert answer["natural frequency"].value == pytest.approx(frequency[near], rel=1e-6)
        assert answer["damping ratio"].value == pytest.approx(damping[near], abs=1e-6)

        time, steps = control.step_response(closed, T=np.arange(3000) / RATE)
        assert answer["overshoot"].value == pytest.approx(100 * max(steps.max() - 1, 0), abs=1e-6)
        info = control.step_info(steps, T=time, yfinal=1.0)
        assert answer["rise time"].value == pytest.approx(info["RiseTime"], abs=2 / RATE)
        assert answer["settling time"].value == pytest.approx(info["SettlingTime"], abs=1.01 / RATE)
        compared += 1
    assert compared > 8


def test_the_criteria_of_ads_33_need_an_attitude():
    names = [margin.name for margin in gb.margins(RateDynamics(), RateLoop()).margins]
    assert "bandwidth" in names
    assert not any("ADS" in name for name in names)


@pytest.mark.parametrize(("response", "angle"), [("theta", "deg"), ("q", "deg/s")])
def test_the_criteria_of_ads_33_are_the_same_in_degrees_and_in_radians(response, angle):
    class Attitude(gb.StateSpace):
        states, inputs, outputs = ("q", "theta"), ("u",), (response,)

        def derivative(self, x, u, p):
            return (30 * u.u - 4 * x.q, x.q)

        def output(self, x, u, p):
            return (getattr(x, response),)

    class Hold(gb.Controller):
        inputs, outputs, rate = (response,), ("u",), RATE

        def update(self, x, u, p):
            return (), (0.5 * (u.reference - getattr(u, response)),)

    def ads_33(unit):
        plant = type("Attitude", (Attitude,), {"units": {response: unit}})()
        answer = gb.margins(plant, Hold())
        return {m.name: m.value for m in answer.margins if "ADS" in m.name}

    assert len(ads_33(angle)) == 3
    assert ads_33(angle) == pytest.approx(ads_33(angle.replace("deg", "rad")), rel=1e-12)


def test_an_attitude_command_has_the_bandwidth_of_its_phase_and_a_distance_from_a_boundary():
    class Attitude(gb.StateSpace):
        states, inputs, outputs = ("q", "theta"), ("u",), ("theta",)
        units = {"theta": "rad"}
        K = gb.Parameter(30.0)

        def derivative(self, x, u, p):
            return (p.K * u.u - 4 * x.q, x.q)

        def output(self, x, u, p):
            return (x.theta,)

    class Hold(gb.Controller):
        inputs, outputs, rate = ("theta",), ("u",), RATE

        def update(self, x, u, p):
            return (), (0.5 * (u.reference - u.theta),)

    corners = [(0.0, 1.0), (0.1, 3.0)]
    answer = gb.margins(Attitude(), Hold(), boundary=corners)
    assert answer["ADS-33 gain bandwidth"].value != answer["ADS-33 bandwidth"].value
    assert answer["ADS-33 phase bandwidth"].value == answer["ADS-33 bandwidth"].value
    least = np.interp(answer["phase delay"].value, *np.transpose(corners))
    above = answer["ADS-33 bandwidth"].value - least
    assert answer["bandwidth above the boundary"].value == pytest.approx(above)
    beyond = gb.margins(Attitude(), Hold(), boundary=[(0.0, 1.0), (0.001, 1.0)])
    assert beyond["bandwidth above the boundary"].value == -np.inf
    with pytest.raises(ValueError, match="a corner of the boundary"):
        gb.margins(Attitude(), Hold(), boundary=[(0.0, 1.0, 2.0)])
    # A rate whose unit is not declared has none of these numbers, nor has a measured loop.
    with pytest.raises(ValueError, match="boundary needs an angle or its rate, and 'q' has"):
        gb.margins(RateDynamics(), RateLoop(), boundary=corners)
    with pytest.raises(TypeError, match="give no argument but the level"):
        gb.margins(gb.frequency_response(RateDynamics(), {}, [1.0, 2.0]), boundary=corners)


def test_a_linear_law_needs_a_rate():
    for rate in (0, -5, np.nan, "400"):
        with pytest.raises(ValueError, match="times per second: give a rate"):
            LinearLaw(control.tf([1], [1]), rate=rate)
    with pytest.raises(TypeError, match="not measured points"):
        LinearLaw(control.frd([1, 1], [1, 2]), rate=100)
    with pytest.raises(ValueError, match=r"more zeros than poles: add the lag"):
        LinearLaw(control.tf([1, 0], [1]), rate=100)


def test_steps_are_those_of_a_flight_with_a_fraction_of_a_sample_of_delay():
    values = {"K": 40.0, "a": 2.0, "T": 0.05, "tau": 0.023}
    answer = gb.margins(Measured(), RateLoop(), values)
    flight = gb.virtual_flight(
        Measured(), values, {"reference": np.ones(600)}, controller=RateLoop()
    )
    assert answer["overshoot"].value == pytest.approx(100 * (flight["q"].max() - 1), rel=1e-6)


class Resonant(gb.TransferFunction):
    """A rate with a structural mode, which crosses a gain of one twice more."""

    input, output = "u", "q"
    K = gb.Parameter(10.0)
    peak = gb.Parameter(300.0)

    def response(self, s, p):
        return p.K / s + p.peak * s / (s**2 + 0.8 * s + 40.0**2) * 0.01


def test_every_crossing_is_listed_and_the_smallest_decides():
    class Proportional(RateLoop):
        states = ()

        def update(self, x, u, p):
            return (), (0.5 * (u.reference - u.q),)

    answer = gb.margins(Resonant(), Proportional())
    phases = [m for m in answer.margins if m.name.startswith("phase margin ")]
    assert len(phases) == 3
    assert answer["phase margin"].value == min(m.value for m in phases)
    gain = answer.loop.broken_at("u", [m.omega for m in phases])[0]
    assert np.abs(gain) == pytest.approx(np.ones(3), rel=1e-8)


def test_what_tracks_what_can_be_chosen():
    answer = gb.margins(Measured(), RateLoop(), tracking=("reference", "u"))
    assert answer.response == "u"
    with pytest.raises(ValueError, match="the loop has no signal 'theta'"):
        gb.margins(Measured(), RateLoop(), tracking=("reference", "theta"))


def test_a_loop_of_little_gain_rejects_no_disturbance():
    values = {"K": 10.0, "a": 2.0, "T": 0.05, "tau": 0.0}

    def bandwidth(gain_at_rest):
        answer = gb.margins(Measured(), Proportional({"K_P": 0.2 * gain_at_rest}), values)
        return answer["disturbance rejection bandwidth"].value

    # The sensitivity at rest is 1/1.4, above -3 dB, or 1/1.5, below.
    assert bandwidth(0.4) == 0
    plant = control.c2d(control.tf([10.0], [0.05, 1.1, 2]), 1 / RATE)

    def distance(w):
        return np.abs(1 + 0.1 * plant(np.exp(1j * w / RATE))) - np.sqrt(2)

    assert bandwidth(0.5) == pytest.approx(first_zero(distance, np.geomspace(0.05, 10, 50)))


def test_a_step_of_many_samples_is_that_of_its_lag():
    """A loop with one pole at 0.05 rad/s settles after 7800 samples: each keeps 1 - 0.05/100 of the error."""
    lag = -1 / RATE / np.log1p(-0.05 / RATE)
    values = {"K": 0.05, "a": 0.0, "T": 0.001, "tau": 0.0}
    answer = gb.margins(Measured(), Proportional({"K_P": 1.0}), values)
    assert answer["rise time"].value == pytest.approx(lag * np.log(9), abs=0.02)
    assert answer["settling time"].value == pytest.approx(lag * np.log(50), abs=0.02)
    assert answer["overshoot"].value == pytest.approx(0, abs=1e-3)


def test_a_system_of_python_control_and_a_transfer_function_are_controllers():
    class Law(gb.TransferFunction):
        input, output = "e", "u"

        def response(self, s, p):
            return (0.15 * s + 0.3) / s

    stated = gb.margins(Measured(), RateLoop({"K_P": 0.15, "K_I": 0.3}))
    sampled = control.tf([0.15, 0.3 / RATE - 0.15], [1, -1], 1 / RATE)
    law = LinearLaw(sampled, rate=RATE, signals={"y": "q"})
    for name in ("phase margin", "gain margin", "bandwidth", "overshoot"):
        exact = pytest.approx(stated[name].value, rel=1e-9)
        assert gb.margins(Measured(), law)[name].value == exact, name

    # By Tustin's rule, half a sample of the error is integrated at once.
    tustin = RateLoop({"K_P": 0.15 + 0.3 / RATE / 2, "K_I": 0.3})
    expected = gb.margins(Measured(), tustin)["phase margin"].value
    for system in (Law(), control.tf([0.15, 0.3], [1, 0])):
        law = LinearLaw(system, rate=RATE, signals={"y": "q"})
        assert gb.margins(Measured(), law)["phase margin"].value == pytest.approx(expected)
    with pytest.raises(ValueError, match="give rate=100"):
        LinearLaw(sampled, rate=50)
    with pytest.raises(ValueError, match="2 inputs"):
        LinearLaw(control.ss([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]), rate=50)
    with pytest.raises(TypeError, match="a class of your own"):
        LinearLaw({"K_P": 0.1}, rate=50)


def test_python_control_takes_controllers():
    z = np.exp(1j * np.array([0.02, 0.3, 2.0]))
    law = control_system(RateLoop({"K_P": 0.15, "K_I": 0.3}))
    assert (law.input_labels, law.output_labels) == (["q", "reference"], ["u"])
    formula = 0.15 + 0.3 / RATE / (z - 1)
    assert law(z)[0] == pytest.approx(np.array([-formula, formula]))
    angle = LinearLaw(
        control.tf([4.5], [1]), rate=400, signals={"y": "theta", "u": "rate", "reference": "wanted"}
    )
    inner = AttitudeController({"K_theta": 0.0}, rate=400)
    cascade = control_system([angle, inner])
    assert set(cascade.input_labels) == {"theta", "q", "wanted", "reference", "mixer"}
    row = cascade(z)[cascade.output_labels.index("u")]
    gains = dict(zip(cascade.input_labels, row, strict=True))
    assert gains["wanted"] == pytest.approx(-4.5 * gains["q"])


def test_python_control_takes_the_broken_loop():
    answer = gb.margins(Measured(), RateLoop())
    gain, phase, *_ = control.margin(gb.interop.to_control(answer))
    assert phase == pytest.approx(answer["phase margin"].value, rel=1e-3)
    assert 20 * np.log10(gain) == pytest.approx(answer["gain margin"].value, rel=1e-3)
