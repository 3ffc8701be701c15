"""Virtual flights against exact solutions, independent loops and statistics known in advance."""

import math

import numpy as np
import pytest
from declared_models import TILT, Lag
from numpy.testing import assert_allclose
from sampled_sines import amplitude
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import greybox as gb
from greybox.data.intersample import Intersample, intersample
from greybox.modeling.formula_arguments import Names
from greybox.models.controller import AttitudeController
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt
from greybox.models.yaw import YawAngle

TRUTH = TILT | {"T_rotor": 0.05, "T_delay": 0.0042}
PITCH = AttitudeController()
HOLD = 0.5 / PITCH.rate  # s, what holding the control adds to the delay


class RateDamper(gb.Controller):
    """Proportional control of one measured signal."""

    inputs, outputs = ("q",), ("u",)
    K = gb.Parameter(0.1, bounds=(-10, 10), about="control per error")

    def update(self, x, u, p):
        return (), (p.K * (u.reference - u.q),)


class Drift(gb.StateSpace):
    """Two integrators, a decay, and a static path, each with an input of its own delay."""

    states = ("a", "b", "c")
    inputs = ("u", "w")
    outputs = ("y", "c")
    delays = {"u": "T_u", "w": "T_w"}
    T_u = gb.Parameter(0.0, bounds=(-1, 1), unit="s", about="delay of u")
    T_w = gb.Parameter(0.0, bounds=(0, 1), unit="s", about="delay of w")
    decay = gb.Parameter(2.0, bounds=(0, 10), unit="1/s", about="decay of c")

    def derivative(self, x, u, p):
        return (u.u + 2 * u.w, x.a, -p.decay * x.c)

    def output(self, x, u, p):
        return (x.a + 3 * u.w, x.c)


def sines(omega=(5.34,), degrees=3.0, rate=400.0, **options):
    return gb.experiment.sine_schedule(omega, math.radians(degrees), rate=rate, **options)


def steps(count=2000):
    """A setpoint in rad that stays away from all limits."""
    t = np.arange(count) / 400
    return {"reference": 0.03 * np.sign(np.sin(2 * t)) + 0.01 * np.sin(9 * t)}


# --- against exact solutions


def exact_loop(values, setpoint, controller):
    """The loop of `LinearTilt` and the linear controller: exact discretization by matrix exponentials."""
    p, gains, h = LinearTilt().values(values), controller.values, 1 / controller.rate
    A = np.array(
        [
            [-p.a5, 0, PAPER_G, 0],
            [-p.a3, -p.a2, -p.a1, p.a4],
            [0, 1, 0, 0],
            [0, 0, 0, -1 / p.T_rotor],
        ],
        dtype=float,
    )
    B = np.array([[0], [0], [0], [1 / p.T_rotor]])

    def discretized(span):
        M = expm(np.block([[A, B], [np.zeros((1, 5))]]) * span)
        return M[:4, :4], M[:4, 4]

    whole = (
        round(p.T_delay / h)
        if abs(p.T_delay / h - round(p.T_delay / h)) < 1e-9
        else math.floor(p.T_delay / h)
    )
    part = max(p.T_delay - whole * h, 0.0)
    (first, from_old), (second, from_new) = discretized(part), discretized(h - part)
    alpha = gains.omega_D * h / (1 + gains.omega_D * h)
    x, controls, log = np.zeros(4), [0.0] * (whole + 1), []
    error = derivative = integral = 0.0
    for r in setpoint:
        last, error = error, gains.K_theta * (r - x[2]) - x[1]
        derivative += alpha * ((error - last) / h - derivative)
        integral += gains.K_I * h * error
        controls.append(gains.K_P * error + integral + gains.K_D * derivative)
        log.append([*x, controls[-1]])
        x = second @ (first @ x + from_old * controls[-2 - whole]) + from_new * controls[-1 - whole]
    return dict(zip(("v", "q", "theta", "rotor", "u"), np.array(log).T, strict=True))


