"""Which states are known, which equations are left, which parameters enter linearly, of a small model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.realization import dynamics
from greybox.regression.linear_in_parameters import _unstable, regressions


class Motor(gb.StateSpace):
    """Angle, rate and a current that follows the voltage with a lag: L i' = u - R i."""

    states, inputs, outputs = ("angle", "rate", "current"), ("u",), ("degrees",)
    delays = {"u": "T"}
    k = gb.Parameter(2.0, bounds=(0, 10))
    c = gb.Parameter(0.5, bounds=(0, 10))
    R = gb.Parameter(3.0, bounds=(0.1, 10))
    L = gb.Parameter(0.5, bounds=(0.1, 10))
    T = gb.Parameter(0.0, bounds=(0, 0.1), fixed=True)

    def derivative(self, x, u, p):
        return (x.rate, p.k * x.current - p.c * x.rate * abs(x.rate), (u.u - p.R * x.current) / p.L)

    def output(self, x, u, p):
        return (180 / np.pi * x.angle + 4,)


def of(model, signals, fixed=None, start=None):
    fixed = {"T": 0.0} if fixed is None else fixed
    free = [p.start for name, p in model.parameters.items() if name not in fixed]
    return regressions(dynamics(model), signals, fixed, np.array(free if start is None else start))


def test_each_state_is_known_in_its_own_way():
    found = of(Motor(), ["u", "degrees"])
    assert [str(state) for state in found.states] == [
        "angle from the signal degrees",
        "rate from the derivative of angle",
        "current simulated from u",
    ]
    angle, rate, _ = found.states
    assert_allclose(angle.value([0, 0, 0], 94.0), np.pi / 2)
    assert_allclose(rate.value([0, 0, 0], 0.3), 0.3)
    assert tuple(s.name for s in found.states if s.how == "simulated") == ("current",)


def test_parameters_of_a_simulated_state_are_not_linear():
    found = of(Motor(), ["u", "degrees"])
    assert [(e.left, e.parameters) for e in found.equations] == [("rate'", ("k", "c", "R", "L"))]
    assert found.linear == ("k", "c")
    assert found.nonlinear == ("R", "L")


def test_a_measured_state_makes_its_own_equation():
    found = of(Motor(), ["u", "degrees", "current"])
    assert {e.left: e.parameters for e in found.equations} == {
        "rate'": ("k", "c"),
        "current'": ("R", "L"),
    }
    # Of R / L and 1 / L, R enters linearly for a given L.
    assert found.linear == ("k", "c", "R")
    assert found.nonlinear == ("L",)
    assert found.equations[0].signals == ("current", "degrees")


@pytest.mark.parametrize("signals", [["u", "degrees"], ["u", "degrees", "current"]])
def test_rows_and_slopes_are_the_right_sides(signals):
    model = Motor()
    found = of(model, signals)
    random = np.random.default_rng(0)
    x, u, p = random.normal(size=3), random.normal(size=1), random.uniform(1, 2, 4)
    base, slopes = (np.asarray(v) for v in found.rows(x, u, p))
    linear = p[[found.free.index(n) for n in found.linear]]
    wanted = np.asarray(dynamics(model).derivative(x, u, [*p, 0.0])).ravel()
    rows = [model.states.index(e.target) for e in found.equations]
    assert_allclose(base.ravel() + slopes @ linear, wanted[rows], rtol=1e-12)


def test_the_simulated_state_is_linear_in_itself():
    found = of(Motor(), ["u", "degrees"])
    drive, matrix = found.simulated([0, 0, 5.0], [4.0], [2, 0.5, 3, 0.5])
    assert (float(drive), float(matrix)) == (8.0, -6.0)


def test_a_fixed_parameter_is_a_number_and_a_free_delay_is_not_linear():
    found = of(Motor(), ["u", "degrees", "current"], fixed={"k": 2.0, "c": 0.5, "R": 3.0})
    assert found.free == ("L", "T")
    assert found.equations[0].left == "current'"
    assert (found.linear, found.nonlinear) == ((), ("L", "T"))
    assert float(found.delay([0.5, 0.07])) == 0.07


def test_an_unstable_state_is_not_simulated():
    found = of(Motor(), ["u", "degrees"], start=[2.0, 0.5, -3.0, 0.5])
    assert found.equations == ()
    assert set(found.left_out) == {
        "rate' (it needs current, not known)",
        "current' (the state current is not known)",
    }


