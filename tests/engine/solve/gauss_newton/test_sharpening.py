"""A slope and an intercept far from the data.

The normal equations hold no digit of what the data determine.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.engine.solve.gauss_newton.iterate import Step
from greybox.engine.solve.gauss_newton.polishing import is_blurred, sharp_step


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


@pytest.mark.parametrize(("least", "blurred"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_hessian_is_blurred_from_a_part_in_1e9(least, blurred):
    """Of the eigenvalues of that with unit diagonal, 1 ± c.

    A parameter without any curvature does not count.
    """
    c = (1 - least) / (1 + least)
    size = np.array([1e4, 1e-3, 0.0])
    hessian = np.array([[1.0, c, 0.0], [c, 1.0, 0.0], [0.0, 0.0, 0.0]]) * size * size[:, None]
    assert is_blurred(hessian) is blurred


def solved(jacobians, gradients, weights, breads, slope):
    """The sharp step of parts whose Jacobians by the parameters are stated, the last column one of a constant."""

    def part(J, weight, bread):
        information = SimpleNamespace(jacobian=J, spread=lambda known: (bread * known, None))

        def informed(names, values, others, trajectory, scale):
            assert (names, values.tolist(), others) == (("a", "b", "c"), [6.0, -20.0, 9.0], ())
            np.testing.assert_array_equal(scale, slope)
            return information

        return SimpleNamespace(weight=weight, information=informed)

    nlp = SimpleNamespace(
        free=("a", "b"),
        names=("a", "b", "c"),
        scaling=SimpleNamespace(
            to_parameters=lambda z: z * 2 * np.array([1, -1]), slope=lambda x: slope
        ),
        all_values=lambda x: np.append(x, 9.0),
        parts=[part(*each) for each in zip(jacobians, weights, breads, strict=True)],
    )
    groups = SimpleNamespace(split=lambda trajectories: [None] * len(weights))
    parts = SimpleNamespace(nlp=nlp, weights=weights, groups=groups)
    condensed = [SimpleNamespace(gradient=g) for g in gradients]
    gradient = sum(weight * each for weight, each in zip(weights, gradients, strict=True))
    step = Step((), condensed, np.zeros(2), 0.0, 0.0, gradient, np.eye(2), (), 0.0)
    iterate = SimpleNamespace(z=np.array([3.0, 10.0]), trajectories=())
    return sharp_step(parts, iterate, step)


def test_a_sharp_step_is_newtons_of_the_sum_of_squares():
    random = np.random.default_rng(2)
    jacobians = [random.normal(size=(n, 3)) * [1.0, 50.0, 1.0] for n in (6, 4)]
    gradients, weights, breads = (
        [np.array([1.0, -70.0]), np.array([0.5, 20.0])],
        [2.0, 3.0],
        [0.25, 7.0],
    )
    slope = np.array([2.0, 0.1])
    step = solved(jacobians, gradients, weights, breads, slope)
    hessian = sum(
        w * b * (J[:, :2] / slope).T @ (J[:, :2] / slope)
        for J, w, b in zip(jacobians, weights, breads, strict=True)
    )
    gradient = 2 * gradients[0] + 3 * gradients[1]
    dz = -np.linalg.solve(hessian, gradient)
    assert_allclose(step.dz, dz)
    assert step.decrease == pytest.approx(-gradient @ dz / 2)
    assert step.distance == step.decrease
    assert step.condensed[0].gradient is gradients[0]


@pytest.mark.parametrize(("angle", "seen"), [(3e-8, True), (0.9e-8, False)])
def test_directions_are_seen_whose_squares_are_lost(angle, seen):
    """Of two columns at an angle, the singular values are as 2 to the angle.

    Below 1e-8 a direction is rounding.
    """
    J = np.array([[1.0, 1.0, 0.0], [0.0, angle, 0.0], [0.0, 0.0, 0.0]])
    right = np.array([0.0, 0.2 * angle])  # what b alone explains, with as much less of a
    gradient = -J[:2, :2].T @ right
    step = solved([J], [gradient], [1.0], [1.0], np.ones(2))
    wanted = [-0.2, 0.2] if seen else [0, 0]
    assert_allclose(step.dz, wanted, atol=0.01)
