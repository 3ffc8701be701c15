"""A slope and an intercept far from the data: the normal equations hold no digit of what the data determine."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.solve.gauss_newton.sharpening import is_blurred


class Line(gb.StateSpace):
    states, inputs, outputs = (), ("x",), ("y",)
    a = gb.Parameter(0.0, bounds=(-1e9, 1e9))
    b = gb.Parameter(0.0, bounds=(-1e3, 1e3))

    def output(self, x, u, p):
        return (p.a + p.b * u.x,)


@pytest.mark.parametrize("distance", [0.0, 1e3, 1e5, 1e6])
def test_a_line_far_from_its_intercept(distance):
    """Against the closed form, which is well-conditioned around the middle of the data."""
    near = np.linspace(-0.5, 0.5, 30)
    y = 2 + 3 * near + 0.1 * np.random.default_rng(1).normal(size=30)
    slope = near @ y / (near @ near)
    variance = np.sum((y - y.mean() - slope * near) ** 2) / 28
    fit = gb.fit(gb.Problem(Line(), gb.Record(None, {"x": distance + near, "y": y})), starts=3)
    error = np.sqrt(variance / (near @ near))
    assert fit.agreeing == 3
    assert abs(fit.estimate["b"] - slope) < 1e-4 * error
    assert_allclose(fit.standard_error["b"], error, rtol=0.01)


def test_what_counts_as_blurred():
    units = np.diag([1e-6, 1.0, 1e8])
    assert not is_blurred(None)
    assert not is_blurred(units @ (np.eye(3) + 0.9) @ units)  # units do not matter
    assert not is_blurred(np.diag([0.0, 1.0, 2.0]))  # what is not seen at all is another question
    assert is_blurred(np.array([[1.0, 1 - 1e-12], [1 - 1e-12, 1.0]]))
