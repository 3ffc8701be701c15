"""Where the states of a model begin in a search."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

TRUTH = {"scale": 1.3, "bias": 0.05}


class Attitude(gb.StateSpace):
    """A quaternion driven by body rates; at zero it would stay there, whatever the parameters."""

    states = ("q0", "q1", "q2", "q3")
    inputs = ("p", "q", "r")
    outputs = ("phi", "theta", "psi")
    state_starts = {"q0": 1.0}
    scale = gb.Parameter(1.0, bounds=(0.2, 5))
    bias = gb.Parameter(0.0, bounds=(-0.5, 0.5), unit="rad/s")

    def derivative(self, x, u, p):
        a, b, c = (p.scale * rate + p.bias for rate in (u.p, u.q, u.r))
        norm = 1 - (x.q0**2 + x.q1**2 + x.q2**2 + x.q3**2)
        return (
            0.5 * (-x.q1 * a - x.q2 * b - x.q3 * c) + norm * x.q0,
            0.5 * (x.q0 * a + x.q2 * c - x.q3 * b) + norm * x.q1,
            0.5 * (x.q0 * b - x.q1 * c + x.q3 * a) + norm * x.q2,
            0.5 * (x.q0 * c + x.q1 * b - x.q2 * a) + norm * x.q3,
        )

    def output(self, x, u, p):
        return (
            gb.arctan2(2 * (x.q0 * x.q1 + x.q2 * x.q3), 1 - 2 * (x.q1**2 + x.q2**2)),
            gb.arcsin(2 * (x.q0 * x.q2 - x.q3 * x.q1)),
            gb.arctan2(2 * (x.q0 * x.q3 + x.q1 * x.q2), 1 - 2 * (x.q2**2 + x.q3**2)),
        )


class Pendulum(gb.StateSpace):
    """θ'' = k (u - sin θ), which hangs at 0 and stands at π."""

    states = ("theta", "rate")
    inputs = ("u",)
    outputs = ("theta",)
    k = gb.Parameter(4.0, bounds=(1, 10), unit="1/s²")

    def derivative(self, x, u, p):
        return x.rate, p.k * (u.u - gb.sin(x.theta))

    def output(self, x, u, p):
        return (x.theta,)


class Standing(Pendulum):
    """The same, begun upright."""

    state_starts = {"theta": np.pi}


class Tanks(gb.StateSpace):
    """Two tanks; their outflow is no number below level 0, and has no slope there."""

    states = ("h1", "h2")
    inputs = ("q",)
    outputs = ("h2",)
    k = gb.Parameter(1.0, bounds=(0.5, 2))
    c = gb.Parameter(1.0, bounds=(0.5, 2))

    def derivative(self, x, u, p):
        flow = p.k * gb.sqrt(x.h1)
        return u.q - flow, flow - p.c * gb.sqrt(x.h2)

    def output(self, x, u, p):
        return (x.h2,)


class FilledTanks(Tanks):
    """The same, begun filled."""

    state_starts = {"h1": lambda p: 4 / p.k**2, "h2": 4.0}


def test_every_start_finds_a_quaternion():
    random = np.random.default_rng(0)
    time = np.arange(200) * 0.02
    rates = {
        name: 0.6 * np.sin(frequency * time + phase)
        for name, frequency, phase in [("p", 1.9, 0.0), ("q", 2.6, 1.0), ("r", 1.3, 2.0)]
    }
    hold = dict.fromkeys(rates, np.inf)
    flown = gb.simulate(Attitude(), TRUTH, record=gb.Record(time, rates, hold=hold))
    angles = {n: flown[n] + 0.01 * random.standard_normal(200) for n in Attitude.outputs}
    record = gb.Record(time, rates | angles, hold=hold | dict.fromkeys(angles, 0.0))

    fit = gb.fit(gb.Problem(Attitude(), record), 4, progress=False, profiles=False)

    assert fit.agreeing == 4
    for name, value in TRUTH.items():
        assert abs(fit.estimate[name] - value) < 4 * fit.standard_error[name]


def test_known_initial_states_come_before_declared_starts():
    """From an initial state that is known exactly, nothing about it is estimated."""
    time = np.linspace(0, 3, 40)
    record = gb.Record(time, {"q": np.ones(40)})
    levels = gb.simulate(
        Tanks(), {"k": 1.0, "c": 1.0}, record=record, initial={"h1": 2.0, "h2": 3.0}
    )["h2"]
    measured = gb.Record(time, {"q": np.ones(40), "h2": levels + 0.001 * np.cos(9 * time)})
    known = gb.OutputError(initial={"h1": 2.0, "h2": 3.0})
    start = [{"k": 1.5, "c": 0.7}]
    fits = [
        gb.fit(gb.Problem(model, measured, known), start, progress=False, profiles=False)
        for model in (Tanks(), FilledTanks())
    ]
    assert fits[0].estimate["k"] == pytest.approx(1, abs=0.01)
    assert fits[1].estimate["k"] == pytest.approx(fits[0].estimate["k"], rel=1e-7)


def test_a_simulation_begins_there_and_says_so():
    record = gb.Record(np.array([0.0, 0.5]), {"q": np.zeros(2)})
    simulated = gb.simulate(FilledTanks(), {"k": 2.0, "c": 1.0}, record=record)
    assert simulated["h2"][0] == 4.0
    # h1 begins at 4 / 2² = 1, and empties as (1 - t)² for k = 2.
    first = gb.simulate(FilledTanks(), {"k": 2.0, "c": 1.0}, record=record, initial={"h1": 1.0})
    assert_allclose(simulated["h2"], first["h2"])


def test_the_operating_point_is_the_nearby_equilibrium():
    """At rest the response is 1/cos θ: 1 where it hangs, -1 where it stands."""
    for model, response in ((Pendulum(), 1.0), (Standing(), -1.0)):
        at_rest = gb.frequency_response(model, None, [1e-3], at={"u": 0.0}).response
        assert_allclose(at_rest, response, rtol=1e-5)


def test_the_operating_point_is_searched_from_there():
    """With u = 0.5, θ is π/6 or π - π/6."""
    for model, angle in ((Pendulum(), np.pi / 6), (Standing(), np.pi - np.pi / 6)):
        at_rest = gb.frequency_response(model, None, [1e-3], at={"u": 0.5}).response
        assert_allclose(at_rest, 1 / np.cos(angle), rtol=1e-5)


def test_structural_identifiability_draws_states_around_them():
    # Without them every draw begins with an empty tank, or less.
    assert gb.structural_identifiability(FilledTanks()).identifiable == ("k", "c")


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ({"h": 1.0}, "no state 'h'"),
        ({"y": np.nan}, r"state_starts\['y'\] is nan: give a finite number"),
        ({"y": "1"}, r"state_starts\['y'\] is '1': give a finite number"),
    ],
)
def test_a_wrong_declaration_is_refused(starts, message):
    body = {"states": ("y",), "inputs": (), "outputs": ("y",), "state_starts": starts}
    body |= {"derivative": lambda self, x, u, p: (-x.y,), "output": lambda self, x, u, p: (x.y,)}
    with pytest.raises(ValueError, match=message):
        type("Wrong", (gb.StateSpace,), body)
