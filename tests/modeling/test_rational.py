"""Rational functions with a delay, held against the values of numpy's polynomials."""

import math
import operator

import casadi as ca
import numpy as np
import pytest
from evaluation import evaluate
from hypothesis import assume, given, settings, strategies as st
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.rational import Rational

OPERATORS = [operator.add, operator.sub, operator.mul, operator.truediv]


size = st.floats(0.1, 10)


numbers = st.builds(
    lambda r, angle: complex(r * math.cos(angle), r * math.sin(angle)), size, st.floats(-3, 3)
)


polynomials = st.lists(st.floats(-10, 10), min_size=1, max_size=4).filter(lambda c: abs(c[0]) > 0.1)


rationals = st.tuples(polynomials, polynomials)


def close(actual, expected):
    assert_allclose(actual, expected, rtol=1e-10, atol=1e-12)


def fraction(form, s):
    """The Rational and its value at s by numpy, unless that is a difference of nearly equal terms."""
    numerator, denominator = (np.polyval(c, s) for c in form)
    sizes = [np.polyval(np.abs(c), abs(s)) for c in form]
    assume(abs(numerator) > 1e-2 * sizes[0] and abs(denominator) > 1e-2 * sizes[1])
    return Rational(*form), numerator / denominator


@pytest.mark.parametrize("combine", OPERATORS)
@settings(max_examples=15)
@given(a=rationals, b=rationals, s=numbers, c=size)
def test_rational_arithmetic_is_that_of_the_values(combine, a, b, s, c):
    (x, p), (y, q) = fraction(a, s), fraction(b, s)
    assert_allclose(combine(x, y)(s), combine(p, q), atol=1e-9 * (abs(p) + abs(q)), rtol=1e-9)
    assert_allclose(combine(x, c)(s), combine(p, c), atol=1e-9 * (abs(p) + c), rtol=1e-9)
    assert_allclose(combine(c, x)(s), combine(c, p), atol=1e-9 * (abs(p) + c), rtol=1e-9)


@given(a=rationals, b=rationals)
def test_rational_products_are_those_of_numpy_polynomials(a, b):
    product = Rational(*a) * Rational(*b)
    assume(len(product.numerator) == len(a[0]) + len(b[0]) - 1)  # nothing canceled
    for mine, factors in ((product.numerator, (a[0], b[0])), (product.denominator, (a[1], b[1]))):
        assert_allclose(
            mine,
            (Polynomial(factors[0][::-1]) * Polynomial(factors[1][::-1])).coef[::-1],
            atol=1e-12,
        )


@given(a=rationals, s=numbers, power=st.integers(-3, 3))
def test_rational_powers_and_signs(a, s, power):
    x, value = fraction(a, s)
    assert_allclose((x**power)(s), value**power, rtol=1e-8)
    assert_allclose((-x)(s), -value, rtol=1e-10)
    assert (+x)(s) == x(s)


def test_rational_coefficients_have_the_highest_power_first():
    s = Rational([1.0, 0.0])
    form = (2 * s + 1) / (s**2 + 3 * s + 5)
    assert (form.numerator, form.denominator, form.delay) == ([2, 1], [1, 3, 5], 0)


def test_rational_cancels_equal_factors_and_keeps_common_denominators():
    s = Rational([1.0, 0.0])
    assert ((s + 2) / (s**2 + 1) * ((s**2 + 1) / (s + 3))).denominator == [1, 3]
    assert (1 / (s + 2) + s / (s + 2)).denominator == [1, 2]
    assert (s - s + 1 / (s + 2)).numerator == [1]


def test_delays_add_in_a_product_and_stay_in_a_sum_of_equals():
    s = Rational([1.0, 0.0])
    a, b = gb.exp(-s * 0.25) / (s + 1), gb.exp(-0.5 * s)
    assert (a * b).delay == 0.75
    assert (a / b).delay == -0.25
    assert (a + a * s).delay == 0.25
    assert (0 * s + a).delay == (a + 0 * s).delay == 0.25
    close((a * b)(2j), np.exp(-1.5j) / (1 + 2j))
    assert gb.exp(-s * 0.0).delay == 0


def test_symbolic_delays_and_coefficients_are_compared_as_expressions():
    s, T = Rational([1.0, 0.0]), ca.SX.sym("T")
    delayed = gb.exp(-s * T)
    total = delayed / (s + T) + s * delayed / (s + T)
    assert len(total.denominator) == 2
    close(evaluate(ca.substitute(total.delay, T, 0.3)), 0.3)
    with pytest.raises(ValueError, match="terms with different delays"):
        delayed + gb.exp(-s * (2 * T))


S = Rational([1.0, 0.0])


