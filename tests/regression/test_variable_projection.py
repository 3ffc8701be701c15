"""Variable projection: the truth of noise-free data, and the best of a grid over the nonlinear unknowns."""

from dataclasses import replace

import numpy as np
import pytest
from lagged_plant import TRUTH, Lagged, flown
from numpy.testing import assert_allclose

from greybox.data.intersample import Intersample
from greybox.modeling.realization import dynamics
from greybox.regression.least_squares import residuals, solve
from greybox.regression.linear_in_parameters import regressions
from greybox.regression.regressors import regressors
from greybox.regression.variable_projection import project

START = np.array([-2.0, 1.0, 0.12, 0.01])  # a, b, tau, T


def made(noise=0.0, seed=0, **bounds):
    """The data of the regressions, the free parameters and where they start."""
    record = flown(1000)
    v = record["v"] + noise * np.random.default_rng(seed).normal(size=len(record))
    system = dynamics(Lagged())
    equations = regressions(system, ["u", "v"], {}, START)
    data = regressors(
        equations,
        (system.states, system.inputs),
        record.with_signals(v=v),
        START,
        np.array([0.1]),
        {"u": Intersample(False)},
    )
    parameters = {
        name: replace(p, start=start, bounds=bounds.get(name, p.bounds))
        for (name, p), start in zip(Lagged.parameters.items(), START.tolist(), strict=True)
    }
    return data, parameters


@pytest.fixture(scope="module")
def noisy():
    """Data, parameters and their estimate."""
    data, parameters = made(noise=0.01)
    return data, parameters, project(data, parameters, START)


def cost(data, tau, delay):
    """The sum of squares with the best linear parameters."""
    blocks = data.blocks(np.array([0.0, 0.0, tau, delay]))
    unknowns = solve(blocks, np.ones(1), np.full(2, -np.inf), np.full(2, np.inf))
    return sum(float(e @ e) for e in residuals(blocks, unknowns))


def test_noise_free_data_give_the_truth():
    data, parameters = made()
    found = project(data, parameters, START)
    assert found.names == ("a", "b", "tau", "T")
    assert_allclose(found.values, TRUTH, rtol=0.02, atol=1e-3)
    assert found.at_bound == found.undetermined == ()
    assert found.r_squared[0] > 0.9999
    assert_allclose(found.vector[2:], found.values[2:])


def test_no_point_of_a_grid_is_better(noisy):
    data, _, found = noisy
    tau, delay = found.values[2:]
    best = cost(data, tau, delay)
    grid = [cost(data, tau * x, delay + y) for x in (0.8, 0.95, 1, 1.05, 1.2) for y in (-0.01, -0.002, 0, 0.002, 0.01)]
    assert min(grid) >= best * (1 - 1e-9)
    assert best < min(cost(data, x, y) for x in (0.02, 0.1, 0.3) for y in (0.0, 0.05, 0.1))


def test_linear_parameters_are_those_of_least_squares(noisy):
    data, _, found = noisy
    blocks = data.blocks(found.vector)
    X = np.vstack([b.slopes for b in blocks])
    y = np.concatenate([b.target - b.base for b in blocks])
    assert_allclose(found.values[:2], np.linalg.lstsq(X, y, rcond=None)[0], rtol=1e-8)
    error = y - X @ found.values[:2]
    assert found.spread[0] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert 1 - found.r_squared[0] == pytest.approx(np.sum(error**2) / np.sum((y - y.mean()) ** 2), rel=1e-3)


def test_a_bound_that_excludes_the_truth_is_reached_and_has_no_error():
    data, parameters = made(tau=(0.08, 0.5))
    found = project(data, parameters, START)
    k = found.names.index("tau")
    assert found.at_bound == ("tau",)
    assert found.values[k] == pytest.approx(0.08, rel=1e-9)
    assert np.isnan(found.covariance[k]).all()
    assert np.isfinite(np.delete(np.delete(found.covariance, k, 0), k, 1)).all()


def test_a_step_on_the_same_data_is_small_and_on_other_data_leads_to_their_estimate(noisy):
    data, parameters, found = noisy
    errors = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.step(data)) < 0.01 * errors)
    other, _ = made(noise=0.01, seed=1)
    other = replace(other, bands=data.bands)
    wanted = project(other, parameters, found.vector).values - found.values
    assert_allclose(found.step(other), wanted, atol=0.1 * errors.max(), rtol=0.2)


def test_too_short_a_record_is_said():
    data, parameters = made()
    with pytest.raises(ValueError, match=r"no stretch without a gap is long enough: .* need .* at its ends"):
        project(replace(data, lateness=100.0), parameters, START)


def test_at_a_bound_a_step_leaves_the_parameter_there_and_moves_the_others():
    data, parameters = made(noise=0.01, tau=(0.08, 0.5))
    found = project(data, parameters, START)
    assert found.at_bound == ("tau",)
    other, _ = made(noise=0.01, seed=1)
    other = replace(other, bands=data.bands)
    wanted = project(other, parameters, found.vector)
    step = found.step(other)
    assert step[found.names.index("tau")] == 0
    errors = np.sqrt(np.nanmax(np.diag(found.covariance)))
    assert_allclose(step, wanted.values - found.values, atol=0.1 * errors, rtol=0.2)


def test_a_start_that_is_almost_as_good_as_the_minimum_is_improved_too():
    """Errors of the sensor are most of the cost, so that a start beside the minimum costs little more."""
    data, parameters = made(noise=0.1)
    found = project(data, parameters, START)
    errors = np.sqrt(np.diag(found.covariance))
    beside = found.vector + np.array([0.0, 0.0, *(0.2 * errors[2:])])
    assert cost(data, *beside[2:]) < 1.5 * cost(data, *found.vector[2:])
    again = project(data, parameters, beside)
    assert_allclose(again.values, found.values, atol=0.05 * errors.min())
