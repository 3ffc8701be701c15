"""Evidence for disturbances against dense matrices, and against simulated errors."""

import numpy as np
import pytest
from scipy.linalg import null_space

from greybox.statistics.column_space import column_basis
from greybox.statistics.disturbed_errors import SIZES, disturbed_errors, in_time, louder_times

LINES = 10


def disturbance(pole=2.0):
    """How two outputs follow a disturbance through a lag, one of them its integral."""
    omega = 0.5 * np.arange(1, LINES + 1)
    rate = 1 / (1j * omega + pole)
    return np.array([rate, rate / (1j * omega)])


def as_real(values):
    """Complex values (k, lines) as rows, real parts first."""
    return np.hstack([values.real, values.imag])


def circular(random, shape):
    return random.normal(size=shape) + 1j * random.normal(size=shape)


def fitted_errors(random, size, directions=4):
    """White errors with a disturbance, less what a fit of random directions takes."""
    h = disturbance()
    h = h / np.sqrt(np.mean(np.sum(np.abs(h) ** 2, axis=0)))
    errors = as_real(circular(random, (2, LINES)) + np.sqrt(size) * h * circular(random, LINES))
    basis = column_basis(random.normal(size=(errors.size, directions)))
    flat = errors.ravel()
    return (flat - basis @ (basis.T @ flat)).reshape(errors.shape), basis


def test_the_probability_is_that_of_dense_matrices():
    """The likelihood of what no parameter takes, with the size of the errors fitted."""
    errors, basis = fitted_errors(np.random.default_rng(1), 0.5)
    h = disturbance()
    power = np.mean(np.sum(np.abs(h) ** 2, axis=0))
    # A unit disturbance with a real and an imaginary part at each line.
    effects = np.array(
        [as_real(h * unit).ravel() for line in np.eye(LINES) for unit in (line, 1j * line)]
    )
    free = null_space(basis.T)
    values = free.T @ errors.ravel()
    logarithms, covariances = [], []
    for size in SIZES.ravel():
        covariance = free.T @ (np.eye(errors.size) + size / power * effects.T @ effects) @ free
        squares = values @ np.linalg.solve(covariance, values)
        scale = squares / len(values)
        shared = h[:, None] * h.conj() * size / power
        covariances.append(scale * (np.eye(2) + np.moveaxis(shared, 2, 0)))
        logarithms.append(-np.linalg.slogdet(covariance)[1] / 2 - len(values) / 2 * np.log(squares))
    likelihood = np.exp(logarithms - np.max(logarithms))
    wanted = likelihood[0] / (likelihood[0] + likelihood[1:].mean())
    assert 0.001 < wanted < 0.5
    weight = np.append(wanted, likelihood[1:] * (1 - wanted) / likelihood[1:].sum())
    probability, covariance = disturbed_errors(errors, basis, 7.0 * h[None])
    assert probability == pytest.approx(wanted, rel=1e-8)
    np.testing.assert_allclose(covariance, np.tensordot(weight, covariances, 1), rtol=1e-8)


@pytest.mark.parametrize(("size", "least", "most"), [(0.0, 0.0, 0.04), (10.0, 0.9, 1.0)])
def test_disturbances_are_recognized_and_white_errors_are_not_called_disturbed(size, least, most):
    random = np.random.default_rng(3)
    probabilities = [
        disturbed_errors(*fitted_errors(random, size), disturbance()[None])[0] for _ in range(200)
    ]
    assert least <= np.mean(np.array(probabilities) < 0.2) <= most


def test_a_disturbance_that_no_output_follows_is_neither_likely_nor_unlikely():
    errors, basis = fitted_errors(np.random.default_rng(4), 0.0)
    assert disturbed_errors(errors, basis, 0 * disturbance()[None])[0] == pytest.approx(0.5)


@pytest.mark.parametrize(("loud", "least", "most"), [(1.0, 0.0, 0.06), (6.0, 0.85, 1.0)])
@pytest.mark.parametrize("outputs", [1, 3])
def test_times_of_larger_errors_are_recognized(outputs, loud, least, most):
    """White noise of a record that is louder in its first third, transformed to lines and back."""
    random, samples, lines = np.random.default_rng(5), 200, 16
    size = np.where(np.arange(samples) < samples / 3, loud, 1.0)
    steady, ratios = [], []
    for _ in range(100):
        noise = np.fft.fft(size * random.normal(size=(outputs, samples)))[:, 5 : 5 + lines]
        errors = np.stack([noise.real, noise.imag], axis=1)
        basis = column_basis(random.normal(size=(errors.size, 4)))
        errors -= (basis @ (basis.T @ errors.ravel())).reshape(errors.shape)
        parts = in_time(errors), in_time(basis.reshape(*errors.shape, -1))
        probability, covariance = louder_times(*parts)
        steady.append(probability)
        first, last = np.array_split(np.einsum("lii->l", covariance).real, [lines // 3])
        ratios.append(first.mean() / last.mean())
    assert least <= np.mean(np.array(steady) < 0.2) <= most
    assert (0.8 < np.median(ratios) < 1.25) if loud == 1 else np.median(ratios) > 5