@pytest.mark.parametrize(
    ("term", "is_linear"),
    [
        (lambda a, x: a * x, True),
        (lambda a, x: abs(a), False),
        (lambda a, x: gb.sign(a), False),
        (lambda a, x: -abs(a), False),
        (lambda a, x: a * 1e9 + x, True),
    ],
    ids=["product", "size", "sign", "less its size", "large"],
)
def test_a_parameter_is_linear_where_numbers_say_so(term, is_linear):
    class Term(gb.StateSpace):
        states, inputs, outputs = ("x",), (), ("y",)
        a = gb.Parameter(1.0)

        def derivative(self, x, u, p):
            return (term(p.a, x.x),)

        def output(self, x, u, p):
            return (x.x,)

    assert of(Term(), ["y"], fixed={}).linear == (("a",) if is_linear else ())


class Hidden(gb.StateSpace):
    """Three hidden states, of which the second of a pair and the third may not decay, beside one that is measured."""

    states, inputs, outputs = ("v", "w", "n", "i"), ("u",), ("v",)
    a = gb.Parameter(1.0, bounds=(-9, 9))
    b = gb.Parameter(1.0, bounds=(-9, 9))
    f = gb.Parameter(-3.0, bounds=(-9, 9))
    g = gb.Parameter(-0.5, bounds=(-9, 9))
    k = gb.Parameter(2.0, bounds=(-9, 9))

    def derivative(self, x, u, p):
        return (p.a * x.v + p.b * x.w + p.k * x.i, p.f * x.w + 0.1 * x.n, p.g * x.n + u.u, u.u)

    def output(self, x, u, p):
        return (x.v,)


def test_states_that_do_not_decay_are_not_known_and_neither_is_what_they_drive():
    """An integrator does not forget where it began; a growing mode leaves out the state with its largest part."""
    found = of(Hidden(), ["u", "v"], fixed={"k": 0.0})
    assert tuple(s.name for s in found.states if s.how == "simulated") == ("w", "n")
    assert [e.left for e in found.equations] == ["v'"]
    assert found.linear == ("a", "b")
    assert found.nonlinear == ("f", "g")
    found = of(Hidden(), ["u", "v"], fixed={})
    assert found.equations == ()
    assert found.left_out[0] == "v' (it needs i, not known)"
    growing = of(Hidden(), ["u", "v"], fixed={"k": 0.0}, start=[1.0, 1.0, -3.0, 0.5])
    assert all(s.how != "simulated" for s in growing.states)
    assert "v' (it needs w, not known)" in growing.left_out
    assert "n' (the state n is not known)" in growing.left_out
    still = of(Hidden(), ["u", "v"], fixed={"k": 0.0}, start=[1.0, 1.0, -3.0, 0.0])
    assert "v' (it needs w, not known)" in still.left_out


@pytest.mark.parametrize(
    ("matrix", "names"),
    [
        ([[-1.0, 5.0], [0.0, -2.0]], []),
        ([[-1.0, 5.0], [0.0, 0.0]], ["p"]),  # the mode (5, 1)
        ([[-1.0, 0.2], [0.0, 0.0]], ["q"]),  # the mode (0.2, 1)
        ([[3.0, 0.0], [9.0, -2.0]], ["q"]),  # the mode (5, 9)
        ([[0.0, 1.0], [-4.0, 0.0]], ["q"]),  # an oscillation that does not decay: (1, 2j)
        ([[np.nan, 0.0], [0.0, -1.0]], ["p", "q"]),
    ],
)
def test_the_state_with_the_largest_part_in_a_mode_that_does_not_decay_is_left_out(matrix, names):
    assert _unstable(np.array(matrix), ["p", "q"]) == names


class Products(gb.StateSpace):
    """Of three parameters the second multiplies both others; the fourth alone is a power."""

    states, inputs, outputs = ("v", "w"), ("u",), ("v", "y")
    a, b, c, d = (gb.Parameter(1.0, bounds=(-9, 9)) for _ in range(4))

    def derivative(self, x, u, p):
        return (p.a * p.b * x.w + p.b * p.c * u.u, p.d**2 * u.u)

    def output(self, x, u, p):
        return (x.v, p.c * x.w)


def test_of_parameters_that_multiply_one_another_the_fewest_are_left_out():
    found = of(Products(), ["u", "v", "w", "y"], fixed={})
    assert found.linear == ("a", "c")
    assert found.nonlinear == ("b", "d")


def test_an_equation_is_of_the_signals_behind_its_row_and_of_that_whose_slope_it_is():
    found = of(Products(), ["u", "v", "w", "y"], fixed={})
    assert [(e.left, e.signals) for e in found.equations] == [
        ("v'", ("v", "w")),
        ("w'", ("w",)),
        ("y", ("w",)),
    ]
