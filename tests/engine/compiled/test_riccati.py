"""The steady filter against Riccati's equation as scipy solves it, and its derivatives against
differences.
"""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad_vec
from scipy.linalg import expm, solve_discrete_are

from greybox.engine.compiled.riccati import (
    NoiseModel,
    reached,
    steady_covariance,
    steady_state_gain,
)

STEP = 0.1
# a, b, coupling of the sensors, w_0, w_1, v_0, v_1: the third is known.
VALUES = np.array([3.0, 0.8, 0.4, 0.5, 1.2, 0.3, 0.2])
ESTIMATED = np.array([True, True, False, True, True, True, True])


def rates(a, b):
    """Of two states that disturb each other, and an integrator beside them that nothing
    disturbs.
    """
    return np.array([[0.0, 1.0, 0.0], [-a, -b, 0.0], [0.0, 0.0, 0.0]])


def noise_model():
    q = ca.MX.sym("q", len(VALUES))
    A = ca.vertcat(ca.horzcat(0, 1, 0), ca.horzcat(-q[0], -q[1], 0), ca.MX.zeros(1, 3))
    F, half = (sum((power(A * h, k) for k in range(1, 12)), ca.MX.eye(3)) for h in (STEP, STEP / 2))
    C = ca.vertcat(ca.horzcat(1, q[2] * q[0], 0.7), ca.horzcat(0, q[1], 0.2))
    places = np.flatnonzero(ESTIMATED).tolist()
    slopes = [ca.densify(ca.jacobian(ca.vec(M), q)[:, places]) for M in (F, half, C)]
    linear = ca.Function("linear", [q], [F, half, C, *slopes])
    return NoiseModel(linear, STEP, np.array([0, 1]), np.array([3, 4]), np.array([5, 6]), ESTIMATED)


def power(A, k):
    """Return the term of order k of the exponential of A."""
    return A @ power(A, k - 1) / k if k > 1 else A


def test_the_filter_of_a_continuous_noise_is_that_of_riccatis_equation():
    """The noise of a sample is an integral, and only the states that it reaches are corrected."""
    a, b, mix, *deviations = VALUES
    w, v = np.diag(np.square(deviations[:2])), np.diag(np.square(deviations[2:]))
    A, C = rates(a, b)[:2, :2], np.array([[1, mix * a], [0, b]])
    F = expm(A * STEP)
    Q = quad_vec(lambda t: expm(A * t) @ w @ expm(A * t).T, 0, STEP)[0]
    P = solve_discrete_are(F.T, C.T, Q, v)
    S = C @ P @ C.T + v
    found = noise_model().at(VALUES)
    assert_allclose(found.covariance, S, rtol=1e-5)
    assert_allclose(found.gain[:2], P @ C.T @ np.linalg.inv(S), rtol=1e-4)
    assert not found.gain[2].any()


def test_its_derivatives_are_those_of_differences():
    model = noise_model()
    found = model.at(VALUES)
    for column, place in enumerate(np.flatnonzero(ESTIMATED)):
        h = 1e-5 * np.eye(len(VALUES))[place]
        above, below = model.at(VALUES + h), model.at(VALUES - h)
        for name in ("gain", "covariance"):
            difference = (getattr(above, name) - getattr(below, name)) / 2e-5
            assert_allclose(
                getattr(found, f"{name}_slope")[:, :, column], difference, rtol=1e-6, atol=1e-9
            )


def test_without_process_noise_nothing_is_corrected():
    found = noise_model().at(np.r_[VALUES[:3], 0, 0, VALUES[5:]])
    assert not found.gain.any()
    assert not found.gain_slope.any()
    assert_allclose(found.covariance, np.diag([0.09, 0.04]))
    slopes = np.zeros((2, 2, 6))
    slopes[0, 0, 4], slopes[1, 1, 5] = 2 * 0.3, 2 * 0.2
    assert_allclose(found.covariance_slope, slopes)


def test_noise_in_one_direction_of_states_of_unlike_sizes():
    """A covariance of rank one, of states a million times as large as one another."""
    F, C = np.array([[0.9, 1e-6], [2e4, 0.5]]), np.array([[1.0, 0.0], [1.0, 1e-6]])
    direction = np.array([1.0, 3e6])
    process = np.outer(direction, direction) * 0.04
    scale = np.diag([1.0, 1e6])
    inverse = np.diag([1.0, 1e-6])
    wanted = scale @ solve_discrete_are(
        (inverse @ F @ scale).T, (C @ scale).T, inverse @ process @ inverse, np.eye(2)
    )
    assert_allclose(steady_covariance(F, C, process), wanted @ scale, rtol=1e-8)


@pytest.mark.parametrize(("growth", "is_steady"), [(1.2, False), (0.8, True)])
def test_what_grows_unseen_has_no_filter(growth, is_steady):
    F, C = np.diag([0.5, growth]), np.array([[1.0, 0.0]])
    assert np.isfinite(steady_covariance(F, C, np.eye(2))).all() == is_steady
    assert np.isfinite(steady_state_gain(F, C, np.ones(2))).all() == is_steady


def test_states_that_noise_reaches_by_way_of_others():
    F = np.array([[1.0, 0, 0, 0], [-0.1, 1, 0, 0], [0, -0.2, 1, 0], [0, 0, 0.3, 1]])
    assert reached(F, np.array([1])).tolist() == [False, True, True, True]
    assert reached(F, np.array([3])).tolist() == [False, False, False, True]
    assert reached(F, np.array([], dtype=int)).tolist() == [False] * 4
