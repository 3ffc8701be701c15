"""Sampled controllers: the declaration, and the shipped one against ArduPilot's rules written down again."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from sampled_sines import amplitude

import greybox as gb
from greybox.modeling.formula_arguments import Names
from greybox.modeling.model import equation
from greybox.models.controller import AttitudeController
from greybox.workflows.experiment.controller import connected, updated


class RateDamper(gb.Controller):
    """Proportional control of the rate."""

    inputs, outputs = ("q",), ("u",)
    K = gb.Parameter(0.1, bounds=(0, 1), unit="s", about="control per rate error")

    def update(self, x, u, p):
        return (), (p.K * (u.reference - u.q),)


def run(controller, theta, q, reference, mixer=0.0):
    """Run a controller on sequences, in numbers, from zero; its outputs and states after each sample."""
    x, outputs, states = (
        Names(dict(zip(controller.states, controller.initial, strict=True))),
        [],
        [],
    )
    for sample in np.broadcast(theta, q, reference, mixer):
        u = Names(
            dict(zip(("theta", "q", "reference", "mixer", "rate"), (*sample, 0.0), strict=True))
        )
        following, given = controller.update(x, u, controller.values)
        x = Names(dict(zip(controller.states, map(float, following), strict=True)))
        outputs.append([float(v) for v in given])
        states.append(dict(x))
    return np.array(outputs), states


def ardupilot(p, h, theta, q, reference):
    """AC_PID's update_all and update_i, without target and error filters; the limit flag is the last output's."""
    error = derivative = integrator = 0.0
    limit, given = False, []
    for angle, rate, setpoint in zip(theta, q, reference, strict=True):
        target = min(max(p["K_theta"] * (setpoint - angle), -p["q_max"]), p["q_max"])
        last, error = error, target - rate
        alpha = h / (h + 1 / p["omega_D"])
        derivative += alpha * ((error - last) / h - derivative)
        if not limit or (integrator > 0 and error < 0) or (integrator < 0 and error > 0):
            integrator = min(max(integrator + error * p["K_I"] * h, -p["I_max"]), p["I_max"])
        out = p["K_P"] * error + integrator + p["K_D"] * derivative
        limit = not -p["u_max"] < out < p["u_max"]
        given.append(min(max(out, -p["u_max"]), p["u_max"]))
    return np.array(given)


@pytest.mark.parametrize("size", [0.02, 0.5, 5.0])  # never, sometimes and mostly at a limit
def test_attitude_controller_is_ardupilots(size):
    random = np.random.default_rng(0)
    theta, q, reference = size * np.cumsum(
        random.normal(0, [[0.05], [0.2], [0.05]], (3, 2000)), axis=1
    )
    controller = AttitudeController({"K_I": 3.0, "I_max": 0.3, "u_max": 0.8})
    expected = ardupilot(controller.values, 1 / 400, theta, q, reference)
    assert_allclose(run(controller, theta, q, reference)[0][:, 0], expected, atol=1e-12)
    share = np.mean(np.abs(expected) == 0.8)
    assert (share == 0) if size == 0.02 else share > 0.1


def test_the_integral_stays_while_the_control_is_at_its_limit_and_shrinks_at_once():
    error = np.r_[np.full(400, 0.5), np.full(1200, 3.0), np.full(400, -0.5)]
    outputs, states = run(AttitudeController({"K_P": 0.6, "K_D": 0.0}), 0.0, -error, 0.0)
    integral = np.array([x["integral"] for x in states])
    assert_allclose(integral[399], 0.135 * 0.5, rtol=1e-9)
    assert np.all(outputs[400:1600, 0] == 1.0)
    assert (
        np.ptp(integral[401:1600]) == 0
    )  # the flag is that of the last sample: one more step, then none
    assert np.all(np.diff(integral[1600:]) < 0)
    unlimited = run(AttitudeController({"K_P": 0.1, "K_D": 0.0}), 0.0, -error, 0.0)[1]
    assert unlimited[1599]["integral"] == 0.5  # its own limit


def test_gains_have_their_meaning_in_continuous_time():
    """At 4000 Hz a slow sine meets K_theta, then K_P + K_I / s + K_D s / (1 + s / ω_D), but for the samples' lag."""
    controller, w = AttitudeController({"K_D": 0.02}, rate=4000.0), 5.0
    time = np.arange(20000) / 4000
    outputs = run(controller, -0.01 * np.sin(w * time), 0.0, 0.0)[0]
    p, s = controller.values, 1j * w
    expected = 0.01 * p.K_theta * (p.K_P + p.K_I / s + p.K_D * s / (1 + s / p.omega_D))
    assert_allclose(amplitude(time, outputs[:, 0], w, settle=1.0), expected, rtol=1e-3)
    assert_allclose(amplitude(time, outputs[:, 1], w, settle=1.0), 0.01 * p.K_theta, rtol=1e-9)


def test_the_shipped_controller_is_declared_like_a_model():
    text = equation(AttitudeController)
    assert "$$" in text
    assert "Source: Frequency Domain" in text
    for parameter in AttitudeController.parameters.values():
        assert np.all(np.isfinite(parameter.bounds))
        assert parameter.unit
        assert len(parameter.about) > 3
    assert {*AttitudeController.units} <= {
        *AttitudeController.inputs,
        *AttitudeController.setpoints,
        "q_reference",
    }


