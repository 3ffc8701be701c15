"""Degrees of freedom and covariances of estimates against those of regressions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from greybox.compiled.record_information import colored_errors, independent_numbers


def regression(n, seed):
    """Sensitivities of four parameters and white errors of unit variance; the covariance of the estimate."""
    random = np.random.default_rng(seed)
    J = random.normal(size=(1, 4, n))
    return J, random.normal(size=(1, n)), np.linalg.inv(J[0] @ J[0].T)


def test_initial_states_that_were_fitted_along_are_paid_for():
    """n - s - p degrees of freedom at most, and a variance that is larger by n / (n - s)."""
    n, initial_states, dof, shares = 60, 50, [], []
    for seed in range(12):
        J, e, inverse = regression(n, seed)
        found = colored_errors([J], [e], inverse, np.eye(1), initial_states, 1.0)
        dof.append(found.dof)
        shares.append(np.trace(found.meat @ inverse) / 4)
    assert max(dof) < n - initial_states - 4
    assert min(dof) > 1
    assert np.mean(shares) == pytest.approx(n / (n - initial_states), rel=0.3)


def test_a_record_of_a_few_correlation_times_leaves_as_few_degrees_of_freedom():
    n = 400
    J = np.ones((1, 1, n))
    drift = np.cumsum(np.random.default_rng(1).normal(size=n))
    e = (drift - drift.mean())[None]
    found = colored_errors([J], [e], np.eye(1) / n, np.eye(1) / np.std(e), 1, 1.0)
    assert not found.is_long_enough
    assert found.dof <= max(n / found.correlation_times[0], 1)


def test_numbers_that_say_the_same_count_once():
    assert_allclose(independent_numbers(1000, 2, 3, 1.0), 1000)
    assert_allclose(independent_numbers(1000, 2, 3, 5.0), 200)
    assert independent_numbers(10, 8, 3, 100.0) > 8


def test_a_record_that_is_explained_to_the_last_digit_has_no_errors():
    J, e, inverse = regression(60, 0)
    found = colored_errors([J], [0 * e], inverse, np.eye(1), 1, 1.0)
    assert np.all(found.meat == 0)


def test_times_are_in_seconds_and_degrees_of_freedom_do_not_depend_on_them():
    n = 400
    e = lfilter([1], [1, -0.8], np.random.default_rng(2).normal(size=n))[None]
    J = np.ones((1, 1, n))
    fast, slow = (colored_errors([J], [e], np.eye(1) / n, np.eye(1) / np.std(e), 1, step) for step in (0.01, 1.0))
    assert_allclose(slow.correlation_times, 100 * fast.correlation_times)
    assert (fast.duration, slow.duration) == (pytest.approx(4.0), 400.0)
    assert fast.dof == slow.dof
    assert fast.is_long_enough
    assert_allclose(fast.meat, slow.meat)


@pytest.mark.parametrize("size", [0.03, 1.0, 30.0])
def test_white_errors_of_any_size_leave_no_fewer_degrees_of_freedom(size):
    """Size in units of the stated noise: the parameters take what they would take of white errors of that size."""
    n = 400
    J, e, inverse = regression(n, 1)
    found = colored_errors([J], [size * e], inverse, np.eye(1), 1, 1.0)
    assert n / 4 < found.dof < n  # how well their spectrum is known takes the rest
