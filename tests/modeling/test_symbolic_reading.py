"""What a formula must return, and what CasADi cannot trace, in sentences that name the cure."""

import math

import casadi as ca
import numpy as np
import pytest
from evaluation import response_formula

import greybox as gb

OMEGA = np.geomspace(0.3, 40, 12)


def state_space(derivative=lambda x, u, p: (u.u - p.c * x.x,), output=lambda x, u, p: (x.x,)):
    body = {
        "states": ("x",),
        "c": gb.Parameter(1.0, bounds=(0.1, 5)),
        "derivative": lambda self, x, u, p: derivative(x, u, p),
        "output": lambda self, x, u, p: output(x, u, p),
    }
    return type("Mine", (gb.StateSpace,), body)()


@pytest.mark.parametrize(
    ("functions", "sentence"),
    [
        (
            {"derivative": lambda x, u, p: (u.u, x.x)},
            r"Mine\.derivative returns 2 values and must return 1, as a tuple: one for each of",
        ),
        (
            {"output": lambda x, u, p: (x.x, u.u)},
            r"Mine\.output returns 2 values and must return 1, as a tuple: one for each of y",
        ),
        (
            {"derivative": lambda x, u, p: (ca.vertcat(u.u, x.x),)},
            r"Mine\.derivative gives 2 numbers as value 0: return one scalar",
        ),
        ({"output": lambda x, u, p: ("x",)}, r"Mine\.output gives a str as value 0.* gb\.exp"),
        ({"derivative": lambda x, u, p: {"x": u.u, "v": x.x}}, r"as value 0.*\breturn a tuple"),
        ({"derivative": lambda x, u, p: (None,)}, r"Mine\.derivative gives a NoneType as value 0"),
        # math functions silently turn a CasADi symbol into NaN
        ({"derivative": lambda x, u, p: (u.u - math.sin(x.x),)}, r"gb\."),
        ({"output": lambda x, u, p: (math.sin(x.x),)}, r"gb\."),
        # what self.c is in place of p.c
        ({"output": lambda x, u, p: (gb.Parameter(1.0) * x.x,)}, r"p\.NAME"),
        # the truth value of an expression
        ({"derivative": lambda x, u, p: (u.u - max(x.x, 0),)}, r"gb\."),
        ({"derivative": lambda x, u, p: (u.u - (x.x if x.x > 0 else 0),)}, r"gb\.where"),
    ],
)
def test_wrong_formulas_of_an_ode_are_said_in_a_sentence(functions, sentence):
    with pytest.raises(ValueError, match=sentence):
        gb.modeling.linearize(state_space(**functions))


def test_an_attribute_of_the_class_is_not_a_parameter():
    class Cart(gb.StateSpace):
        """A cart whose drag is a plain number."""

        states = outputs = ("v",)
        inputs = ("F",)
        m = gb.Parameter(1.0, bounds=(0.1, 10))
        drag = 0.5

        def derivative(self, x, u, p):
            return ((u.F - p.drag * x.v) / p.m,)

        def output(self, x, u, p):
            return (x.v,)

    with pytest.raises(AttributeError, match=r"write self\.drag"):
        gb.modeling.linearize(Cart())


def transfer_function(formula):
    body = {"c": gb.Parameter(1.0), "response": lambda self, s, p: formula(s, p)}
    return type("Mine", (gb.TransferFunction,), body)()


@pytest.mark.parametrize(
    "formula",
    [
        lambda s, p: np.exp(-s * p.c),
        lambda s, p: math.exp(p.c) / (s + 1),
        lambda s, p: 1 / (s + 1) if p.c > 0 else s,
    ],
    ids=["numpy", "math", "if"],
)
def test_formulas_that_casadi_cannot_trace_name_the_cure(formula):
    with pytest.raises(ValueError, match=r"gb\."):
        response_formula(transfer_function(formula), OMEGA)
