"""Functions over columns, held against CasADi's own evaluation."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from greybox.engine.compiled.vectorized import CHUNK, Columns, second_order

UNARY = {
    "minus": lambda a: -a,
    "twice": lambda a: 2 * a,
    "square": lambda a: a**2,
    "inverse": lambda a: 1 / a,
    "abs": ca.fabs,
    "not": ca.logic_not,
    **{
        name: getattr(ca, name)
        for name in (
            "exp log sqrt sin cos tan asin acos atan sinh cosh tanh "
            "asinh acosh atanh floor ceil sign log1p expm1"
        ).split()
    },
}
BINARY = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "power": lambda a, b: a**b,
    "constant power": lambda a, b: a**2.5 + b**-3,
    "less": lambda a, b: a < b,
    "less or equal": lambda a, b: a <= b,
    "equal": lambda a, b: a == b,
    "not equal": lambda a, b: a != b,
    "where": lambda a, b: ca.if_else(a > b, a * b, a - b),
    **{
        name: getattr(ca, name)
        for name in "atan2 fmin fmax fmod copysign hypot logic_and logic_or".split()
        if hasattr(ca, name)
    },
}
GRID = np.array([-2.5, -1.0, -0.4, 0.0, 0.3, 1.0, 1.7])
MANY = np.tile(GRID, 128)  # of few columns CasADi takes care
FIRST, SECOND = (v.ravel() for v in np.meshgrid(np.tile(GRID, 4), GRID))


def function(expression, *symbols):
    return ca.Function("f", list(symbols), [expression])


def by_casadi(f, *columns):
    return np.array([f(*values).full().ravel() for values in zip(*columns, strict=True)]).T


@pytest.mark.parametrize("name", UNARY)
def test_every_operation_of_one_number(name):
    x = ca.SX.sym("x")
    f = function(UNARY[name](x), x)
    found = Columns(f)(MANY[None])[0]
    assert_allclose(found, np.tile(by_casadi(f, GRID), 128), rtol=1e-14, equal_nan=True)


@pytest.mark.parametrize("name", BINARY)
def test_every_operation_of_two_numbers(name):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = function(BINARY[name](x, y), x, y)
    found = Columns(f)(FIRST[None], SECOND[None])[0]
    assert_allclose(found, by_casadi(f, FIRST, SECOND), rtol=1e-14, equal_nan=True)
    shared = Columns(f, shared=(1,))(FIRST[None], np.array([0.3]))[0]
    assert_allclose(
        shared, by_casadi(f, FIRST, np.full(FIRST.size, 0.3)), rtol=1e-14, equal_nan=True
    )


def test_an_operation_without_a_numpy_function_is_left_to_casadi():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    f = function(ca.vertcat(ca.erf(x) * y, x[0]), x, y)
    columns = np.vstack([GRID, GRID[::-1]])
    found = Columns(f, shared=(1,))(columns, np.array([2.0]))[0]
    assert_allclose(found, np.array([f(c, 2.0).full().ravel() for c in columns.T]).T)
    one = Columns(f, shared=(1,))(columns[:, :1], np.array([2.0]))[0]
    assert_allclose(one, found[:, :1])


@pytest.mark.parametrize("m", [1, 2, CHUNK - 1, CHUNK, CHUNK + 1, 2 * CHUNK + 7])
def test_any_number_of_columns(m):
    x, q = ca.SX.sym("x", 3), ca.SX.sym("q", 2)
    common = ca.exp(q[0]) * ca.sin(q[1])  # of shared numbers alone
    f = ca.Function(
        "f", [x, q], [ca.vertcat(common * x[0] + x[1], x[2] / q[1]), common, ca.mtimes(x, x.T)]
    )
    columns, shared = np.random.default_rng(m).normal(size=(3, m)), np.array([0.4, -0.7])
    found = Columns(f, shared=(1,))(columns, shared)
    c = np.exp(0.4) * np.sin(-0.7)
    assert_allclose(found[0], [c * columns[0] + columns[1], columns[2] / -0.7])
    assert_allclose(found[1], np.full((1, m), c))
    assert_allclose(found[2].reshape(3, 3, m), columns[:, None] * columns)


def test_calls_do_not_disturb_one_another():
    x, q = ca.SX.sym("x", 2), ca.SX.sym("q")
    y = q**2 + ca.cos(q)
    for _ in range(20):  # registers are used again and again
        y = ca.sin(y * x[0] + q) + x[1] * y
    evaluate, random = Columns(function(y, x, q), shared=(1,)), np.random.default_rng(0)
    kept = []
    for m in (5, 3, 5, 8, 300, 500, 200, 300, 5):
        columns, shared = random.normal(size=(2, m)), random.normal(size=1)
        kept.append((columns, shared, evaluate(columns, shared)[0]))
    for columns, shared, found in kept:
        expected = shared**2 + np.cos(shared)
        for _ in range(20):
            expected = np.sin(expected * columns[0] + shared) + columns[1] * expected
        assert_allclose(found[0], expected, rtol=1e-10)


def test_what_is_not_finite_gives_no_warning():
    x = ca.SX.sym("x")
    found = Columns(function(ca.vertcat(ca.log(x), 1 / x, ca.exp(1e4 * x)), x))(
        np.tile([[0.0, 1.0]], 128)
    )[0]
    assert_allclose(found[:, 0], [-np.inf, np.inf, 1])
    assert np.isinf(found[2, 1])


def test_constants_and_structural_zeros():
    x = ca.SX.sym("x")
    f = ca.Function(
        "f", [x], [ca.densify(ca.vertcat(ca.SX(0), x, ca.SX(3.5))), ca.densify(ca.SX(2, 2))]
    )
    found = Columns(f)(MANY[None])
    assert_allclose(found[0], [0 * MANY, MANY, np.full(MANY.size, 3.5)])
    assert_allclose(found[1], np.zeros((4, MANY.size)))


def test_comparisons_count_as_numbers_where_they_are_calculated_with():
    x = ca.SX.sym("x", 3)
    low, high = x[0] < x[1], x[1] <= x[2]
    both = ca.logic_and(low, ca.logic_not(high))
    values = [
        low + high,
        low - high,
        -low,
        3 * low,
        ca.if_else(both, x[0], x[1] / x[2]),
        ca.sqrt(low) + both,
        high,
    ]
    function = ca.Function("f", [x], [ca.vertcat(*values)])
    points = np.random.default_rng(0).integers(-2, 3, (3, 500)).astype(float)
    [found] = Columns(function)(points)
    assert_allclose(found, function(points).full(), equal_nan=True)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("m", [1, 7, 500])
def test_entries_that_a_function_leaves_out_are_zeros(kind, m):
    """Of the outputs, and of an input of which half is not read."""
    x, given = kind.sym("x", 2), kind.sym("given", ca.Sparsity.lower(2))
    f = ca.Function("f", [x, given], [ca.diag(x * x[0]), given @ x, kind(3, 1)])
    random = np.random.default_rng(m)
    columns, others = random.normal(size=(2, m)), random.normal(size=(4, m))
    squares, product, nothing = Columns(f)(columns, others)
    zeros = np.zeros(m)
    assert_allclose(squares, [columns[0] ** 2, zeros, zeros, columns[0] * columns[1]], rtol=1e-13)
    assert_allclose(
        product,
        [others[0] * columns[0], others[1] * columns[0] + others[3] * columns[1]],
        rtol=1e-13,
    )
    assert_allclose(nothing, np.zeros((3, m)))
    _, shared, _ = Columns(f, shared=(1,))(columns, others[:, 0])
    given = others[:, 0]
    assert_allclose(shared, [given[0] * columns[0], given[1] * columns[0] + given[3] * columns[1]])


@pytest.mark.parametrize("m", [1, 8, 700])
def test_derivatives_of_a_cost_with_data_are_those_by_hand(m):
    z, smoothing, data = ca.SX.sym("z", 2), ca.SX.sym("smoothing"), ca.SX.sym("data", 2)
    cost = data[0] * z[0] ** 2 * z[1] + data[1] * z[1] ** 3 + smoothing
    rng = np.random.default_rng(m)
    x, y = points = rng.uniform(0.1, 1, (2, m))
    a, b = numbers = rng.uniform(1, 2, (2, m))
    smooth = rng.uniform(size=(1, m))
    value, gradient, hessian = second_order([z, smoothing, data], cost)(points, smooth, numbers)
    assert_allclose(value, a * x**2 * y + b * y**3 + smooth, rtol=1e-12)
    assert_allclose(gradient, [2 * a * x * y, a * x**2 + 3 * b * y**2], rtol=1e-12)
    assert_allclose(hessian, [2 * a * y, 2 * a * x, 2 * a * x, 6 * b * y], rtol=1e-12)


def test_a_constant_cost_has_zero_derivatives():
    z, nothing = ca.SX.sym("z", 2), ca.SX(0, 1)
    answer = second_order([z, nothing, nothing], ca.SX(3))(np.ones((2, 1)), *[np.zeros((0, 1))] * 2)
    assert [value.tolist() for value in answer] == [[[3]], [[0], [0]], [[0]] * 4]
