"""Complex numbers of numbers and of CasADi expressions, held against numpy."""

import math
import operator

import casadi as ca
import numpy as np
import pytest
from evaluation import evaluate
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_allclose

import greybox as gb
from greybox.modeling.complex_arithmetic import Complex

OPERATORS = [operator.add, operator.sub, operator.mul, operator.truediv]


size = st.floats(0.1, 10)


numbers = st.builds(
    lambda r, angle: complex(r * math.cos(angle), r * math.sin(angle)), size, st.floats(-3, 3)
)


def number(z):
    """The value of a `Complex`, of numbers or of CasADi constants."""
    return evaluate(z.re) + 1j * evaluate(z.im) if isinstance(z.re, ca.SX) else z.re + 1j * z.im


def symbolic(z):
    return Complex(ca.SX(z.real), ca.SX(z.imag))


def close(actual, expected):
    assert_allclose(actual, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    "make", [lambda z: Complex(z.real, z.imag), symbolic], ids=["numbers", "casadi"]
)
@pytest.mark.parametrize("combine", OPERATORS)
@settings(max_examples=15)
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
    close(
        number(Complex(*(ca.substitute(part, p, 4.0) for part in (result.re, result.im)))),
        (2 + 1j) / 4,
    )


@pytest.mark.parametrize("other", ["text", None, np.array(["a"])])
def test_complex_refuses_what_is_no_number(other):
    with pytest.raises(TypeError):
        Complex(1.0, 2.0) + other