@pytest.mark.parametrize("delay", [0.0, 0.0010, 0.0025, 0.0042, 0.0075, 0.0249])
def test_the_closed_loop_is_the_exactly_discretized_one(delay):
    values, setpoint = TRUTH | {"T_delay": delay}, steps()
    flown = gb.virtual_flight(
        LinearTilt(), values, controller=PITCH, excitation=setpoint, noise={"rotor": 0.0, "q": 0.0}
    )
    expected = exact_loop(values, setpoint["reference"], PITCH)
    assert np.abs(expected["u"]).max() < 0.5  # no limit is met
    for name, exact in expected.items():
        assert_allclose(flown[name], exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("delay", "rate"), [(0.0137, 100.0), (0.02, 100.0), (0.0, 50.0), (0.31, 20.0)]
)
def test_a_step_through_lag_and_delay(delay, rate):
    class Late(Lag):
        tau = gb.Parameter(0.0, bounds=(0, 1), unit="s")

        def response(self, s, p):
            return super().response(s, p) * gb.exp(-s * p.tau)

    values = {"K": 3.0, "T": 0.2, "tau": delay}
    flown = gb.virtual_flight(Late(), values, excitation={"u": np.ones(100)}, rate=rate)
    expected = 3 * -np.expm1(-np.maximum(flown.time - delay, 0) / 0.2)
    assert_allclose(flown["y"], expected, atol=3e-7)
    assert_allclose(flown.time, np.arange(100) / rate)


def test_every_input_has_its_own_delay_and_the_sample_sees_what_is_in_effect():
    """Steps of u and w; ramps and parabolas follow to rounding errors."""
    values = {"T_u": 0.013, "T_w": 0.0375}
    flown = gb.virtual_flight(
        Drift(),
        values,
        excitation={"u": np.ones(50), "w": np.full(50, 2.0)},
        rate=100,
        noise={"b": 0},
    )
    u, w = (np.maximum(flown.time - d, 0) for d in values.values())
    assert_allclose(flown["y"], u + 4 * w + 6 * (w > 0), atol=1e-12)
    assert_allclose(flown["b"], u**2 / 2 + 2 * w**2, atol=1e-12)
    undelayed = gb.virtual_flight(Drift(), {}, excitation={"w": np.ones(5)}, rate=10)
    assert_allclose(undelayed["y"], 3 + 2 * undelayed.time)


@pytest.mark.parametrize("lag", [1e-3, 3e-3])
def test_a_fast_mode_gets_short_steps(lag):
    held = np.random.default_rng(0).normal(size=200)
    flown = gb.virtual_flight(Lag(), {"K": 1.0, "T": lag}, excitation={"u": held}, rate=100)
    y, expected = 0.0, []
    for u in held:
        expected.append(y)
        y = u + (y - u) * math.exp(-0.01 / lag)
    assert_allclose(flown["y"], expected, atol=1e-6)


def test_a_mode_that_becomes_fast_on_the_way_is_noticed():
    class Cubic(gb.StateSpace):
        """No stiffness at rest, 3000 1/s at x = 10: six steps of 100 Hz would not even be stable."""

        states, outputs = ("x",), ("x",)
        k = gb.Parameter(10.0, bounds=(0, 100))

        def derivative(self, x, u, p):
            return (u.u - p.k * x.x**3,)

        def output(self, x, u, p):
            return (x.x,)

    flown = gb.virtual_flight(Cubic(), {}, excitation={"u": np.full(40, 1e4)}, rate=100)
    exact = solve_ivp(
        lambda t, x: 1e4 - 10 * x**3,
        (0, 0.39),
        [0.0],
        "LSODA",
        t_eval=flown.time,
        rtol=1e-11,
        atol=1e-11,
    )
    assert_allclose(flown["x"], exact.y[0], atol=1e-5)