def test_numbers_and_casadi_agree():
    random = np.random.default_rng(1)
    controller = AttitudeController({"u_max": 0.5})
    x = ca.SX.sym("x", 4)
    u = ca.SX.sym("u", 5)
    names = (*controller.inputs, *controller.setpoints)
    compiled = ca.Function(
        "update", [x, u], updated(controller, x, {n: u[k] for k, n in enumerate(names)})
    )
    for _ in range(50):
        state, told = random.normal(0, 0.5, 4), random.normal(0, 1, 5)
        state[3] = random.integers(2)
        numbers = controller.update(
            Names(dict(zip(controller.states, state, strict=True))),
            Names(dict(zip(names, told, strict=True))),
            controller.values,
        )
        for a, b in zip(compiled(state, told), numbers, strict=True):
            assert_allclose(a.full().ravel(), [float(v) for v in b], rtol=1e-12)


def test_what_it_is_told_and_what_it_says():
    controller = AttitudeController(
        {"K_P": 0.2}, rate=200, signals={"theta": "phi"}, initial={"integral": 0.1}
    )
    assert (
        repr(controller) == "AttitudeController({'K_P': 0.2}, rate=200, signals={'theta': 'phi'})"
    )
    assert controller.outside("theta") == "phi"
    assert controller.outside("q") == "q"
    assert controller.initial == (0, 0, 0.1, 0)
    assert (controller.values.K_P, controller.values.K_I) == (0.2, 0.135)
    assert controller.truth["rate"] == 200
    assert AttitudeController().rate == 400  # the class is left alone


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"values": {"K_p": 1.0}},
            "AttitudeController has no parameter 'K_p'; it has K_theta, K_P",
        ),
        ({"values": {"K_P": np.nan}}, "K_P = nan is not a finite number"),
        ({"values": {"K_P": "much"}}, "K_P = 'much' is not a finite number"),
        ({"rate": 0}, "cannot run 0 times per second"),
        ({"signals": {"phi": "theta"}}, "has no signal 'phi'; it has theta, q, reference"),
        ({"initial": {"integrator": 1}}, "has no state 'integrator'; it has error"),
    ],
)
def test_bad_arguments(arguments, sentence):
    with pytest.raises(ValueError, match=sentence):
        AttitudeController(**arguments)


def declare(**body):
    return type("Own", (RateDamper,), body)


@pytest.mark.parametrize(
    ("body", "error", "sentence"),
    [
        ({"outputs": "u"}, ValueError, "Own.outputs = 'u' must be a tuple"),
        (
            {"inputs": ("q", "reference")},
            ValueError,
            "Own has 'reference' both as input and as setpoint",
        ),
        ({"states": ("keys",)}, ValueError, "cannot have a parameter or signal called 'keys'"),
        (
            {"values": gb.Parameter(1.0)},
            ValueError,
            "cannot have a parameter or signal called 'values'",
        ),
        ({"K": 0.2}, TypeError, "Own.K is 0.2 where a Parameter was"),
    ],
)
def test_bad_declarations(body, error, sentence):
    with pytest.raises(error, match=sentence):
        declare(**body)


@pytest.mark.parametrize(
    ("update", "sentence"),
    [
        (
            lambda self, x, u, p: u.q,
            "return two tuples, the next states .none. and the outputs .u.",
        ),
        (lambda self, x, u, p: ((), (u.q, u.q)), "and the outputs .u."),
        (lambda self, x, u, p: ((u.q,), (u.q,)), "the next states .none."),
        (lambda self, x, u, p: ((), (max(u.q, 0),)), "Own.update cannot be compiled"),
        (lambda self, x, u, p: ((), (np.ones(2),)), "Own.update gives a ndarray"),
    ],
)
def test_bad_formulas(update, sentence):
    controller = declare(update=update)()
    with pytest.raises(ValueError, match=sentence):
        updated(controller, ca.SX(0, 1), {n: ca.SX.sym(n) for n in ("q", "reference")})


def other(**signals):
    return RateDamper(signals=signals)


def plant(*states):
    return SimpleNamespace(inputs=("u", "z"), outputs=(), states=states)


@pytest.mark.parametrize(
    ("controllers", "error", "sentence"),
    [
        (
            [RateDamper],
            TypeError,
            "the controller is <class .*: give an instance, as AttitudeController",
        ),
        (
            [RateDamper(), RateDamper(rate=100)],
            ValueError,
            "runs at 100 Hz, RateDamper at 400 Hz: use one rate",
        ),
        (
            other(u="w"),
            ValueError,
            "gives w, but Plant takes u, z: connect them, signals={'u': 'u'}",
        ),
        ([RateDamper(), RateDamper()], ValueError, "two signals are called 'u'"),
        (other(reference="theta"), ValueError, "two signals are called 'theta'"),
        (
            [RateDamper(), other(u="reference")],
            ValueError,
            "takes 'reference' from itself or a later controller",
        ),
        ([RateDamper(), other(u="w", reference="r")], ValueError, "gives w, but Plant takes"),
        (other(u="reference"), ValueError, "gives reference, but Plant takes u, z"),
    ],
)
def test_controllers_that_do_not_fit(controllers, error, sentence):
    with pytest.raises(error, match=sentence):
        connected(controllers, "Plant", plant("theta", "q"))


def test_controllers_in_the_wrong_order():
    class Two(RateDamper):
        outputs = ("u", "w")

        def update(self, x, u, p):
            return (), (u.q, u.q)

    with pytest.raises(ValueError, match="takes 'w' from itself or a later controller"):
        connected([other(reference="w"), Two(signals={"u": "z"})], "Plant", plant())
    pair = [Two(signals={"u": "z"}), other(reference="w")]
    assert len(connected(pair, "Plant", plant())) == 2


def test_a_controller_may_drive_the_next_one_alone():
    cascade = [other(u="rate"), RateDamper(signals={"reference": "rate", "q": "r"})]
    assert len(connected(cascade, "Plant", plant("theta", "q", "r"))) == 2
