"""Scaled variables against what each of them is for numbers written out."""

import math

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.compiled.scaling import scaling_of

PARAMETERS = [
    gb.Parameter(0.3, bounds=(-7, 5)),
    gb.Parameter(2.0, bounds=(0.1, 50), scale="log"),
    gb.Parameter(0.3, bounds=(-80, 90), starts=(-4, 3)),
]
X = np.array([[-3.5, 20.0, 6.0], [1.4, 0.5, -1.0]])
Z = np.array([[-0.5, np.log(20), 1.5], [0.2, np.log(0.5), -0.25]])  # in 7, the logarithm, and 4


def test_variables_are_in_units_of_the_start_box_or_logarithms():
    scaling = scaling_of(PARAMETERS)
    assert_allclose(scaling.to_solver(X), Z)
    assert_allclose(scaling.to_parameters(Z), X)
    assert scaling.to_solver(np.array([1.0, 0.0, 1.0]))[1] == -np.inf
    for x, z in zip(X, Z, strict=True):
        assert_allclose(scaling.slope(x), [1 / 7, 1 / x[1], 1 / 4])
        symbols = ca.SX.sym("z", 3)
        assert_allclose(
            ca.Function("x", [symbols], [ca.vertcat(*scaling.expressions(symbols))])(z)
            .full()
            .ravel(),
            x,
        )


@pytest.mark.parametrize(
    ("parameter", "unit"),
    [
        (gb.Parameter(-0.3, bounds=(-7, 5), starts=(-2, 1)), 2.0),
        (gb.Parameter(0.3, bounds=(0, 5)), 5.0),  # an end at zero says nothing of the size
        (gb.Parameter(0.3, bounds=(-7, 5), starts=(0, 0)), 7.0),
        (gb.Parameter(-0.3, bounds=(-math.inf, 0)), 0.3),
        (gb.Parameter(0.0), 1.0),
    ],
)
def test_the_unit_is_the_larger_end_in_magnitude_of_what_starts_are_drawn_from(parameter, unit):
    assert scaling_of([parameter]).factor.tolist() == [unit]