def test_a_nonlinear_flight_is_that_of_a_reference_integrator():
    """`NonlinearTilt` under the logged controls, which arrive two samples late, by LSODA from jump to jump."""
    values, model = TRUTH | {"T_delay": 0.005}, NonlinearTilt()
    setpoint = {"reference": np.full(800, 0.6)}
    flown = gb.virtual_flight(
        model, values, controller=PITCH, excitation=setpoint, noise={"q": 0, "rotor": 0}
    )
    p, x = model.values(values), np.zeros(4)
    for u in [0.0, 0.0, *flown["u"][:-3]]:
        held = Names({"u": u})
        moved = solve_ivp(
            lambda _, z, u=held: model.derivative(
                Names(dict(zip(model.states, z, strict=True))), u, p
            ),
            (0, 1 / 400),
            x,
            "LSODA",
            rtol=1e-10,
            atol=1e-12,
        )
        x = moved.y[:, -1]
    assert abs(flown["theta"][-1]) > 0.5
    assert_allclose([flown[n][-1] for n in model.states], x, rtol=1e-7, atol=1e-8)


# --- the experiment of the paper


@pytest.mark.parametrize("plant", [LinearTilt(), NonlinearTilt()])
def test_a_sine_test_through_the_loop_measures_the_plant(plant):
    """The plant is unstable in open loop; the sampled control adds half a period of delay, as documented."""
    values = TRUTH | ({"C_x": 1e-3} if plant.label == "NonlinearTilt" else {})
    flown = gb.virtual_flight(
        plant,
        values,
        controller=PITCH,
        excitation=sines([16.01, 5.34]),
        noise={"theta": 2e-4, "q": 2e-3},
        seed=3,
    )
    (segments,) = [gb.logs.find_segments(flown, setpoint="reference")]
    found = gb.spectral.finite_frequency(flown, segments, setpoint="reference")
    at = {n: v for n, v in values.items() if n != "C_x"} | {
        "a5": 0.16 if plant.label == "LinearTilt" else 1e-6
    }
    truth = gb.frequency_response(LinearTilt(), at, found.response.omega, output="theta").response
    assert_allclose(found.response.omega, [5.34, 16.01], rtol=1e-4)
    assert np.all(np.abs(found.response.response / truth - 1) < [0.012, 0.025])
    held = truth * np.exp(-1j * found.response.omega * HOLD)
    assert np.all(np.abs(found.response.response / held - 1) < 0.002)
    unstable = gb.modeling.linearize(LinearTilt(), at).poles
    assert unstable.real.max() > 0.5


def test_demodulation_by_hand_gives_the_same():
    flown = gb.virtual_flight(LinearTilt(), TRUTH, controller=PITCH, excitation=sines(pause=0.0))
    u, theta = (amplitude(flown.time, flown[n], 5.34, settle=10.0) for n in ("u", "theta"))
    truth = gb.frequency_response(LinearTilt(), TRUTH, [5.34], output="theta").response[0]
    assert abs(theta / u / truth * np.exp(5.34j * HOLD) - 1) < 1e-3


def test_the_truth_is_found_again():
    """A noisy flight of sines, its measured response, and (4.26): the parameters within their errors."""
    omega = [1.5, 3.5, 5.34, 8.0, 12.03, 20.11]
    flown = gb.virtual_flight(
        LinearTilt(),
        TRUTH,
        controller=PITCH,
        excitation=sines(omega),
        noise={"theta": 2e-4, "q": 2e-3},
    )
    found = gb.spectral.finite_frequency(
        flown, gb.logs.find_segments(flown, setpoint="reference"), setpoint="reference"
    )
    fixed = {"T_rotor": 0.05, "T_delay": 0.0042 + HOLD, "a5": 0.16}
    fit = gb.fit(gb.Problem(Tilt(), found.response, fixed=fixed), starts=8, seed=0, progress=False)
    for name, value in TILT.items():
        assert abs(fit.estimate[name] - value) < max(
            4 * fit.standard_error[name], 0.002 * abs(value)
        )


