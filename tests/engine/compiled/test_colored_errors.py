"""Degrees of freedom and covariances of estimates against those of regressions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from unit_directions import by_parameters

from greybox.engine.compiled.colored_errors import colored_errors, independent_numbers
from greybox.statistics.colored_information import colored_information


def regression(n, seed):
    """Sensitivities of four parameters and white errors of unit variance; the covariance of the
    estimate.
    """
    random = np.random.default_rng(seed)
    J = random.normal(size=(1, 4, n))
    return J, random.normal(size=(1, n)), np.linalg.inv(J[0] @ J[0].T)


def test_initial_states_that_were_fitted_along_are_paid_for():
    """n - s - p degrees of freedom at most, and a variance that is larger by n / (n - s)."""
    n, initial_states, dof, shares = 60, 50, [], []
    for seed in range(12):
        J, e, inverse = regression(n, seed)
        found = by_parameters(colored_errors, [J], [e], inverse, np.eye(1), initial_states)
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
    found = by_parameters(colored_errors, [J], [e], np.eye(1) / n, np.eye(1) / np.std(e), 1)
    evidence, lines = found.slow_errors()[:, 0]
    assert evidence > 100
    assert lines < 2  # the only parameter is a constant
    assert found.dof <= 3


def test_numbers_that_say_the_same_count_once():
    assert_allclose(independent_numbers(1000, 2, 3, 1.0), 1000)
    assert_allclose(independent_numbers(1000, 2, 3, 5.0), 200)
    assert independent_numbers(10, 8, 3, 100.0) > 8


def test_a_record_that_is_explained_to_the_last_digit_has_no_errors():
    J, e, inverse = regression(60, 0)
    found = by_parameters(colored_errors, [J], [0 * e], inverse, np.eye(1), 1)
    assert np.all(found.meat == 0)


def test_slow_errors_are_evident_beside_a_parameter_that_is_slow():
    n = 400
    e = lfilter([1], [1, -0.8], np.random.default_rng(2).normal(size=n))[None]
    J = np.ones((1, 1, n))
    found = by_parameters(colored_errors, [J], [e], np.eye(1) / n, np.eye(1) / np.std(e), 1)
    evidence, lines = found.slow_errors()[:, 0]
    assert evidence > 100
    assert lines < 2  # the only parameter is a constant


@pytest.mark.parametrize("size", [0.03, 1.0, 30.0])
def test_white_errors_of_any_size_leave_no_fewer_degrees_of_freedom(size):
    """Size in units of the stated noise: the parameters take what they would take of white
    errors of that size.
    """
    n = 400
    J, e, inverse = regression(n, 1)
    found = by_parameters(colored_errors, [J], [size * e], inverse, np.eye(1), 1)
    assert n / 4 < found.dof < n  # how well their spectrum is known takes the rest


@pytest.mark.parametrize("longest", [50_000, 100])
def test_an_estimate_pays_for_what_it_takes_from_correlated_errors(longest, monkeypatch):
    """Two stretches of two outputs whose covariance is not diagonal, with what other data tell of the parameters.

    Parameters that take more of these errors than of white ones leave as many times fewer
    independent numbers; of a long record, whose spectrum does not allow for what the fit took, the
    variance is larger by it instead.
    """
    monkeypatch.setattr("greybox.statistics.residual_spectrum.LONGEST_CORRECTED", longest)
    random, initial_states = np.random.default_rng(4), 3
    weight = np.array([[2.0, 0.0], [-0.7, 1.5]])
    residuals = [0.9 * lfilter([1], [1, -0.8], random.normal(size=(2, n))) for n in (150, 90)]
    residuals[0][1, 20:40] = 0.0
    J = [random.normal(size=(2, 3, n)).cumsum(axis=2) / np.sqrt(n) for n in (150, 90)]
    weighted = [np.einsum("ka,apn->kpn", weight.T @ weight, each) for each in J]
    bread = sum(np.einsum("kpn,ka,aqn->pq", each, weight.T @ weight, each) for each in J)
    inverse = np.linalg.inv(bread + np.diag([0.5, 1.0, 2.0]) * np.diag(bread))
    found = by_parameters(colored_errors, weighted, residuals, inverse, weight, initial_states)

    told = by_parameters(
        colored_information, weighted, residuals, inverse, np.linalg.inv(weight.T @ weight)
    )
    assert told.corrected is (longest > 100)
    numbers = 2 * 240 - 20
    paid = np.trace(inverse @ bread)
    white = sum(((weight @ e) ** 2).sum() for e in residuals) / numbers
    times = told.taken / (paid * white)
    assert 1 < times < numbers / (initial_states + paid + 4)
    independent = numbers / times
    larger = independent / (independent - initial_states)
    left = independent - initial_states - paid
    if longest == 100:
        larger *= 1 + paid / left
    assert_allclose(found.meat, larger * told.meat)
    limit = 2 * told.correlation_times.max() / 240
    assert_allclose(1 / found.dof, max(1 / left + told.uncertainty / 2, limit))
    assert_allclose(found.spectrum.deviation, np.sqrt(larger) * told.spectrum.deviation)


def test_outputs_that_are_almost_dependent_have_the_errors_of_their_combinations():
    """As an acceleration that is measured beside the states and inputs from which it follows."""
    n, random = 300, np.random.default_rng(9)
    jumps = np.stack([0.9 ** np.arange(n), 0.5 * 0.8 ** np.arange(n)])[:, None]
    e = random.normal(size=(2, n)) + lfilter([1], [1, -0.9], random.normal(size=n))
    J, X = random.normal(size=(2, 3, n)), random.normal(size=(2, 1, n))
    inverse = np.linalg.inv(np.einsum("kpn,kqn->pq", J, J))
    X /= np.sqrt(np.sum(X**2))
    apart = by_parameters(
        colored_errors, [J], [e], inverse, np.eye(2), 1, initial=[X], shocks=lambda: jumps
    )

    mixing = np.array([[1.0, 0.0], [1.0, 1e-5]])
    weight = np.linalg.inv(mixing)
    mixed = by_parameters(
        colored_errors,
        [np.tensordot(weight.T, J, 1)],
        [mixing @ e],
        inverse,
        weight,
        1,
        initial=[np.tensordot(weight.T, X, 1)],
        shocks=lambda: np.tensordot(mixing, jumps, 1),
    )
    assert_allclose(mixed.meat, apart.meat, rtol=1e-6)
    assert mixed.dof == pytest.approx(apart.dof, rel=1e-6)
    assert mixed.process_noise() == pytest.approx(apart.process_noise(), rel=1e-6)
    assert_allclose(mixed.spectrum.deviation[1], mixed.spectrum.deviation[0], rtol=1e-9)


def test_half_of_the_correlation_times_are_the_most_degrees_of_freedom():
    n, e = 300, np.random.default_rng(7).normal(size=300)
    J, limits = np.ones((1, 1, n)), []
    for pole in np.arange(0.86, 0.9, 0.004):
        errors = lfilter([1], [1, -pole], e)[None]
        size = np.eye(1) / np.std(errors)
        found = by_parameters(colored_errors, [J], [errors], np.eye(1) / n, size, 1)
        told = by_parameters(colored_information, [J], [errors], np.eye(1) / n, 1 / size**2)
        limits.append(n / told.correlation_times[0] / 2)
        assert 1 <= found.dof <= limits[-1] + 1e-9
    assert min(limits) < 6 < max(limits)


def test_independent_numbers_are_no_fewer_than_a_variance_needs():
    """Four more than the initial states and the parameters, if there are as many; half a one
    more than the former.
    """
    assert independent_numbers(100, 3, 5, 7.0) == pytest.approx(100 / 7)
    assert independent_numbers(100, 3, 5, 9.0) == pytest.approx(3 + 5 + 4)
    assert independent_numbers(11, 3, 5, 9.0) == 11
    assert independent_numbers(3, 8, 2, 5.0) == 8.5


@pytest.mark.parametrize("rounding", [-1e-15, 1e-15])
def test_rounding_of_the_inverse_does_not_change_the_errors(rounding):
    """One parameter of one record pays exactly one number; a bit more must not count as two."""
    n = 120
    errors = lfilter([1], [1, -0.98], np.random.default_rng(3).normal(size=n))[None]
    deviation = np.std(errors)
    J, weight = np.ones((1, 1, n)) / deviation**2, np.eye(1) / deviation
    inverse = np.eye(1) * deviation**2 / n
    exact = by_parameters(colored_errors, [J], [errors], inverse, weight, 2)
    rounded = by_parameters(colored_errors, [J], [errors], inverse * (1 + rounding), weight, 2)
    assert_allclose(rounded.meat, exact.meat, rtol=1e-9)
    assert_allclose(rounded.dof, exact.dof, rtol=1e-9)
