"""The Padé approximation of a delay, held against its definition, in every reading."""

import math

import casadi as ca
import numpy as np
import pytest
from evaluation import evaluate
from numpy.testing import assert_allclose
from pade_by_definition import pade
from scipy.integrate import solve_ivp

import greybox as gb
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.pade_delay import (
    delay_order,
    pade_coefficients,
    pade_rows,
    pade_steady,
    pade_step,
)
from greybox.modeling.rational import Rational


def number(z):
    """The value of a `Complex`, of numbers or of CasADi constants."""
    return evaluate(z.re) + 1j * evaluate(z.im) if isinstance(z.re, ca.SX) else z.re + 1j * z.im


def close(actual, expected):
    assert_allclose(actual, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_pade_coefficients_match_the_taylor_series(order):
    taylor = [1 / math.factorial(k) for k in range(2 * order + 1)]
    p, q = pade(taylor, order)
    coefficients = np.array(pade_coefficients(order))
    assert_allclose(coefficients, p.coef / p.coef[0], rtol=1e-6)
    assert_allclose(coefficients * (-1.0) ** np.arange(order + 1), q.coef / p.coef[0], rtol=1e-6)


@pytest.mark.parametrize("order", [1, 3])
def test_pade_delay_is_the_same_in_numbers_casadi_and_rational_form(order):
    omega, T = np.array([0.5, 3.0, 20.0]), 0.07
    c = pade_coefficients(order)[::-1]
    expected = np.polyval(c, -1j * omega * T) / np.polyval(c, 1j * omega * T)
    close(number(gb.exp(-Complex(np.zeros(3), omega, order) * T)), expected)
    close(number(gb.exp(-Complex(ca.SX.zeros(3), ca.SX(omega), order) * T)), expected)
    form = gb.exp(-Rational([1.0, 0.0], pade=order) * T)
    assert form.delay == 0
    assert len(form.numerator) == len(form.denominator) == order + 1
    close(form(1j * omega), expected)


def test_pade_delay_of_a_symbolic_time_has_symbolic_coefficients():
    T = ca.SX.sym("T")
    form = gb.exp(-Rational([1.0, 0.0], pade=2) * T)
    known = gb.exp(-Rational([1.0, 0.0], pade=2) * 0.3)
    for mine, wanted in ((form.numerator, known.numerator), (form.denominator, known.denominator)):
        close(evaluate(ca.substitute(ca.vertcat(*mine), T, 0.3)), wanted)


def test_pade_makes_a_loop_around_a_delay_rational():
    s = Rational([1.0, 0.0], pade=3)
    loop = gb.exp(-s * 0.1) / s
    close((loop / (1 + loop))(0.5j), 1 / (0.5j * np.exp(0.05j) + 1))


@pytest.mark.parametrize(("word", "order"), [("exact", None), ("pade:1", 1), ("pade:12", 12)])
def test_delay_words(word, order):
    assert delay_order(word) == order


@pytest.mark.parametrize("order", [1, 2, 3, 6])
def test_the_states_have_the_response_and_rest_where_the_input_does(order):
    """x' = A x + B u with the delayed input C x + D u, read off column by column."""
    T = 0.3
    unit = np.eye(order + 1)
    columns = [pade_rows(list(row[:order]), row[order], T, order) for row in unit]
    output, rates = (
        np.array([column[0] for column in columns]),
        np.array([column[1] for column in columns]).T,
    )
    s = 1j * np.array([0.2, 3.0, 40.0])
    found = [
        output[:order] @ np.linalg.solve(v * np.eye(order) - rates[:, :order], rates[:, order])
        for v in s
    ]
    c = pade_coefficients(order)[::-1]
    close(np.array(found) + output[order], np.polyval(c, -s * T) / np.polyval(c, s * T))

    delayed, rest = pade_rows(pade_steady(1.7, order), 1.7, T, order)
    assert delayed == pytest.approx(1.7)
    assert rest == pytest.approx(np.zeros(order), abs=1e-9)
    x, u, delay = ca.SX.sym("x", order), ca.SX.sym("u"), ca.SX.sym("T")
    late, rows = pade_rows(ca.vertsplit(x), u, delay, order)
    symbolic = ca.Function("pade", [x, u, delay], [late, ca.vertcat(*rows)])
    point = np.linspace(-1, 1, order)
    delayed, rest = symbolic(point, 0.4, T)
    wanted = pade_rows(list(point), 0.4, T, order)
    assert float(delayed) == pytest.approx(wanted[0])
    assert rest.full().ravel() == pytest.approx(wanted[1])


def stepped(order):
    """The exact step of the states, as a function of numbers."""
    x, rest = ca.SX.sym("x", order), [ca.SX.sym(name) for name in ("u", "slope", "T", "h")]
    results = pade_step(x, *rest)
    slopes = ca.jacobian(ca.vertcat(*results), rest[2])
    return ca.Function("step", [x, *rest], [*results, slopes])


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("delay", [0.004, 0.1, 3.0])
@pytest.mark.parametrize("slope", [0.0, 7.0])
def test_a_step_is_that_of_a_fine_integration(order, delay, slope):
    """The line has the first two moments of the delayed input over the step."""
    x, h, u = np.linspace(0.5, -1, order), 0.1, 0.4

    def rates(t, state):
        late, rows = pade_rows(list(state[:order]), u + slope * t, delay, order)
        return [*rows, late / h, 12 * (t / h - 0.5) * late / h]

    fine = solve_ivp(rates, (0, h), [*x, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    end, begin, rise, _ = stepped(order)(x, u, slope, delay, h)
    exact = ca.vertcat(end, begin + rise * h / 2, rise * h)
    assert_allclose(exact.full().ravel(), fine, rtol=0, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_without_a_delay_the_input_passes_and_its_derivative_is_finite(order):
    step = stepped(order)
    *values, slopes = (value.full() for value in step(np.ones(order), 0.4, 7.0, 0.0, 0.1))
    assert_allclose(np.vstack(values).ravel(), [*pade_steady(1.1, order), 0.4, 7.0])
    *almost, _ = (value.full() for value in step(np.ones(order), 0.4, 7.0, 1e-9, 0.1))
    assert_allclose(slopes, (np.vstack(almost) - np.vstack(values)) / 1e-9, rtol=1e-4, atol=1e-3)