def test_a_sweep_at_the_mixer_and_behind_the_controller():
    """Added before the limit and behind it, the loop sees the same while no limit is met."""
    sweep = gb.experiment.sweep(3.0, 20.0, 20, 400, amplitude=0.02, signal="mixer")
    mixed = gb.virtual_flight(LinearTilt(), TRUTH, controller=PITCH, excitation=sweep)
    behind = gb.virtual_flight(
        LinearTilt(), TRUTH, controller=PITCH, excitation={"u": sweep["mixer"]}
    )
    assert_allclose(mixed["u"], behind["u"], atol=1e-12)
    assert_allclose(mixed["theta"], behind["theta"], atol=1e-12)
    assert_allclose(behind["u_excitation"], sweep["mixer"])
    assert np.abs(mixed["u"] - sweep["mixer"]).max() > 1e-3
    limited = AttitudeController({"u_max": 0.008})
    mixed = gb.virtual_flight(LinearTilt(), TRUTH, controller=limited, excitation=sweep)
    behind = gb.virtual_flight(
        LinearTilt(), TRUTH, controller=limited, excitation={"u": sweep["mixer"]}
    )
    assert np.abs(mixed["u"]).max() == 0.008 < np.abs(behind["u"]).max()


def test_a_multisine_on_two_axes_is_two_flights():
    class TwoAxes(gb.StateSpace):
        """Pitch and roll that do not know of each other."""

        states = ("theta", "q", "phi", "p")
        inputs, outputs = ("u_theta", "u_phi"), ("theta", "phi")

        def derivative(self, x, u, p):
            return (x.q, 200 * u.u_theta, x.p, 300 * u.u_phi)

        def output(self, x, u, p):
            return (x.theta, x.phi)

    pitch = AttitudeController(signals={"u": "u_theta"})
    wires = {
        "theta": "phi",
        "q": "p",
        "u": "u_phi",
        "reference": "roll",
        "q_reference": "p_reference",
    }
    roll = AttitudeController({"K_P": 0.1}, signals=wires)
    made = gb.experiment.multisine(
        1.0, 20.0, 10.0, 400, amplitude=0.05, signals=("reference", "roll"), unit="rad", periods=2
    )
    both = gb.virtual_flight(TwoAxes(), {}, controller=(pitch, roll), excitation=made)
    alone = gb.virtual_flight(TwoAxes(), {}, controller=roll, excitation={"roll": made["roll"]})
    assert_allclose(both["phi"], alone["phi"], atol=1e-9)
    assert np.ptp(both["theta"]) > 0.05
    assert alone["theta"].any() == 0
    assert {n: both.units[n] for n in ("theta", "phi", "roll", "p_reference", "u_phi")} == {
        "theta": "rad",
        "phi": "rad",
        "roll": "rad",
        "p_reference": "rad/s",
        "u_phi": "",
    }


def test_a_controller_of_the_velocity_flies_the_attitude():
    class Velocity(gb.Controller):
        """Angle setpoint from the velocity error."""

        inputs, setpoints, outputs = ("v",), ("v_reference",), ("reference",)
        K = gb.Parameter(0.08, bounds=(0, 1), unit="rad·s/m", about="angle per velocity error")

        def update(self, x, u, p):
            return (), (p.K * (u.v_reference - u.v),)

    flown = gb.virtual_flight(
        LinearTilt(),
        TRUTH,
        controller=(Velocity(), PITCH),
        excitation={"v_reference": np.full(16000, 3.0), "reference": np.full(16000, 0.01)},
    )
    assert_allclose(flown["reference"], 0.08 * (3 - flown["v"]) + 0.01, rtol=1e-12)
    # steady: g θ = a5 v and, since the angle's error is zero at rest, θ = K (3 - v) + 0.01
    v = PAPER_G * 0.25 / (0.16 + PAPER_G * 0.08)
    assert_allclose(flown["v"][-1], v, rtol=1e-2)


