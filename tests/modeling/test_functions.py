"""One formula, several readings: complex numbers and polynomials against numpy, Padé against scipy."""

import math
import operator

import casadi as ca
import numpy as np
import pytest
from evaluation import evaluate
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.testing import assert_allclose
from scipy.interpolate import pade

import greybox as gb
from greybox.modeling.complex_arithmetic import Complex
from greybox.modeling.pade_delay import pade_coefficients
from greybox.modeling.rational import Rational

settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")

OPERATORS = [operator.add, operator.sub, operator.mul, operator.truediv]
size = st.floats(0.1, 10)
numbers = st.builds(lambda r, angle: complex(r * math.cos(angle), r * math.sin(angle)), size, st.floats(-3, 3))
polynomials = st.lists(st.floats(-10, 10), min_size=1, max_size=4).filter(lambda c: abs(c[0]) > 0.1)
rationals = st.tuples(polynomials, polynomials)


def number(z):
    """The value of a `Complex`, of numbers or of CasADi constants."""
    return evaluate(z.re) + 1j * evaluate(z.im) if isinstance(z.re, ca.SX) else z.re + 1j * z.im


def symbolic(z):
    return Complex(ca.SX(z.real), ca.SX(z.imag))


def close(actual, expected):
    assert_allclose(actual, expected, rtol=1e-10, atol=1e-12)


# --- Complex


@pytest.mark.parametrize("make", [lambda z: Complex(z.real, z.imag), symbolic], ids=["numbers", "casadi"])
@pytest.mark.parametrize("combine", OPERATORS)
@given(a=numbers, b=numbers, c=size)
def test_complex_arithmetic_is_that_of_numpy(make, combine, a, b, c):
    close(number(combine(make(a), make(b))), combine(a, b))
    for other in (b, c, np.float64(c), 3):
        close(number(combine(make(a), other)), combine(a, other))
        close(number(combine(other, make(a))), combine(other, a))


@pytest.mark.parametrize("combine", OPERATORS)
def test_complex_columns_meet_numpy_arrays_from_both_sides(combine):
    a, b = np.array([1 + 2j, -0.5j, 3]), np.array([2 - 1j, 4, -1 + 1j])
    z = Complex(a.real, a.imag)
    close(number(combine(z, b)), combine(a, b))
    close(number(combine(b, z)), combine(b, a))


@given(z=numbers, power=st.integers(-5, 5), fraction=st.floats(-2.5, 2.5))
def test_complex_functions_are_those_of_numpy(z, power, fraction):
    w = symbolic(z)
    close(number(w**power), z**power)
    close(number(w ** float(power)), z**power)
    close(number(w**fraction), z**fraction)
    close(number(-w), -z)
    close(number(+w), z)
    close(evaluate(abs(w)), abs(z))
    for function, reference in ((gb.exp, np.exp), (gb.log, np.log), (gb.sqrt, np.sqrt)):
        close(number(function(w)), reference(z))


def test_complex_meets_casadi_expressions():
    p = ca.SX.sym("p")
    result = (p + 1j * Complex(1.0, 2.0)) / p
    close(number(Complex(*(ca.substitute(part, p, 4.0) for part in (result.re, result.im)))), (2 + 1j) / 4)


@pytest.mark.parametrize("other", ["text", None, np.array(["a"])])
def test_complex_refuses_what_is_no_number(other):
    with pytest.raises(TypeError):
        Complex(1.0, 2.0) + other


# --- Rational


def fraction(form, s):
    """The Rational and its value at s by numpy, unless that is a difference of nearly equal terms."""
    numerator, denominator = (np.polyval(c, s) for c in form)
    sizes = [np.polyval(np.abs(c), abs(s)) for c in form]
    assume(abs(numerator) > 1e-2 * sizes[0] and abs(denominator) > 1e-2 * sizes[1])
    return Rational(*form), numerator / denominator


@pytest.mark.parametrize("combine", OPERATORS)
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
        assert_allclose(mine, (Polynomial(factors[0][::-1]) * Polynomial(factors[1][::-1])).coef[::-1], atol=1e-12)


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
    "fractional power": (lambda: S**0.5, r"power 0\.5 of s has no rational form: only whole powers have"),
    "square root": (lambda: gb.sqrt(S), r"sqrt of a function of s has no rational form"),
    "sine": (lambda: gb.sin(S), r"sin of a function of s has no rational form"),
    "sine of Complex": (lambda: gb.sin(Complex(0.0, 1.0)), r"sin of a function of s has no complex form"),
    "exponential of a lag": (lambda: gb.exp(1 / (S + 1)), r"only exp\(-s T\) with a T that does not depend"),
    "exponential of a square": (lambda: gb.exp(-S * S), r"only exp\(-s T\)"),
    "exponential with an offset": (lambda: gb.exp(-S - 1), r"only exp\(-s T\)"),
}


@pytest.mark.parametrize("name", NO_RATIONAL_FORM)
def test_what_has_no_rational_form_is_said(name):
    formula, sentence = NO_RATIONAL_FORM[name]
    with pytest.raises(ValueError, match=sentence):
        formula()


# --- Padé


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_pade_coefficients_are_those_of_scipy(order):
    taylor = [1 / math.factorial(k) for k in range(2 * order + 1)]
    p, q = pade(taylor, order)
    coefficients = np.array(pade_coefficients(order))
    assert_allclose(coefficients, p.coeffs[::-1] / p[0], rtol=1e-6)
    assert_allclose(coefficients * (-1.0) ** np.arange(order + 1), q.coeffs[::-1] / p[0], rtol=1e-6)


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


# --- functions of numbers and CasADi expressions


@pytest.mark.parametrize(
    "name", ["exp", "log", "sqrt", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "tanh", "sign"]
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