NO_RATIONAL_FORM = {
    "loop around a delay": (
        lambda: 1 + gb.exp(-S * 0.1),
        r"different delays .* Padé .* pade=3 .* delay='pade:3'",
    ),
    "fractional power": (
        lambda: S**0.5,
        r"power 0\.5 of s has no rational form: only whole powers have",
    ),
    "square root": (lambda: gb.sqrt(S), r"sqrt of a function of s has no rational form"),
    "sine": (lambda: gb.sin(S), r"sin of a function of s has no rational form"),
    "sine of Complex": (
        lambda: gb.sin(Complex(0.0, 1.0)),
        r"sin of a function of s has no complex form",
    ),
    "exponential of a lag": (
        lambda: gb.exp(1 / (S + 1)),
        r"only exp\(-s T\) with a T that does not depend",
    ),
    "exponential of a square": (lambda: gb.exp(-S * S), r"only exp\(-s T\)"),
    "exponential with an offset": (lambda: gb.exp(-S - 1), r"only exp\(-s T\)"),
}


@pytest.mark.parametrize("name", NO_RATIONAL_FORM)
def test_what_has_no_rational_form_is_said(name):
    formula, sentence = NO_RATIONAL_FORM[name]
    with pytest.raises(ValueError, match=sentence):
        formula()


@pytest.mark.parametrize(
    ("form", "written"),
    [
        ((2 * S + 1) / (S**2 - 3 * S + 5), "2 (s + 0.5) / [(s² - 3 s + 5)]"),
        (S / (S**3 + 0.5 * S**2), "2 s / [s s (2 s + 1)]"),
        (0 * S, "0"),
        (gb.exp(-0.25 * S) / (S + 1), "1 / [(1 s + 1)] exp(-0.25 s)"),
        (Rational([ca.SX.sym("K"), 0.0]), "Rational([SX(K), 0.0], [1.0], 0.0)"),
        (gb.exp(-ca.SX.sym("T") * S), "Rational([1.0], [1.0], T)"),
    ],
)
def test_it_is_written_in_factors(form, written):
    assert str(form) == written


def test_poles_and_zeros_are_the_roots():
    form = (S - 2) * (S + 3) / ((S + 1) ** 2 + 4)
    assert_allclose(np.sort(form.zeros), [-3, 2])
    assert_allclose(form.poles[np.argsort(form.poles.imag)], [-1 - 2j, -1 + 2j])


def test_zero_has_no_degree_and_takes_any_delay():
    zero = Rational([0.0, 0.0])
    assert (zero.numerator, zero.denominator) == ([0.0], [1.0])
    delayed = gb.exp(-0.3 * S) / (S + 1)
    for total in (zero + delayed, delayed + zero, zero * S + delayed):
        assert total.delay == 0.3
        close(total(2j), np.exp(-0.6j) / (1 + 2j))
    assert Rational([0.0, 0.0, 2.0, 0.0], [0.0, 4.0]).numerator == [2.0, 0.0]
    assert Rational([1.0], [0.0, 4.0]).denominator == [4.0]


def test_exponentials_of_lines_through_zero_are_delays():
    assert gb.exp(Rational([-0.5, 0.0], [2.0])).delay == 0.25
    assert gb.exp(Rational([0.0])).delay == 0
    assert gb.exp(-S * ca.SX.sym("T")).numerator == [1.0]
    for wrong in (
        Rational([-1.0, 0.0], [1.0, 1.0]),
        Rational([-1.0, 0.5]),
        Rational([2.0]),
        S * gb.exp(-S),
    ):
        with pytest.raises(
            ValueError, match=r"only exp\(-s T\) with a T that does not depend on s"
        ):
            gb.exp(wrong)


class TwoInputs(gb.StateSpace):
    """Three states, of which the second input acts late and directly."""

    states, inputs, outputs = ("a", "b", "c"), ("early", "late"), ("y", "z")
    delays = {"late": "T"}
    k = gb.Parameter(3.0)
    T = gb.Parameter(0.2, bounds=(0, 1))

    def derivative(self, x, u, p):
        return (-p.k * x.a + u.late, x.a - 2 * x.b + u.early, x.b - x.c)

    def output(self, x, u, p):
        return (x.b + 5 * x.c + 4 * u.late, x.a)


@pytest.mark.parametrize("pade", [None, 2])
def test_an_ode_is_read_by_its_markov_parameters(pade):
    """z is late/(s + k), and y the sum of (s + 6)/((s + 2)(s + 1)) times early + late/(s + k), and 4 late."""
    values, s = {"k": 1.5, "T": 0.3}, np.array([0.4j, 3j, 11j])
    late = np.exp(-0.3 * s)
    if pade:
        late = (1 - 0.15 * s + 0.0075 * s**2) / (1 + 0.15 * s + 0.0075 * s**2)
    slow = (s + 2) * (s + 1)
    wanted = {
        ("late", "z"): late / (s + 1.5),
        ("late", "y"): late * (4 + (s + 6) / ((s + 1.5) * slow)),
        ("early", "y"): (s + 6) / slow,
        ("early", "z"): 0 * s,
    }
    for (input, output), response in wanted.items():
        form = gb.modeling.rational(TwoInputs(), values, input=input, output=output, pade=pade)
        assert_allclose(form(s), response, rtol=1e-9, atol=1e-12)
        assert form.delay == (0.3 if pade is None and input == "late" else 0.0)
