"""The functions of formulas give numpy's values for numbers and for CasADi expressions."""

import casadi as ca
import numpy as np
import pytest
from evaluation import evaluate
from numpy.testing import assert_allclose

import greybox as gb


def close(actual, expected):
    assert_allclose(actual, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    "name",
    ["exp", "log", "sqrt", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "tanh", "sign"],
)
def test_functions_give_the_numpy_value_in_both_readings(name):
    function, reference, x = getattr(gb, name), getattr(np, name), np.array([0.2, 0.7])
    assert np.array_equal(function(x), reference(x))
    close(evaluate(function(ca.SX(x))), reference(x))
    close(np.asarray(function(ca.DM(x))).ravel(), reference(x))
    assert function.__name__ == name


@pytest.mark.parametrize("name", ["arctan2", "minimum", "maximum"])
@pytest.mark.parametrize(("a", "b"), [(0.3, -2.0), (-1.0, 0.5)])
def test_functions_of_two_arguments(name, a, b):
    function, expected = getattr(gb, name), getattr(np, name)(a, b)
    assert function(a, b) == expected
    for x, y in ((ca.SX(a), ca.SX(b)), (ca.SX(a), b), (a, ca.SX(b))):
        close(evaluate(function(x, y)), expected)


@pytest.mark.parametrize("x", [-1.0, 2.0])
def test_where_chooses_in_both_readings(x):
    expected = 3 * x if x > 0 else -x
    assert gb.where(x > 0, 3 * x, -x) == expected
    close(evaluate(gb.where(ca.SX(x) > 0, 3 * ca.SX(x), -ca.SX(x))), expected)
    close(evaluate(gb.where(x > 0, ca.SX(3 * x), -x)), expected)
