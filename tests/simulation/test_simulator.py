"""The simulator: how finely it integrates, and what it calls diverged."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.simulation.model_at_estimate import model_at
from greybox.simulation.simulator import (
    DIVERGED,
    MOST_AT_FIRST,
    _depends,
    _first_substeps,
    _free_run_sensitivities,
    diverged,
)


class Growth(gb.StateSpace):
    """x' = rate x + u."""

    states, outputs = ("x",), ("x",)
    rate = gb.Parameter(-1.0)

    def derivative(self, x, u, p):
        return (p.rate * x.x + u.u,)

    def output(self, x, u, p):
        return (x.x,)


class Kinked(Growth):
    """x' = -rate |x| x."""

    def derivative(self, x, u, p):
        return (-p.rate * abs(x.x) * x.x + u.u,)


@pytest.mark.parametrize(("rate", "count"), [(-0.05, 1), (-3.0, 3), (3.0, 3), (-1e6, MOST_AT_FIRST)])
def test_the_first_substeps_follow_the_poles_at_rest(rate, count):
    assert _first_substeps(model_at(Growth(), {"rate": rate}), 0.1) == count


def test_a_model_without_states_needs_no_substeps():
    class Static(gb.StateSpace):
        states = ()
        k = gb.Parameter(2.0)

        def output(self, x, u, p):
            return (p.k * u.u,)

    assert _first_substeps(model_at(Static(), {}), 0.1) == 1


@pytest.mark.parametrize("integrator", [gb.RungeKutta(), gb.Rosenbrock()], ids=repr)
@pytest.mark.parametrize("rate", [0.5, 8.0, 40.0])
def test_substeps_are_refined_to_the_tolerance(integrator, rate):
    """x' = -rate x² from 1 is 1 / (1 + rate t): fast at first, and slow where the poles at rest say so."""
    time = 0.1 * np.arange(50)
    record = gb.Record(time, {"u": np.zeros(50)})
    found = gb.simulate(Kinked(), {"rate": rate}, record, initial={"x": 1.0}, integrator=integrator)
    assert_allclose(found["x"], 1 / (1 + rate * time), atol=2e-6)


def test_chosen_substeps_are_kept():
    time = 0.1 * np.arange(11)
    record = gb.Record(time, {"u": np.zeros(11)})
    found = gb.simulate(Growth(), {"rate": -10.0}, record, initial={"x": 1.0}, integrator=gb.RungeKutta(1))
    one_step = sum((-1.0) ** k / math.factorial(k) for k in range(5))
    assert_allclose(found["x"], one_step ** np.arange(11), rtol=1e-12)


def test_diverged_is_not_finite_or_beyond_any_physical_size():
    signals = {"a": np.array([1.0, 2 * DIVERGED, 1.0, np.nan]), "b": np.array([1.0, 1.0, -np.inf, 1.0])}
    assert diverged(signals).tolist() == [False, True, True, True]


def test_what_an_output_depends_on_is_told_from_rounding():
    slopes = np.zeros((2, 3, 2, 2))  # (windows, samples, outputs, values)
    slopes[0, 1, 0, 0] = 5.0
    slopes[1, 2, 0, 1] = 1e-12
    slopes[1, 0, 1, 1] = 1e-12
    found = _depends(slopes, np.array([1.0, 0.0]))
    assert np.argwhere(found).tolist() == [[0, 1, 0, 0], [1, 0, 1, 1]]


class Known:
    """A growth rate with a variance."""

    def __init__(self, rate, variance):
        self.rate, self.variance = rate, variance

    def at_estimate(self, model, **options):
        return replace(model_at(Growth(), {"rate": self.rate}), covariance=np.array([[self.variance]]))


def test_errors_of_predictions_follow_the_parameters_through_the_state_that_they_imply():
    """By predictions at two neighboring values, of which each estimates its own states."""
    time = 0.1 * np.arange(121)
    u = 1 + np.sin(1.3 * time)
    x = gb.simulate(Growth(), {"rate": -0.8}, gb.Record(time, {"u": u}), initial={"x": 1.0})["x"]
    x = x + 0.05 * np.random.default_rng(0).normal(size=time.size)
    options = {"record": gb.Record(time, {"u": u, "x": x}), "lead": 1.0, "horizon": 2.0}
    alone = gb.predict(Growth(), {"rate": -0.8}, **options)
    up, down = (gb.predict(Growth(), {"rate": rate}, **options) for rate in (-0.799, -0.801))
    slope = (up.predicted - down.predicted) / 0.002
    found = gb.predict(Known(-0.8, 0.01), **options)
    assert_allclose(found.predicted, alone.predicted)
    assert_allclose(found.error, np.sqrt(alone.error**2 + 0.01 * slope**2), rtol=0.02)
    assert np.all(alone.error < 0.3 * found.error)


def test_a_free_simulation_takes_its_fitted_initial_states_along():
    """Derivatives and variance of least squares for the states, over the samples that were compared."""
    random = np.random.default_rng(0)
    t, n, a = 12, 2, 3
    slopes = random.normal(size=(t, 2, n + a))
    residual = random.normal(size=(2, t + 4))
    residual[0, 5], residual[1, 7:9] = np.nan, np.nan
    noise = np.array([[0.5, 0.2], [0.2, 0.4]])
    part = SimpleNamespace(outputs=("y", "z"), noise=noise, residual=lambda name: residual["yz".index(name)])
    model = SimpleNamespace(system=SimpleNamespace(states=("p", "q")), part=part)
    stretch = SimpleNamespace(rows=np.arange(2, 2 + t))
    outputs = ("z", "y")  # in another order than those of the fit
    found, variance = _free_run_sensitivities(model, stretch, slopes, outputs, True)

    there = np.isfinite(residual[:, 2 : 2 + t]).T[..., None]
    of_part = np.where(there, slopes[:, [1, 0]], 0.0)
    whitened = (np.linalg.inv(np.linalg.cholesky(noise)) @ of_part).reshape(-1, n + a)
    X, Q = whitened[:, :n], whitened[:, n:]
    assert_allclose(found, slopes[..., n:] - slopes[..., :n] @ np.linalg.lstsq(X, Q, rcond=None)[0])
    covariance = np.linalg.inv(X.T @ X)
    assert_allclose(variance, np.einsum("tkn,nm,tkm->tk", slopes[..., :n], covariance, slopes[..., :n]))

    given, nothing = _free_run_sensitivities(model, stretch, slopes, outputs, False)
    assert_allclose(given, slopes[..., n:])
    assert np.all(nothing == 0)
    unseen = slopes.copy()
    unseen[..., 1] = 3 * unseen[..., 0]
    _, unknown = _free_run_sensitivities(model, stretch, unseen, outputs, True)
    assert np.isnan(unknown).all()
    unseen[3, 0, 4] = np.inf
    assert np.isnan(_free_run_sensitivities(model, stretch, unseen, outputs, True)[0]).all()