def test_a_transfer_function_is_flown_with_the_derivative_of_its_output():
    wires = {"q": "theta_dot"}
    flown = gb.virtual_flight(
        Tilt(),
        TRUTH | {"a5": 0.16},
        controller=AttitudeController(signals=wires),
        excitation=steps(),
    )
    states = gb.virtual_flight(
        LinearTilt(), TRUTH | {"a5": 0.16}, controller=PITCH, excitation=steps()
    )
    assert_allclose(flown["theta"], states["theta"], atol=1e-7)
    assert_allclose(flown["theta_dot"], states["q"], atol=1e-6)
    yaw = gb.virtual_flight(
        YawAngle(),
        {},
        controller=AttitudeController(signals={"theta": "psi", "q": "psi_dot"}),
        excitation={"reference": np.full(4000, 0.3)},
    )
    assert_allclose(yaw["psi"][-400:], 0.3, rtol=0.02)


def test_forward_flight_begins_at_its_trim():
    point = gb.modeling.linearize(NonlinearTilt(), TRUTH, {"theta": math.radians(5)}).point
    held = AttitudeController(initial={"integral": point["u"]})
    level = {"reference": np.full(4000, math.radians(5))}
    flown = gb.virtual_flight(
        NonlinearTilt(), TRUTH, controller=held, excitation=level, initial=point
    )
    for name in ("theta", "v", "u"):
        assert_allclose(flown[name], point[name], rtol=1e-7)
    alone = gb.virtual_flight(
        NonlinearTilt(), TRUTH, excitation={"u": np.full(20, point["u"])}, rate=400, initial=point
    )
    assert_allclose(alone["v"], point["v"], rtol=1e-9)  # what was commanded before arrives first


@pytest.mark.parametrize(
    "estimate",
    [(-1.28, 1.86, 73.07, 286.6), (-14.61, 2.97, 83.06, 295.5), (-34.01, 3.41, 26.38, 241.9)],
)
def test_the_default_gains_hold_what_the_paper_identified(estimate):
    """(4.27), (4.28), (4.31), with the margins that the controller's docstring states: a pulse dies out."""
    a1, a2, a3_tilde, a4 = estimate
    pulse = {"reference": np.repeat([0.02, 0.0], [400, 7600])}
    for more, later in ((6.0, 0.0), (0.25, 0.0), (1.0, 0.028)):
        values = {
            "a1": a1,
            "a2": a2,
            "a3": a3_tilde / PAPER_G,
            "a4": more * a4,
            "T_delay": 0.0042 + later,
        }
        flown = gb.virtual_flight(LinearTilt(), values, controller=PITCH, excitation=pulse)
        assert np.abs(flown["theta"][-400:]).max() < 0.2 * np.abs(flown["theta"]).max()


# --- limits


def test_saturation_and_anti_windup():
    class WindsUp(AttitudeController):
        """Without the flag."""

        def update(self, x, u, p):
            free = Names({**x, "limited": 0})
            return super().update(free, u, p)

    gains = {"K_I": 3.0, "u_max": 0.02}
    jump = {"reference": np.repeat([0.0, 0.9], [200, 1800])}
    peak = {}
    for kind in (AttitudeController, WindsUp):
        flown = gb.virtual_flight(LinearTilt(), TRUTH, controller=kind(gains), excitation=jump)
        assert np.abs(flown["u"]).max() == 0.02
        assert np.mean(flown["u"][200:300] == 0.02) > 0.5
        peak[kind] = flown["theta"].max()
    assert peak[AttitudeController] < peak[WindsUp] - 0.05
    assert np.all(np.abs(flown["q_reference"]) <= 3.5)


# --- noise


def test_noise_has_its_size_and_is_what_the_controller_reads():
    controller = RateDamper({"K": 0.05})
    options = {"controller": controller, "excitation": {"reference": np.zeros(20000)}}
    noise = {"q": 0.02, "theta": 0.003, "v": 0.1}
    plant, values = LinearTilt(), TRUTH | {"a1": 20.0, "a3": 0.5}
    noisy = gb.virtual_flight(plant, values, noise=noise, seed=4, **options)
    assert_allclose(noisy["u"], -0.05 * noisy["q"], rtol=1e-12)  # the very samples that are logged
    # The same controls through the plant without sensors give the truth.
    true = gb.virtual_flight(
        plant, values, excitation={"u": noisy["u"]}, rate=400, noise={"q": 0.0}
    )
    for name, size in noise.items():
        error = noisy[name] - true[name]
        assert_allclose(error.std(), size, rtol=0.03)  # 6 standard errors at 20000 samples
        assert abs(error.mean()) < 5 * size / 141
        assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.025
    again = gb.virtual_flight(plant, values, noise=noise, seed=4, **options)
    other = gb.virtual_flight(plant, values, noise=noise, seed=5, **options)
    assert again.checksum == noisy.checksum
    assert abs(np.corrcoef(other["q"], noisy["q"])[0, 1]) < 0.5


