"""Models in time, held against their frequency responses and against scipy's linear systems."""

import casadi as ca
import numpy as np
import pytest
from declared_models import LagLagDelay
from evaluation import input_output_pairs, random_values, shipped_models
from numpy.testing import assert_allclose
from sample_steps import stepped
from scipy.linalg import expm
from scipy.signal import TransferFunction as ScipyTransferFunction, lsim

import greybox as gb
from greybox.modeling.realization import dynamics
from greybox.models.tilt import PAPER_G, LinearTilt, NonlinearTilt, Tilt

OMEGA = np.geomspace(0.05, 50, 25)
VALUES = {"a1": -2.0, "a2": 4.0, "a3": 3.0, "a4": 200.0, "T_rotor": 0.05, "T_delay": 0.03}


def matrices(system, values):
    """A, B, C, D at rest, by CasADi's derivatives of what was compiled."""
    x, u = ca.SX.sym("x", len(system.states)), ca.SX.sym("u", len(system.inputs))
    f, y = system.derivative(x, u, values), system.output(x, u, values)
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(a, b) for a in (f, y) for b in (x, u)])
    return [
        value.full() for value in slopes(np.zeros(len(system.states)), np.zeros(len(system.inputs)))
    ]


def response(system, values, omega, delayed=True):
    """C (s - A)^-1 B + D with the delays of the inputs, (k, m, omega)."""
    A, B, C, D = matrices(system, values)
    s = 1j * omega[:, None, None]
    found = (
        C @ np.linalg.solve(s * np.eye(len(A)) - A, np.broadcast_to(B, (omega.size, *B.shape))) + D
    )
    delay = system.delay(values).full().ravel()
    return np.moveaxis(found * np.exp(-s * delay * delayed), 0, -1)


class Improper(gb.TransferFunction):
    """A differentiator."""

    T = gb.Parameter(1.0)

    def response(self, s, p):
        return s * p.T + 1


class Gain(gb.TransferFunction):
    """Without states."""

    K = gb.Parameter(2.0)
    d = gb.Parameter(0.1, bounds=(0, 1))

    def response(self, s, p):
        return p.K * gb.exp(-s * p.d)


class LeadLag(gb.TransferFunction):
    """Numerator and denominator of one degree: a direct path beside the state."""

    K = gb.Parameter(2.0)
    T1 = gb.Parameter(0.5)
    T2 = gb.Parameter(0.1)

    def response(self, s, p):
        return p.K * (p.T1 * s + 1) / (p.T2 * s + 1)


class Two(gb.StateSpace):
    """Two inputs of which one is late, two outputs of which one sees an input directly."""

    states = ("a", "b")
    inputs = ("early", "late")
    outputs = ("sum", "b")
    delays = {"late": "d"}
    k = gb.Parameter(3.0)
    d = gb.Parameter(0.2, bounds=(0, 1))

    def derivative(self, x, u, p):
        return (-p.k * x.a + u.late, x.a - x.b + u.early)

    def output(self, x, u, p):
        return (x.a + x.b + 2 * u.late, x.b)


