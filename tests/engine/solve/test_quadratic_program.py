"""Small quadratic programs, held against the conditions of optimality and scipy's solvers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear, minimize

from greybox.engine.solve.quadratic_program import solve_small_qp


def made(seed, p=None, general=None, scales=0.0):
    """A random convex program that zero satisfies.

    Bounds on every unknown, and general constraints.
    """
    random = np.random.default_rng(seed)
    p = random.integers(1, 8) if p is None else p
    root = random.normal(size=(p, p))
    hessian, gradient = root.T @ root + 0.01 * np.eye(p), 3 * random.normal(size=p)
    rows = np.vstack(
        [
            np.eye(p),
            -np.eye(p),
            random.normal(size=(random.integers(0, 4) if general is None else general, p)),
        ]
    )
    limits = -random.uniform(0, 1, len(rows)) * random.integers(0, 2, len(rows))
    size = 10.0 ** random.uniform(-scales, scales, p)
    return hessian * size * size[:, None], gradient * size, rows * size, limits


def optimality(hessian, gradient, rows, limits, step):
    """How far the step misses feasibility and stationarity, relative to what adds up in them."""
    from scipy.optimize import nnls

    size = np.linalg.norm(rows, axis=1)
    slack = (rows @ step - limits) / size
    reach = max(np.abs(limits / size).max(), 1e-12)
    unit = 1 / np.sqrt(np.diag(hessian))
    slope = (hessian @ step + gradient) * unit
    active = slack < 1e-7 * max(reach, np.abs(step).max())
    pull = (rows[active] * unit).T
    rest = nnls(pull, slope)[1] if active.any() else np.linalg.norm(slope)
    return max(-slack.min(), 0.0) / reach, rest / np.linalg.norm(gradient * unit)


@pytest.mark.parametrize("scales", [0.0, 3.0])
def test_steps_are_optimal(scales):
    for seed in range(60):
        program = made(seed, scales=scales)
        missed, rest = optimality(*program, solve_small_qp(*program))
        assert missed < 1e-8, seed
        assert rest < 1e-6, seed


def test_bounds_alone_as_scipy_solves_them():
    for seed in range(30):
        random = np.random.default_rng(seed)
        p = random.integers(1, 8)
        A, b = random.normal(size=(20, p)), random.normal(size=20)
        low, high = -random.uniform(0, 0.3, p), random.uniform(0.01, 0.3, p)
        rows, limits = np.vstack([np.eye(p), -np.eye(p)]), np.concatenate([low, -high])
        step = solve_small_qp(A.T @ A, -A.T @ b, rows, limits)
        assert_allclose(step, lsq_linear(A, b, (low, high), tol=1e-14).x, atol=1e-7)


def test_general_constraints_as_scipy_solves_them():
    for seed in range(20):
        hessian, gradient, rows, limits = made(seed, p=4, general=3)

        def value(d, H=hessian, g=gradient):
            return d @ H @ d / 2 + g @ d

        wanted = minimize(
            value,
            np.zeros(4),
            jac=lambda d, H=hessian, g=gradient: H @ d + g,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda d, A=rows, b=limits: A @ d - b,
                "jac": lambda d, A=rows: A,
            },
            options={"ftol": 1e-14, "maxiter": 500},
        )
        step = solve_small_qp(hessian, gradient, rows, limits)
        assert value(step) <= wanted.fun + 1e-9 * max(1, abs(wanted.fun))


def test_without_active_limits_it_is_the_newton_step():
    hessian, gradient, rows, _ = made(1, p=5)
    step = solve_small_qp(hessian, gradient, rows, np.full(len(rows), -1e9))
    assert_allclose(step, np.linalg.solve(hessian, -gradient), rtol=1e-9)


def test_a_parameter_at_its_bound_stays_there_exactly():
    step = solve_small_qp(
        np.diag([1.0, 1e8]), np.array([1.0, 1e4]), np.eye(2), np.array([0.0, -1e9])
    )
    assert_allclose(step, [0, -1e-4], rtol=1e-9, atol=1e-14)


def test_flat_directions_do_not_move():
    hessian = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    step = solve_small_qp(hessian, np.array([-1.0, -1.0, 0.0]), np.zeros((0, 3)), np.zeros(0))
    assert_allclose(step, [0.5, 0.5, 0])


def test_a_flat_direction_moves_where_a_limit_needs_it():
    hessian = np.diag([1.0, 0.0])
    step = solve_small_qp(hessian, np.array([-1.0, 0.0]), np.array([[-1.0, 1.0]]), np.array([0.0]))
    assert step[1] >= step[0] - 1e-9
    assert_allclose(step[0], 1, atol=1e-6)


def test_limits_that_contradict_one_another_are_ignored():
    step = solve_small_qp(
        np.eye(1), np.array([-1.0]), np.array([[1.0], [-1.0]]), np.array([2.0, 1.0])
    )
    assert_allclose(step, [1.0])


@pytest.mark.parametrize(("curvature", "moves"), [(1e-12, True), (1e-14, False)])
def test_directions_are_flat_below_a_part_in_1e13(curvature, moves):
    """Beside a curvature of two, after scaling to a diagonal of one."""
    c = 1 - curvature
    hessian = np.array([[1.0, c], [c, 1.0]])
    step = solve_small_qp(hessian, np.array([-1e-9, 1e-9]), np.zeros((0, 2)), np.zeros(0))
    assert (np.abs(step).max() > 1e-6) == moves


def test_without_any_curvature_a_limit_moves_what_it_needs():
    step = solve_small_qp(np.zeros((2, 2)), np.zeros(2), np.array([[0.0, 2.0]]), np.array([3.0]))
    assert_allclose(step, [0, 1.5])
    negative = solve_small_qp(-np.eye(2), np.zeros(2), np.array([[0.0, 2.0]]), np.array([3.0]))
    assert_allclose(negative, [0, 1.5])
