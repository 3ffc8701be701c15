"""The simulator: how finely it integrates, and what it calls diverged."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from stiff_lag import StiffLag

import greybox as gb
from greybox.assessment.simulation.model_at_estimate import model_at
from greybox.assessment.simulation.prediction import cut
from greybox.assessment.simulation.simulator import (
    DIVERGED,
    Simulator,
    _standard_errors,
    diverged,
    with_implied_states,
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


@pytest.mark.parametrize("integrator", [gb.RungeKutta(), gb.Radau()], ids=repr)
@pytest.mark.parametrize("rate", [0.5, 8.0, 40.0])
def test_substeps_are_refined_to_the_tolerance(integrator, rate):
    """x' = -rate x² from 1 is 1 / (1 + rate t).

    Fast at first, and slow where the poles at rest say so.
    """
    time = 0.1 * np.arange(50)
    record = gb.Record(time, {"u": np.zeros(50)})
    found = gb.simulate(Kinked(), {"rate": rate}, record, initial={"x": 1.0}, integrator=integrator)
    assert_allclose(found["x"], 1 / (1 + rate * time), atol=2e-6)


def test_a_stiff_model_is_integrated_implicitly():
    """Behind a pole that 64 explicit substeps cannot follow, a step gives 1 - exp(-t)."""
    time = 0.1 * np.arange(30)
    record = gb.Record(time, {"u": np.ones(30)})
    found = gb.simulate(StiffLag(), {"k": 1e5}, record, initial={"x": 0.0, "f": 0.0})
    assert_allclose(found["y"], 1 - np.exp(-time), atol=2e-5)


def test_chosen_substeps_are_kept():
    time = 0.1 * np.arange(11)
    record = gb.Record(time, {"u": np.zeros(11)})
    found = gb.simulate(
        Growth(), {"rate": -10.0}, record, initial={"x": 1.0}, integrator=gb.RungeKutta(1)
    )
    one_step = sum((-1.0) ** k / math.factorial(k) for k in range(5))
    assert_allclose(found["x"], one_step ** np.arange(11), rtol=1e-12)


def test_diverged_is_not_finite_or_beyond_any_physical_size():
    signals = {
        "a": np.array([1.0, 2 * DIVERGED, 1.0, np.nan]),
        "b": np.array([1.0, 1.0, -np.inf, 1.0]),
    }
    assert diverged(signals).tolist() == [False, True, True, True]


def test_what_an_output_depends_on_is_told_from_rounding():
    slopes = np.zeros((2, 3, 2, 2))  # (windows, samples, outputs, values)
    slopes[0, 1, 0, 0] = 5.0
    slopes[1, 2, 0, 1] = 1e-12
    slopes[1, 0, 1, 1] = 1e-12
    model = SimpleNamespace(
        covariance=np.full((2, 2), np.nan),
        uncertain=np.array([0, 1]),
        q=np.array([1.0, 0.0]),
        names=("a", "b"),
    )
    error, unknown = _standard_errors(slopes, np.ones((2, 3, 2)), model)
    assert np.argwhere(np.isnan(error)).tolist() == [[0, 1, 0], [1, 0, 1]]
    assert unknown == ("a", "b")


class Known:
    """A growth rate with a variance."""

    def __init__(self, rate, variance):
        self.rate, self.variance = rate, variance

    def at_estimate(self, model, **options):
        return replace(
            model_at(Growth(), {"rate": self.rate}), covariance=np.array([[self.variance]])
        )


def test_errors_of_predictions_follow_the_parameters_through_the_state_that_they_imply():
    """By predictions at two neighboring values, of which each estimates its own states."""
    time = 0.1 * np.arange(121)
    u = 1 + np.sin(1.3 * time)
    x = gb.simulate(Growth(), {"rate": -0.8}, gb.Record(time, {"u": u}), initial={"x": 1.0})["x"]
    x = x + 0.05 * np.random.default_rng(0).normal(size=time.size)
    x[::7] = np.nan
    options = {"record": gb.Record(time, {"u": u, "x": x}), "lead": 1.0, "horizon": 2.0}
    alone = gb.predict(Growth(), {"rate": -0.8}, **options)
    up, down = (gb.predict(Growth(), {"rate": rate}, **options) for rate in (-0.799, -0.801))
    slope = (up.predicted - down.predicted) / 0.002
    found = gb.predict(Known(-0.8, 0.01), **options)
    assert_allclose(found.predicted, alone.predicted)
    assert_allclose(found.error, np.sqrt(alone.error**2 + 0.01 * slope**2), rtol=0.02)
    assert np.all(alone.error < 0.3 * found.error)


def test_outputs_follow_the_states_that_measurements_imply():
    """Derivatives and variance of least squares for the states, over what was measured."""
    random = np.random.default_rng(0)
    t, n, a = 12, 2, 3
    slopes = random.normal(size=(1, t, 2, n + a))
    measured = random.uniform(size=(1, t, 2, 1)) > 0.2
    noise = np.array([[0.5, 0.2], [0.2, 0.4]])
    informing = np.where(measured, slopes, 0.0)
    found, variance = with_implied_states(slopes, informing, noise, np.zeros(n))

    whitened = (np.linalg.inv(np.linalg.cholesky(noise)) @ informing).reshape(-1, n + a)
    X, Q = whitened[:, :n], whitened[:, n:]
    assert_allclose(found, slopes[..., n:] - slopes[..., :n] @ np.linalg.lstsq(X, Q, rcond=None)[0])
    covariance = np.linalg.inv(X.T @ X)
    by_state = slopes[..., :n]
    assert_allclose(variance, np.einsum("wtkn,nm,wtkm->wtk", by_state, covariance, by_state))

    # A prior is one more measurement of every state.
    _, known = with_implied_states(slopes, informing, noise, np.array([4.0, 9.0]))
    covariance = np.linalg.inv(X.T @ X + np.diag([4.0, 9.0]))
    assert_allclose(known, np.einsum("wtkn,nm,wtkm->wtk", by_state, covariance, by_state))

    # Two numbers determine two states, one does not.
    _, enough = with_implied_states(slopes, informing[:, :1], noise, np.zeros(n))
    assert np.isfinite(enough).all() == measured[0, 0].all()
    unseen = informing.copy()
    unseen[..., 1] = 3 * unseen[..., 0]
    _, unknown = with_implied_states(slopes, unseen, noise, np.zeros(n))
    assert np.isnan(unknown).all()


def test_windows_are_linearized_along_their_simulations():
    """x' = r x + u, of which x = x0 exp(rt) for no input: slopes exp(rt) and t x0 exp(rt)."""
    rate, step = -0.6, 0.1
    time = step * np.arange(40)
    random = np.random.default_rng(2)
    measured = 3 * np.exp(rate * time) + 0.05 * random.normal(size=40)
    measured[[3, 17]] = np.nan
    record = gb.Record(time, {"u": np.zeros(40), "x": measured})
    model = model_at(Growth(), {"rate": rate}).driven_by(record)
    windows = cut(record, ["u"], ["x"], lead=0.8, horizon=1.2)
    simulator = Simulator(model, ("x",), gb.RungeKutta())
    found = simulator.windows(windows, np.array([0]))
    start = found.initial.states[:, :, None]
    t = step * np.arange(20)
    grown = np.exp(rate * t)
    there = np.isfinite(measured[windows.rows])
    assert there.sum() < there.size
    np.testing.assert_array_equal(np.isfinite(found.measured[..., 0]), there)
    assert_allclose(found.outputs[..., 0], start[:, 0] * grown, atol=1e-6)
    slopes = np.stack([np.broadcast_to(grown, there.shape), t * start[:, 0] * grown], axis=-1)
    assert_allclose(found.slopes[:, :, 0], slopes, atol=1e-5)
    # The same from other values, of which each window's first state is estimated anew.
    other = simulator.at(np.array([-0.3])).windows(windows, np.array([0]))
    assert_allclose(other.slopes[:, -1, 0, 0], np.exp(-0.3 * t[-1]), rtol=1e-5)


