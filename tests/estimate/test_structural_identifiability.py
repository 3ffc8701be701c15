"""Structures whose identifiability is known from theory, and shipped ones."""

import pytest

import greybox as gb
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
    assert "k and m cannot be told apart: fix one of them" in str(found)
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


def test_tied_parameters_and_single_outputs_are_asked_for():
    assert not gb.structural_identifiability(Redundant(), tied={"m": lambda p: p.k}, fixed={"idle": 0.0}).groups
    with pytest.raises(ValueError, match="'z'"):
        gb.structural_identifiability(Scaled(), ["z"])
    with pytest.raises(ValueError, match="leave it out"):
        gb.structural_identifiability(Redundant(), initial={"x": 1.0})


@pytest.mark.parametrize("model", [Tilt(), LinearTilt(), NonlinearTilt()])
def test_shipped_structures_can_be_told(model):
    assert not gb.structural_identifiability(model, points=1).groups
