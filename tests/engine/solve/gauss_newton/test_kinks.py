"""Minima at kinks of the cost: tanks that run empty, dead zones, whole samples of a delay."""

import numpy as np
import pytest
import scipy.signal
from hard_models import GuardedTanks, simulated
from sampled_lag import SampledLag
from spring_lag_tilt import HELD

import greybox as gb
from greybox.assessment.verdict import verdict

pytestmark = pytest.mark.usefixtures("unjudged_file")


def emptied(seed):
    """Return a record of two tanks whose pump stands still half of the time."""
    random, n = np.random.default_rng(seed), 60
    k, a1, a2 = np.array([0.0035, 0.019, 0.0136]) * np.exp(0.3 * random.normal(size=3))
    first, time = random.uniform(0.05, 0.4, 2), 2.0 * np.arange(n)
    pump = np.repeat(random.uniform(0, 10, n // 10) * (random.random(n // 10) < 0.5), 10)

    def derivative(x, V):
        through, out = np.array([a1, a2]) * np.sqrt(19.62 * np.maximum(x, 0))
        return [(k * V - through) / 0.5, (through - out) / 0.25]

    h2 = simulated(derivative, first, time, [pump])[1] + 0.003 * random.normal(size=n)
    return gb.Problem(GuardedTanks(), gb.Record(time, {"V": pump, "h2": h2}), HELD)


def test_empty_tanks_take_few_iterations():
    found = gb.fit(emptied(2), [{}], progress=False)
    assert found.converged
    assert found.runs[0].iterations < 100


class DeadZone(gb.StateSpace):
    """A lag behind a dead zone."""

    states, inputs, outputs = ("x",), ("u",), ("y",)
    d = gb.Parameter(0.6, bounds=(0, 1.9))

    def derivative(self, x, u, p):
        return (gb.maximum(u.u - p.d, 0) - x.x,)

    def output(self, x, u, p):
        return (x.x,)


def test_a_minimum_at_a_kink_is_named():
    """Steps of 1 and 2 in turn: at d = 1 the first one stops acting, and the cost has a kink."""
    time = 0.5 * np.arange(240)
    u = np.where(np.arange(240) % 40 < 20, 1.0, 2.0)
    # No dead zone answers one step with -0.5 and the other with 1.2. Beside the kink, the cost of
    # the steady values (1 - d + 0.5)² + (2 - d - 1.2)² falls towards it on either side.
    y = simulated(lambda x, u: [np.where(u > 1.5, 1.2, -0.5) - x[0]], [0.35], time, [u])[0]
    y = y + 0.5 * np.random.default_rng(0).normal(size=240)
    problem = gb.Problem(DeadZone(), gb.Record(time, {"u": u, "y": y}), HELD)

    for start in (0.3, 1.5):
        fit = gb.fit(problem, [{"d": start}], progress=False)
        assert fit.converged
        assert abs(fit.estimate["d"] - 1) < 1e-3
        assert any("converged at a kink" in warning for warning in fit.warnings)
        assert verdict(fit).grade != "good"


class DelayedLag(SampledLag):
    """A lag of a held input that arrives late."""

    delays = {"u": "T_delay"}
    T_delay = gb.Parameter(0.05, bounds=(0, 0.5), unit="s")


@pytest.mark.parametrize("seed", [1029, 1053])
def test_a_delay_of_whole_samples_converges(seed):
    """Six samples: beside it, the slope of the cost changes. Steps from either side cross it."""
    random, step = np.random.default_rng(seed), 0.05
    u = np.repeat(random.choice([-1.0, 1.0], 20), 20)

    y = [2 * u[0]]
    for late in np.concatenate([np.full(6, u[0]), u[:-7]]):
        y.append(2 * late + np.exp(-step / 0.4) * (y[-1] - 2 * late))
    y = np.array(y) + 0.02 * random.normal(size=u.size)
    record = gb.Record(step * np.arange(u.size), {"u": u, "y": y}, hold={"u": np.inf, "y": 0})
    fit = gb.fit(gb.Problem(DelayedLag(), record), starts=3, progress=False)

    assert fit.converged
    assert fit.estimate["T_delay"] == pytest.approx(0.3, abs=1e-6)


class DirectLag(gb.StateSpace):
    """A delayed input that reaches the output through a lag and directly, as an acceleration."""

    inputs, states, outputs = ("u",), ("x",), ("y",)
    delays = {"u": "T"}
    K = gb.Parameter(2.0, bounds=(0.1, 10))
    tau = gb.Parameter(0.3, bounds=(0.05, 3), unit="s")
    D = gb.Parameter(1.0, bounds=(-5, 5))
    T = gb.Parameter(0.03, bounds=(0, 0.2), unit="s")

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.x) / p.tau,)

    def output(self, x, u, p):
        return (x.x + p.D * u.u,)


@pytest.mark.parametrize("seed", [1, 15])
def test_the_other_parameters_settle_where_a_delay_is_one_sample(seed):
    """Of the runs that stalled there, none counted: the fit ended elsewhere, or nowhere."""
    random, step = np.random.default_rng(seed), 0.02
    u = np.repeat(random.choice([-1.0, 1.0], 40), 15)
    time, late = step * np.arange(u.size), np.append(u[0], u[:-1])
    x = scipy.signal.lsim(([[-2.5]], [[5.0]], [[1.0]], [[0.0]]), late, time, [2 * u[0]])[1]
    y = x + late + 0.1 * random.normal(size=u.size)
    fit = gb.fit(gb.Problem(DirectLag(), gb.Record(time, {"u": u, "y": y})), progress=False)

    assert fit.converged
    assert fit.agreeing >= 3
    assert fit.estimate["T"] == pytest.approx(step, abs=1e-3)
    assert fit.estimate["D"] == pytest.approx(1, abs=0.03)
