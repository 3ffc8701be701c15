"""Structures whose identifiability is known from theory, and shipped ones."""

import numpy as np
import pytest
from classic_structures import STRUCTURES

import greybox as gb
from greybox.assessment.structural_identifiability import StructuralIdentifiability, _times
from greybox.engine.covariance.combinations import Combination
from greybox.models.tilt import LinearTilt, NonlinearTilt, Tilt


class Redundant(gb.TransferFunction):
    """A product of gains and a parameter without effect."""

    k = gb.Parameter(2.0, bounds=(0.1, 10))
    m = gb.Parameter(3.0, bounds=(0.1, 10))
    T = gb.Parameter(0.5, bounds=(0.01, 5), unit="s")
    idle = gb.Parameter(1.0, bounds=(0, 5))

    def response(self, s, p):
        return p.k * p.m / (p.T * s + 1)


class Scaled(gb.StateSpace):
    """A lag whose state has no unit of its own: b and c only as a product."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    a = gb.Parameter(1.0, bounds=(0.1, 5))
    b = gb.Parameter(2.0, bounds=(0.1, 5))
    c = gb.Parameter(3.0, bounds=(0.1, 5))

    def derivative(self, x, u, p):
        return (-p.a * x.x + p.b * u.u,)

    def output(self, x, u, p):
        return (p.c * x.x,)


class Compartments(gb.StateSpace):
    """Two compartments with a leak each, the first fed and measured."""

    states, inputs, outputs = ("x1", "x2"), ("u",), ("y",)
    V = gb.Parameter(2.0, bounds=(0.5, 5))
    k12 = gb.Parameter(1.0, bounds=(0.2, 5))
    k21 = gb.Parameter(0.7, bounds=(0.2, 5))
    k01 = gb.Parameter(0.5, bounds=(0.2, 5))
    k02 = gb.Parameter(0.3, bounds=(0.0, 5))

    def derivative(self, x, u, p):
        return (-(p.k01 + p.k21) * x.x1 + p.k12 * x.x2 + u.u, p.k21 * x.x1 - (p.k02 + p.k12) * x.x2)

    def output(self, x, u, p):
        return (x.x1 / p.V,)


class Saturating(gb.StateSpace):
    """Michaelis-Menten elimination from an unknown initial state, seen through an unknown scale."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    v = gb.Parameter(1.0, bounds=(0.5, 3))
    K = gb.Parameter(0.8, bounds=(0.5, 3))
    c = gb.Parameter(2.0, bounds=(0.5, 3))
    fed = gb.Parameter(1.0, fixed=True)

    def derivative(self, x, u, p):
        return (-p.v * x.x / (p.K + abs(x.x)) + p.fed * u.u,)

    def output(self, x, u, p):
        return (p.c * x.x,)


def lost(found):
    return [set(group.names) for group in found.groups]


def test_products_and_what_has_no_effect_are_named():
    found = gb.structural_identifiability(Redundant())
    assert lost(found) == [{"k", "m"}, {"idle"}]
    assert found.identifiable == ("T",)
    assert found.combinations == ("k m",)
    assert "k and m cannot be separated: fix one of them" in str(found)
    assert "idle has no effect" in str(found)
    assert not gb.structural_identifiability(Redundant(), fixed={"m": 1.0, "idle": 0.0}).groups


@pytest.mark.parametrize("options", [{}, {"at": {"x": 0.0}}])
def test_a_state_without_a_unit_of_its_own_hides_its_scale(options):
    found = gb.structural_identifiability(Scaled(), **options)
    assert lost(found) == [{"b", "c"}]
    assert found.combinations == ("b c",)
    # In time a known initial state other than zero gives the scale away.
    assert not gb.structural_identifiability(Scaled(), initial={"x": 1.0}).groups


def test_compartments_are_as_in_the_textbook():
    (group,) = gb.structural_identifiability(Compartments()).groups
    assert (set(group.names), group.directions) == ({"k12", "k21", "k01", "k02"}, 1)
    assert not gb.structural_identifiability(Compartments(), fixed={"k02": 0.0}).groups


def test_a_nonlinear_scale_is_found_with_its_initial_state():
    (group,) = gb.structural_identifiability(Saturating(), fixed={"fed": 0.0}).groups
    assert (set(group.names), group.states, group.directions) == ({"v", "c", "K"}, ("x",), 1)
    assert not gb.structural_identifiability(Saturating()).groups