@pytest.mark.parametrize(
    "name", sorted(n for n, m in shipped_models().items() if issubclass(m, gb.TransferFunction))
)
def test_a_realized_transfer_function_has_its_own_frequency_response(name):
    model = shipped_models()[name]()
    random = np.random.default_rng(3)
    system = dynamics(model)
    for _ in range(3):
        values = random_values(model, random)
        wanted = gb.frequency_response(model, values, OMEGA).response
        found = response(system, list(values.values()), OMEGA)[0, 0]
        assert_allclose(found, wanted, rtol=1e-7, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("model", [Tilt(), LagLagDelay(), Gain(), LeadLag()], ids=lambda m: m.label)
@pytest.mark.parametrize("order", [1, 2, 4])
def test_pade_states_give_the_pade_frequency_response(model, order):
    values = list(model.values().values())
    found = response(dynamics(model, order), values, OMEGA)[0, 0]
    assert_allclose(
        found, gb.frequency_response(model, {}, OMEGA, delay=f"pade:{order}").response, rtol=1e-7
    )
    assert not dynamics(model, order).delayed


@pytest.mark.parametrize("order", [None, 2, 3])
@pytest.mark.parametrize("model", [LinearTilt(), NonlinearTilt(), Two()], ids=lambda m: m.label)
def test_a_state_space_has_its_own_frequency_response(model, order):
    values = model.values({n: v for n, v in VALUES.items() if n in model.parameters})
    found = response(dynamics(model, order), list(values.values()), OMEGA)
    delay = "exact" if order is None else f"pade:{order}"
    for i, o in input_output_pairs(model):
        wanted = gb.frequency_response(
            model, values, OMEGA, input=i, output=o, delay=delay
        ).response
        row = found[model.outputs.index(o), model.inputs.index(i)]
        assert_allclose(row, wanted, rtol=1e-7, atol=1e-12)


def test_realized_states_simulate_as_those_of_scipy():
    model, values = Tilt(), Tilt().values(VALUES | {"T_delay": 0.0})
    A, B, C, D = matrices(dynamics(model), list(values.values()))
    time = np.arange(200) / 100
    u = np.sin(7 * time)
    slow = np.polymul([1, values.a5], [1, values.a2, values.a1])
    denominator = np.polymul([values.T_rotor, 1], np.polyadd(slow, [PAPER_G * values.a3]))
    _, wanted, _ = lsim(
        ScipyTransferFunction(values.a4 * np.array([1, values.a5]), denominator), u, time
    )
    _, found, _ = lsim((A, B, C, D), u, time)
    assert_allclose(found, wanted, rtol=1e-6, atol=1e-8 * np.abs(wanted).max())


def test_delays_that_no_state_stands_for_stay_with_their_inputs():
    system = dynamics(Two())
    assert system.delayed
    assert_allclose(system.delay([3.0, 0.2]).full().ravel(), [0, 0.2])
    assert dynamics(Two(), 2).states == ("a", "b", "late_delay_0", "late_delay_1")


def test_the_delay_of_an_input_is_a_cascade_and_that_of_a_loop_is_not():
    for model in (Two(), LagLagDelay()):
        assert dynamics(model, 2).undelayed.states == dynamics(model).states
    loop, chain = (
        gb.feedback(LeadLag() * Gain().renamed(K="K_2")),
        Gain() * Gain().renamed(K="K_2", d="d_2"),
    )
    assert dynamics(loop, 2).undelayed is dynamics(chain, 2).undelayed is None
    assert len(dynamics(chain, 2).states) == 4


@pytest.mark.parametrize("delay", [0.0, 1e-4, 0.02, 1.0])
def test_a_cascade_with_a_fast_delay_needs_no_short_steps(delay):
    system, values, h = dynamics(LinearTilt(), 2), [*LinearTilt().values().values()], 0.01
    values[system.parameters.index("T_delay")] = max(delay, 1e-9)
    A, B, *_ = matrices(system, values)
    n, (x, fine) = len(A), np.zeros((2, len(A)))
    whole = expm(h * np.block([[A, B], [np.zeros((1, n + 1))]]))[:n]
    step = stepped(system, gb.RungeKutta(), 2)
    values[system.parameters.index("T_delay")] = delay
    for u in np.random.default_rng(0).normal(size=50):
        x, fine = step(x, u, 0.0, values, h).full().ravel(), whole @ [*fine, u]
    plant = slice(len(system.undelayed.states))
    assert_allclose(x[plant], fine[plant], atol=2e-6 * np.abs(fine[plant]).max())


def test_a_direct_path_sees_the_late_input():
    y = dynamics(LeadLag()).output([0.0], [1.0], [2.0, 0.5, 0.1]).full()
    assert_allclose(y, 2 * 0.5 / 0.1)


def test_what_no_ode_can_follow_is_refused():
    with pytest.raises(ValueError, match=r"Improper is improper .* add the lag"):
        dynamics(Improper())
    with pytest.raises(ValueError, match="no rational form"):
        dynamics(gb.feedback(Gain()))


def test_a_loop_around_a_delay_goes_by_pade_states():
    loop = gb.feedback(LeadLag() * Gain().renamed(K="K_2"))
    found = response(dynamics(loop, 3), list(loop.values().values()), OMEGA)[0, 0]
    assert_allclose(
        found, gb.frequency_response(loop, {}, OMEGA, delay="pade:3").response, rtol=1e-7
    )


def test_inputs_that_act_later_have_the_sum_of_both_delays():
    system = dynamics(LinearTilt())
    p = [VALUES.get(name, parameter.start) for name, parameter in LinearTilt.parameters.items()]
    assert float(system.delay(p)) > 0
    assert float(system.later([0.01]).delay(p)) == pytest.approx(float(system.delay(p)) + 0.01)
    assert system.later([0.0]) is system
