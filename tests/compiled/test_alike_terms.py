"""Sums of terms of one form against CasADi's own derivatives of the sum, and the table of
constants by hand.
"""

import casadi as ca
import numpy as np
import pytest

from greybox.compiled.alike_terms import SecondOrder, grouped, summands

OMEGA = np.array(
    [0.5, 1.0, 2.0, 3.0, 5.0, 8.0, 13.0]
)  # at one a product is simplified: a term of another form
NONE = ca.SX(0, 1)
MEASURED = 0.03 * np.array([9, 8, -4, 3, 1, -2, 0.5])


def cost(z, smoothing):
    """Return a sum of roots, weighted and shifted, and a term of its own."""
    terms = [
        ca.sqrt((z[0] * ca.exp(-w * z[1]) - y) ** 2 + smoothing)
        for w, y in zip(OMEGA, MEASURED, strict=True)
    ]
    return 2 * (sum(terms[:4]) - 0.5 * sum(terms[4:])) + z[2] ** 4 - 3


@pytest.mark.parametrize("m", [1, 8, 5000])
@pytest.mark.parametrize("copies", [1, 30])
def test_derivatives_are_those_of_the_sum(m, copies):
    """Of a small sum, and of one whose terms are grouped."""
    z, smoothing = ca.SX.sym("z", 3), ca.SX.sym("smoothing")
    whole = sum(cost(z + 0.1 * k, smoothing) for k in range(copies))
    hessian, gradient = ca.hessian(whole, z)
    expected = ca.Function(
        "expected", [z, smoothing], [whole, gradient, ca.vec(ca.densify(hessian))]
    )
    rng = np.random.default_rng(m)
    points, smooth = rng.uniform(0.1, 1, (3, m)), rng.uniform(1e-6, 1e-2, (1, m))
    found = SecondOrder([z, smoothing, NONE], whole)(points, smooth, np.zeros((0, m)))
    for k in {0, m // 2, m - 1}:
        for value, known in zip(found, expected(points[:, k], smooth[:, k]), strict=True):
            assert value.reshape(-1, m)[:, k] == pytest.approx(
                np.asarray(known).ravel(), rel=1e-12, abs=1e-12
            )


def test_terms_of_one_form_differ_in_their_constants():
    z, smoothing = ca.SX.sym("z", 3), ca.SX.sym("smoothing")
    [alike], rest = grouped([z, smoothing, NONE], cost(z, smoothing))
    assert alike.constants.shape == (
        3,
        6,
    )  # factor, frequency and measurement; without the frequency of one
    rows = [sorted(np.abs(row)) for row in alike.constants]
    assert sorted(alike.constants[0]) == [-1, -1, -1, 2, 2, 2]
    assert [0.5, 2, 3, 5, 8, 13] in rows
    assert sorted(np.abs(MEASURED[OMEGA != 1])) in rows
    at_zero = ca.Function("rest", [z, smoothing], [rest])([1, 0, 2], 0)
    assert float(at_zero) == pytest.approx(2 * (1 - 0.24) + 16 - 3)


def test_a_cost_without_alike_terms_and_a_constant_one():
    z = ca.SX.sym("z", 2)
    point, nothing = np.array([[1.0], [2.0]]), [np.zeros((0, 1))] * 2
    value, gradient, hessian = SecondOrder([z, NONE, NONE], z[0] ** 2 * z[1])(point, *nothing)
    assert (*value, *gradient[:, 0]) == (2, 4, 1)
    assert hessian[:, 0].tolist() == [4, 2, 2, 0]
    constant = SecondOrder([z, NONE, NONE], ca.SX(3))(point, *nothing)
    assert [v.tolist() for v in constant] == [[3], [[0], [0]], [[0]] * 4]


def test_terms_and_factors_of_sums_differences_multiples_and_shares():
    x = ca.SX.sym("x", 5)
    a, b, c, d, e = (ca.sin(x[k]) for k in range(5))
    whole = -((a - (b / 4 + 2 * (c - 3 * d))) / 5 + e / b)
    assert whole.is_op(ca.OP_NEG)
    found = [(factor, ca.Function("term", [x], [term])) for factor, term in summands(whole)]
    point = np.array([0.3, 0.7, 1.1, 1.9, 2.3])
    s = np.sin(point)
    wanted = {s[0]: -1 / 5, s[1]: 1 / 20, s[2]: 2 / 5, s[3]: -6 / 5, s[4] / s[1]: -1.0}
    assert {float(term(point)): factor for factor, term in found} == pytest.approx(wanted)


@pytest.mark.parametrize("m", [1, 8, 700])
def test_terms_of_one_form_read_their_data_at_other_places(m):
    """Data of each column; one term of another form reads some, too."""
    z, smoothing, data = ca.SX.sym("z", 2), ca.SX.sym("smoothing"), ca.SX.sym("data", 15)
    terms = [
        data[k] ** 2 * ca.exp(-w * z[1]) * data[7 + k] + z[0] ** 2 * data[k] + smoothing
        for k, w in enumerate(OMEGA)
    ]
    whole = sum(terms) + ca.sin(z[0] * data[14])
    groups, _ = grouped([z, smoothing, data], whole)
    assert sum(len(group.constants.T) for group in groups) > 10
    hessian, gradient = ca.hessian(whole, z)
    outputs = [whole, gradient, ca.vec(hessian)]
    expected = ca.Function("expected", [z, smoothing, data], outputs)
    rng = np.random.default_rng(m)
    inputs = rng.uniform(size=(2, m)), rng.uniform(size=(1, m)), rng.uniform(1, 2, (15, m))
    found = SecondOrder([z, smoothing, data], whole)(*inputs)
    for k in {0, m // 2, m - 1}:
        known = expected(*(value[:, k] for value in inputs))
        for value, exact in zip(found, known, strict=True):
            assert value.reshape(-1, m)[:, k] == pytest.approx(exact.full().ravel(), rel=1e-12)
