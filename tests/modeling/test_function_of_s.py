"""Powers and polynomials in the arithmetic of any type, against numpy."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, strategies as st

from greybox.modeling.function_of_s import is_casadi, is_whole, polynomial_value, whole_power


@given(base=st.floats(0.5, 2), power=st.integers(-9, 9))
def test_powers_are_repeated_products(base, power):
    assert whole_power(base, power, 1.0) == pytest.approx(base**power, rel=1e-13)


@given(
    coefficients=st.lists(st.floats(-5, 5), min_size=1, max_size=6),
    re=st.floats(-2, 2),
    im=st.floats(-2, 2),
)
def test_polynomials_are_those_of_numpy(coefficients, re, im):
    s = complex(re, im)
    assert polynomial_value(coefficients, s) == pytest.approx(
        np.polyval(coefficients, s), rel=1e-12, abs=1e-12
    )


def test_types_are_told_apart():
    assert [is_whole(p) for p in (2, 2.0, np.int64(3), np.float64(-1.0), 0.5, "2", None)] == [
        True
    ] * 4 + [False] * 3
    assert [is_casadi(v) for v in (ca.SX.sym("x"), ca.MX.sym("x"), ca.DM(1), 1.0, np.ones(2))] == [
        True
    ] * 3 + [False] * 2