class Pressure(gb.StateSpace):
    """A chamber, in pascals: with any input its state is large. K and b are a product."""

    states, inputs, outputs = ("x",), ("u",), ("x",)
    K = gb.Parameter(1e6, bounds=(5e5, 2e6), unit="Pa/s")
    b = gb.Parameter(1.0, bounds=(0.5, 2))
    a = gb.Parameter(2.0, bounds=(1, 3), unit="1/s")

    def derivative(self, x, u, p):
        return (p.K * p.b * u.u - p.a * x.x,)

    def output(self, x, u, p):
        return (x.x,)


class Steep(Pressure):
    """Beyond a few units an exponential shows its largest value alone."""

    K = gb.Parameter(800.0, bounds=(400, 1600), fixed=True)

    def output(self, x, u, p):
        return (gb.exp(-x.x),)


def test_states_may_be_of_any_size():
    assert lost(gb.structural_identifiability(Pressure())) == [{"K", "b"}]
    assert not gb.structural_identifiability(Steep()).groups


def test_tied_parameters_and_single_outputs_are_asked_for():
    assert not gb.structural_identifiability(
        Redundant(), tied={"m": lambda p: p.k}, fixed={"idle": 0.0}
    ).groups
    with pytest.raises(ValueError, match="'z'"):
        gb.structural_identifiability(Scaled(), ["z"])
    with pytest.raises(ValueError, match="leave it out"):
        gb.structural_identifiability(Redundant(), initial={"x": 1.0})
    with pytest.raises(TypeError, match="not the class"):
        gb.structural_identifiability(Redundant)


@pytest.mark.parametrize("model", [Tilt(), LinearTilt(), NonlinearTilt()])
def test_shipped_structures_can_be_told(model):
    assert not gb.structural_identifiability(model).groups


def pole_of(rate, slow=0.0):
    """A state with this pole, and one with another."""

    class Poles(gb.StateSpace):
        states, inputs, outputs = ("x", "z"), ("u",), ("x",)
        a = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return p.a * rate * x.x + u.u, slow * x.z

        def output(self, x, u, p):
            return (x.x,)

    return Poles()


@pytest.mark.parametrize(
    ("rate", "slow", "step", "length"),
    [
        (-2.0, -0.5, 0.3 / 8, 60),  # a = 4: the fastest pole is at -8
        (0.5, -8.0, 0.3 / 8, 60),  # growing by 2 1/s, e⁵ would last 2.5 s: 66 samples
        (1.0, -8.0, 0.3 / 8, 33),  # by 4 1/s: 1.25 s
        (1.0, 0.0, 0.3 / 4, 16),
        (0.0, 0.0, 0.3 / 1e-3, 60),  # an integrator has no time of its own
    ],
)
def test_times_follow_the_poles(rate, slow, step, length):
    time, gaps = _times(pole_of(rate, slow), {"a": 4.0}, np.random.default_rng(0))
    np.testing.assert_allclose(np.diff(time), step)
    assert time[0] == 0
    assert np.flatnonzero(gaps).tolist() == [(k + 1) * (length + 1) - 1 for k in range(4)]
    assert gaps.size == 4 * (length + 1)


def test_rows_of_a_static_model_are_one_apart():
    class Static(gb.StateSpace):
        inputs, outputs = ("u",), ("y",)
        k = gb.Parameter(1.0)

        def output(self, x, u, p):
            return (p.k * u.u,)

    time, gaps = _times(Static(), {"k": 4.0}, np.random.default_rng(0))
    np.testing.assert_allclose(time, np.arange(244))
    assert gaps.sum() == 4


def test_what_cannot_be_told_apart_in_words():
    groups = (
        Combination(("k", "m"), np.inf),
        Combination(("idle",), np.inf),
        Combination(("a", "b", "c"), np.inf, 2, ("x",)),
    )
    found = StructuralIdentifiability(
        "Plant", ("k", "m", "idle", "a", "b", "c", "T"), groups, ("k m",), "the time history of y"
    )
    assert str(found) == (
        "Plant, structural identifiability from the time history of y:\n"
        "  k and m cannot be separated: fix one of them.\n"
        "  idle has no effect: fix it or remove it.\n"
        "  a, b, c and the initial state of x cannot be separated: fix 2 of them.\n"
        "  Determined in combination: k m and 1 combination (neither product nor sum).\n"
        "  T can be determined."
    )
    assert repr(found).startswith("<StructuralIdentifiability Plant, structural identifiability")
    alone = StructuralIdentifiability("Plant", ("k", "m"), (), (), "the time history of y")
    assert str(alone).splitlines()[1:] == ["  all of k and m can be determined."]


