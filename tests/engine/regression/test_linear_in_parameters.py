"""Which states are known, which equations are left, which parameters enter linearly, of a small model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.regression.linear_in_parameters import regressions
from greybox.modeling.realization import dynamics


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


def of(model, signals, fixed=None):
    return regressions(dynamics(model), signals, {"T": 0.0} if fixed is None else fixed)


def test_each_state_is_known_in_its_own_way():
    found = of(Motor(), ["u", "degrees"])
    assert [str(state) for state in found.states] == [
        "angle from the signal degrees",
        "rate from the derivative of angle",
    ]
    angle, rate = found.states
    assert_allclose(angle.value([0, 0, 0], 94.0), np.pi / 2)
    assert_allclose(rate.value([0, 0, 0], 0.3), 0.3)
    assert found.equations == ()
    assert set(found.left_out) == {
        "rate' (it needs current, not known)",
        "current' (the state current is not known)",
    }


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


def test_rows_and_slopes_are_the_right_sides():
    model = Motor()
    found = of(model, ["u", "degrees", "current"])
    random = np.random.default_rng(0)
    x, u, p = random.normal(size=3), random.normal(size=1), random.uniform(1, 2, 4)
    base, slopes = (np.asarray(v) for v in found.rows(x, u, p))
    linear = p[["kcRL".index(n) for n in found.linear]]
    wanted = np.asarray(dynamics(model).derivative(x, u, [*p, 0.0])).ravel()
    rows = [model.states.index(e.target) for e in found.equations]
    assert_allclose(base.ravel() + slopes @ linear, wanted[rows], rtol=1e-12)


def test_a_fixed_parameter_is_a_number_and_a_free_delay_is_not_linear():
    found = of(Motor(), ["u", "degrees", "current"], fixed={"k": 2.0, "c": 0.5, "R": 3.0})
    assert found.equations[0].left == "current'"
    assert (found.linear, found.nonlinear) == ((), ("L", "T"))
    assert float(found.delay([0.5, 0.07])) == 0.07


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