def test_errors_that_are_not_known_are_those_of_outputs_that_depend_on_them():
    """Of three values, one with a variance, one known, one not determined."""
    nan = np.nan
    covariance = np.array(
        [[0.04, 0.0, 0.01, nan], [0.0, 0.0, 0.0, 0.0], [0.01, 0.0, 0.09, nan], [nan, 0, nan, nan]]
    )
    model = SimpleNamespace(
        covariance=covariance,
        uncertain=np.array([0, 2, 3]),
        q=np.array([1.0, 2.0, 3.0, 4.0]),
        names=tuple("abcd"),
    )
    slopes = np.array(
        [[[1.0, -2.0, 0.0]], [[3.0, 0.5, 1e-12]], [[1.0, 1.0, -0.2]]]
    )  # (samples, outputs, values)
    variance = np.array([[0.5], [0.0], [0.1]])
    error, unknown = _standard_errors(slopes, variance, model)
    wanted = [0.5 + 0.04 + 4 * 0.09 - 4 * 0.01, 9 * 0.04 + 0.25 * 0.09 + 3 * 0.01, nan]
    assert_allclose(error[:, 0], np.sqrt(wanted))
    assert unknown == ("d",)
    none, nothing = _standard_errors(slopes, variance, SimpleNamespace(covariance=None))
    assert_allclose(none, np.sqrt(variance))
    assert nothing == ()
    _, independent = _standard_errors(slopes[:2], variance[:2], model)
    assert independent == ()
    assert (
        _standard_errors(
            slopes[..., :0], -variance, SimpleNamespace(covariance=np.eye(1), uncertain=[])
        )[0].max()
        == 0
    )