class Root(gb.TransferFunction):
    """A response that is not finite where the root is of a negative number."""

    k = gb.Parameter(1.0, bounds=(-5, 5))
    c = gb.Parameter(1.0, bounds=(1, 5))

    def response(self, s, p):
        return p.c * gb.sqrt(p.k) / (s + 1)


class Nothing(Root):
    def response(self, s, p):
        return 0 * p.k * p.c / (s + 1)


@pytest.mark.parametrize("model", [Root(), Nothing()])
def test_a_model_without_a_finite_response_at_any_point_is_refused(model):
    said = rf"^{type(model).__name__} is finite at none of 3 points of its start boxes"
    with pytest.raises(ValueError, match=said):
        gb.structural_identifiability(model, fixed={"k": -1.0})


def test_of_two_outputs_both_responses_tell():
    """Through the state itself the gain of the input is seen, and through both outputs their ratio."""

    class TwoOutputs(Scaled):
        outputs = ("y", "z")

        def output(self, x, u, p):
            return p.c * x.x, x.x

    assert lost(gb.structural_identifiability(TwoOutputs(), ["y"], at={"x": 0.0})) == [{"b", "c"}]
    found = gb.structural_identifiability(TwoOutputs(), at={"x": 0.0})
    assert not found.groups
    assert found.data == "the response of y and z"


@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda s: s.model.label)
def test_structures_of_the_literature_are_judged_rightly(structure):
    answer = gb.structural_identifiability(structure.model)
    groups = {(frozenset(group.names), group.directions) for group in answer.groups}
    assert groups == {(frozenset(names.split()), count) for names, count in structure.groups}


def test_what_a_motor_determines_beside_a_product_is_counted():
    motor = next(s.model for s in STRUCTURES if s.model.label == "Motor")
    # The response has three coefficients; only that of s², L J/Km, is a product.
    assert "L J/Km and 2 combinations" in str(gb.structural_identifiability(motor))


class Driven(gb.StateSpace):
    """A lag behind an element with a threshold c."""

    states = outputs = ("y",)
    inputs = ("u",)
    a = gb.Parameter(1.0, bounds=(0.5, 2))
    c = gb.Parameter(0.5, bounds=(0.1, 1))

    def element(self, u, p):
        return gb.where(u < p.c, p.a, 0)

    def derivative(self, x, u, p):
        return (self.element(u.u, p) - x.y,)

    def output(self, x, u, p):
        return (x.y,)


class DeadZone(Driven):
    def element(self, u, p):
        return p.a * u + gb.maximum(u - p.c, 0) + gb.minimum(u + p.c, 0)


class WideDeadZone(DeadZone):
    c = gb.Parameter(25.0, bounds=(20, 30))


class Limit(Driven):
    c = gb.Parameter(25.0, bounds=(20, 30))

    def element(self, u, p):
        return p.a * gb.maximum(gb.minimum(u, p.c), -p.c)


class Absent(Driven):
    def element(self, u, p):
        return p.a * gb.maximum(u, 0)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        (Driven(), "c enters only through a switch or a rounding, which has no slope"),
        (WideDeadZone(), "c has no effect on what was tried here, but its formula has a switch"),
        (Limit(), "c has no effect on what was tried here, but its formula has a switch"),
        (Absent(), "c has no effect: fix it or remove it."),
    ],
    ids=lambda case: getattr(case, "label", ""),
)
def test_a_threshold_is_not_said_to_have_no_effect(model, said):
    answer = gb.structural_identifiability(model)
    assert lost(answer) == [{"c"}]
    assert said in str(answer)
    assert set(answer.reasons) == ({"c"} if type(model) is not Absent else set())


def test_a_dead_zone_that_inputs_exceed_is_determined():
    assert gb.structural_identifiability(DeadZone()).identifiable == ("a", "c")