def test_process_noise_is_white_and_independent_of_the_sensors():
    """A random walk's increments, and a decay's stationary variance σ² / (2 a)."""
    silent = {"excitation": {"u": np.zeros(25000)}, "rate": 100}
    forced = {"process_noise": {"a": 0.3, "c": 0.4}}
    flown = gb.virtual_flight(Drift(), {}, seed=1, **silent, **forced)
    increments = np.diff(flown["y"])
    assert_allclose(increments.std(), 0.3 * 0.1, rtol=0.02)
    assert abs(np.corrcoef(increments[1:], increments[:-1])[0, 1]) < 0.02
    assert_allclose(flown["c"].var(), 0.4**2 / (2 * 2.0), rtol=0.15)
    noisy = gb.virtual_flight(Drift(), {}, seed=1, noise={"c": 0.1}, **silent, **forced)
    assert_allclose(noisy["y"], flown["y"])


def test_an_excitation_slower_than_the_controller_is_interpolated():
    made = sines(rate=100.0)
    flown = gb.virtual_flight(LinearTilt(), TRUTH, controller=PITCH, excitation=made)
    whole = len(flown) // 4 * 4
    assert_allclose(flown["reference"][::4], made["reference"][: whole // 4 + 1], atol=1e-12)
    assert_allclose(
        flown["reference"][2:whole:4],
        (made["reference"][1:] + made["reference"][:-1])[: whole // 4] / 2,
    )


def test_the_record_knows_the_truth():
    made = sines()
    flown = gb.virtual_flight(
        NonlinearTilt(),
        {"a1": -2.0},
        controller=PITCH,
        excitation=made,
        noise={"q": 0.01},
        seed=7,
    )
    assert flown.metadata["values"] == {**NonlinearTilt().values(), "a1": -2.0}
    assert flown.metadata["controllers"][0]["values"]["K_P"] == 0.135
    assert (flown.metadata["seed"], flown.metadata["noise"]) == (7, {"q": 0.01})
    assert flown.metadata["schedule"] == made.schedule
    assert flown.name == "virtual flight of NonlinearTilt"
    assert list(flown.signals) == ["u", "reference", "q_reference", "theta", "v", "q"]
    assert flown.findings == ()


def test_a_thinned_flight_still_says_how_long_its_control_was_held():
    step = {"reference": np.full(400, 0.01)}
    flight = gb.virtual_flight(LinearTilt(), TRUTH, step, controller=AttitudeController(rate=400))
    assert intersample(flight.hold["u"], flight.step).held
    thinned = flight.rows(slice(None, None, 4))
    assert intersample(thinned.hold["u"], thinned.step) == Intersample(False, 0.5 / 400)


# --- what goes wrong


def test_a_flight_that_diverges_says_when_and_what():
    wild = AttitudeController({"K_P": -0.5})
    with pytest.raises(
        ValueError,
        match=r"LinearTilt diverges: the state 'v' is \S+e\+\d+ at \d+\.\d\d s; give a controller",
    ):
        gb.virtual_flight(
            LinearTilt(), TRUTH, controller=wild, excitation={"reference": np.full(20000, 0.1)}
        )
    with pytest.raises(ValueError, match=r"diverges: the state '\w+' is .* s; give a controller"):
        gb.virtual_flight(LinearTilt(), TRUTH, excitation={"u": np.full(4000, 0.1)}, rate=50)
    with pytest.raises(ValueError, match=r"diverges: 'u' is nan at 0\.00 s"):
        gb.virtual_flight(Drift(), {}, controller=Broken(), excitation={"reference": np.zeros(9)})


class Broken(gb.Controller):
    """Divides by zero."""

    inputs, outputs = ("y",), ("u",)

    def update(self, x, u, p):
        return (), (u.y / u.reference,)


def test_a_plant_that_is_not_smooth_says_what_the_integration_misses():
    class Friction(gb.StateSpace):
        """Dry friction."""

        states, outputs = ("v",), ("v",)

        def derivative(self, x, u, p):
            return (u.u - 5 * gb.sign(x.v),)

        def output(self, x, u, p):
            return (x.v,)

    flown = gb.virtual_flight(
        Friction(), {}, excitation={"u": 10 * np.sin(np.arange(50) / 5)}, rate=100
    )
    assert len(flown.findings) == 1
    assert "stiff or not smooth" in flown.findings[0]


@pytest.mark.parametrize(
    ("changed", "error", "sentence"),
    [
        ({"plant": LinearTilt}, TypeError, "is not a model: give an instance"),
        ({"values": {"a9": 1.0}}, ValueError, "LinearTilt has no parameter 'a9'"),
        (
            {"values": {"T_delay": -0.01}},
            ValueError,
            "the delay of 'u' is -0.01 s: give a value of 0 or more",
        ),
        (
            {"controller": AttitudeController},
            TypeError,
            "the controller is <class .*: give an instance",
        ),
        (
            {"controller": AttitudeController(signals={"q": "p"})},
            ValueError,
            "LinearTilt has no 'p' to measure; it has",
        ),
        (
            {"excitation": {"setpoint": np.zeros(9)}},
            ValueError,
            "LinearTilt has no place for 'setpoint'; it has ref",
        ),
        ({"excitation": {}}, ValueError, "the record is empty: give at least one sample"),
        ({"excitation": np.zeros(9)}, TypeError, "the excitation is a ndarray: give an Excitation"),
        (
            {"excitation": {"reference": [0, np.nan]}},
            ValueError,
            "reference is nan at index 1: give finite numbers",
        ),
        (
            {"excitation": {"reference": [0, 1], "rate": [0]}},
            ValueError,
            "time has 2 values but rate has 1",
        ),
        ({"excitation": {"reference": 1.0}}, ValueError, "reference must be one-dimensional"),
        ({"excitation": {"reference": []}}, ValueError, "the record is empty"),
        (
            {"noise": {"w": 1.0}},
            ValueError,
            "LinearTilt has no 'w' to measure; it has theta, v, q, rotor and their",
        ),
        ({"noise": {"q": -1.0}}, ValueError, "noise.'q'. is -1.0: give a number of 0 or more"),
        (
            {"process_noise": {"u": 1.0}},
            ValueError,
            "process_noise has no place for 'u'; it has v, q, theta, rotor",
        ),
        (
            {"initial": {"w": 1.0}},
            ValueError,
            "initial has no place for 'w'; it has v, q, theta, rotor, u",
        ),
        ({"initial": {"v": "big"}}, ValueError, "initial.'v'. is 'big': give a number."),
        ({"seed": -1}, ValueError, "seed is -1: give a whole number"),
        (
            {"controller": None, "excitation": {"u": [0, 1]}},
            ValueError,
            "rate is None, and arrays alone have no sampling rate",
        ),
        (
            {"controller": None, "excitation": {"u": [0, 1]}, "rate": 0},
            ValueError,
            "rate is 0, and arrays alone",
        ),
        (
            {"controller": None, "excitation": sines()},
            ValueError,
            "LinearTilt has no place for 'reference'; it has u",
        ),
    ],
)
def test_bad_input(changed, error, sentence):
    given = {
        "plant": LinearTilt(),
        "controller": PITCH,
        "excitation": {"reference": np.zeros(9)},
    } | changed
    plant = given.pop("plant")
    with pytest.raises(error, match=sentence):
        gb.virtual_flight(plant, given.pop("values", None), **given)
