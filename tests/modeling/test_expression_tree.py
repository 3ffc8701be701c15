"""Formulas as trees: every included model has the value that its own formula gives in numbers."""

import math
import pkgutil
from importlib import import_module

import casadi as ca
import numpy as np
import pytest

import greybox as gb
from greybox.modeling.expression_tree import (
    Function,
    Symbol,
    Term,
    _operate,
    expressions,
    factor,
    number,
    power,
    size,
)
from greybox.modeling.model_file import models_of
from greybox.modeling.symbolic_reading import parameter_names, split, traced_derivative

FUNCTIONS = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "abs": np.abs,
    "sign": np.sign,
    "tanh": np.tanh,
    "min": np.minimum,
    "max": np.maximum,
    "not": lambda a: float(not a),
    "<": lambda a, b: float(a < b),
    "≤": lambda a, b: float(a <= b),
    "and": lambda a, b: float(bool(a) and bool(b)),
    "if": lambda condition, value: value if condition else 0.0,
}


def evaluated(expression, values):
    """The value of a tree, in plain arithmetic."""

    def value(part):
        match part:
            case Symbol(name):
                return math.e if name == "e" else values[name]
            case Function("^", (base, exponent)):
                return evaluated(base, values) ** evaluated(exponent, values)
            case Function("()", (terms,)):
                return evaluated(terms, values)
            case Function(name, arguments):
                return FUNCTIONS[name](*(evaluated(argument, values) for argument in arguments))

    return sum(
        term.number * math.prod(map(value, term.over)) / math.prod(map(value, term.under))
        for term in expression
    )


def included():
    package = import_module("greybox.models")
    for item in pkgutil.iter_modules(package.__path__):
        for model in models_of(import_module(f"greybox.models.{item.name}")):
            yield pytest.param(
                model(4, 2) if "Polynomial" in model.__name__ else model(), id=model.__name__
            )


def tree(function, *names, values=None):
    symbols = {name: ca.SX.sym(name) for name in names}
    return expressions(ca.SX(function(*symbols.values())), symbols, {}, values or {})[0]


@pytest.mark.parametrize("model", list(included()))
def test_every_included_model_keeps_its_value(model):
    rng = np.random.default_rng(0)
    p = {name: float(rng.uniform(0.5, 2)) for name in model.parameters}
    symbols = {name: ca.SX.sym(name) for name in p}
    vector = ca.vertcat(*symbols.values())
    if isinstance(model, gb.TransferFunction):
        s = 0.3 + 1.7j
        symbol = ca.SX.sym("s")
        response = ca.SX(model.response(symbol, parameter_names(model, vector)))
        (found,) = expressions(response, {"s": symbol, **symbols}, {})
        expected = model.response(s, model.values(p))
        assert evaluated(found, {"s": s, **p}) == pytest.approx(expected, rel=1e-12)
        (numbers,) = expressions(response, {"s": symbol, **symbols}, {}, p)
        assert evaluated(numbers, {"s": s}) == pytest.approx(expected, rel=1e-12)
        return
    signals = {name: ca.SX.sym(name) for name in (*model.states, *model.inputs)}
    z = {name: float(rng.uniform(-1, 1)) for name in signals}
    if not model.states:
        return
    found = expressions(
        traced_derivative(model, ca.vertcat(*signals.values()), vector), {**signals, **symbols}, {}
    )
    expected = model.derivative(*split(model, list(z.values())), model.values(p))
    assert [evaluated(f, {**z, **p}) for f in found] == pytest.approx(
        [float(e) for e in expected], rel=1e-12
    )


@pytest.mark.parametrize(
    ("function", "at"),
    [
        (lambda a, b: gb.where(a < b, a - b, 2 * a * b), (0.3, 0.7)),
        (lambda a, b: gb.where(a < b, a - b, 2 * a * b), (0.7, 0.3)),
        (lambda a, b: -a * -(b - a) / -(2 * a) + 0 * b, (0.7, 0.3)),
        (lambda a, b: gb.maximum(a, b) ** 3 / (a / (b / a)) - gb.sqrt(a) / abs(-b), (0.7, 0.3)),
        (lambda a, b: 1 / a + 1 / (1 / b) - gb.exp(-a * b) * 1.0, (0.7, 0.3)),
    ],
)
def test_signs_fractions_and_branches_keep_the_value(function, at):
    values = dict(zip("ab", at, strict=True))
    found = tree(function, "a", "b")
    assert evaluated(found, values) == pytest.approx(float(function(*at)), rel=1e-14)
    numbers = tree(function, "a", "b", values=values)
    assert evaluated(numbers, {}) == pytest.approx(float(function(*at)), rel=1e-14)


def group(*terms):
    return Function("()", (terms,))


def test_it_is_what_a_person_would_write():
    s, k = Symbol("s"), Symbol("K")
    (cube,) = power(factor(s), number(3.0))
    assert tree(lambda s, k: k * s * s**2 / (s * 2), "s", "K") == (
        Term(0.5, (k, *cube.over), (s,)),
    )
    assert tree(lambda s, k: k - (s - 1), "s", "K") == (Term(1, (k,)), Term(-1, (s,)), Term(1))
    assert tree(lambda s, k: k * s + 3, "s", "K", values={"K": 0.0}) == number(3.0)
    assert tree(lambda s, k: 3 * (s - k) / 3, "s", "K") == (Term(1, (s,)), Term(-1, (k,)))
    assert tree(lambda s, k: -1 * (s - k), "s", "K") == (Term(-1, (s,)), Term(1, (k,)))


def test_the_size_of_what_repeats_is_that_of_what_would_be_written():
    def nested(a):
        for _ in range(60):
            a = a * gb.sin(a)
        return a

    assert size(tree(nested, "a")) > 2**59


def test_the_size_counts_symbols_numbers_and_functions():
    s, k, two = Symbol("s"), Symbol("K", "T"), number(2.0)
    assert [size(part) for part in (factor(s), two, power(factor(s), two))] == [1, 1, 3]
    assert size((Term(2.0, (k, *power(factor(s), two)[0].over), (s, k)),)) == 7
    assert size((Term(1.0, (k,)), Term(-1.0, (s,), (k,)))) == 3
    assert size(factor(Function("if", (factor(Function("<", (factor(s), factor(k)))), two)))) == 5


def test_values_stand_in_the_place_of_all_symbols_that_they_name():
    s, two = Symbol("s"), number(2.0)
    maximum = tree(lambda s, k: gb.maximum(s**k, 3 * k / (s - k)), "s", "K", values={"K": 2.0})
    quotient = (Term(6.0, (), (group(Term(1.0, (s,)), Term(-2.0)),)),)
    assert maximum == factor(Function("max", (power(factor(s), two), quotient)))
    assert tree(lambda s, k: 3 * k / s, "s", "K", values={"K": -0.5}) == (Term(-1.5, (), (s,)),)
    assert tree(lambda s, k: k / s, "s", "K", values={"K": 0.0}) == ()
    assert tree(lambda s, k: k, "s", "K") == factor(Symbol("K"))


def test_an_operation_without_a_sign_of_its_own_is_refused():
    with pytest.raises(ValueError, match="operation -7"):
        _operate(-7, [factor(Symbol("x"))])
