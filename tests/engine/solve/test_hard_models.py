"""Models that leave their domain, ignite, hide their states or reach limits.

Found from the starts that `fit` draws.
"""

from itertools import pairwise

import numpy as np
import pytest
from hard_models import (
    CHAIN,
    REACTOR,
    TANKS,
    GuardedTanks,
    Tanks,
    chain,
    reactor,
    tanh_chain,
    tanks,
    too_simple,
    unseen,
)
from scipy.integrate import solve_ivp

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")


def fit(problem, starts, **options):
    return gb.fit(problem, starts=starts, progress=False, profiles=False, **options)


def near(found, truth, errors=4.0):
    for name, value in truth.items():
        assert abs(found.estimate[name] - value) < errors * found.standard_error[name], name


@pytest.mark.parametrize("model", [Tanks, GuardedTanks])
def test_tanks_are_found_from_starts_that_would_drain_them(model):
    found = fit(tanks(model, 200), 2)
    assert found.converged
    near(found, TANKS)


def test_a_reactor_that_ignites_is_found_in_a_wide_box():
    # A fast reaction grows by e in a quarter of a sample: single implicit steps lead nowhere.
    found = fit(reactor(), 2)
    assert found.agreeing == 2
    near(found, REACTOR)


def test_hidden_states_do_not_explain_what_parameters_should():
    found = fit(chain(500), 3)
    assert found.agreeing >= 2
    near(found, CHAIN)


class Ladder(gb.StateSpace):
    """Six equal cells of resistance and capacity, with a load at the end."""

    states, inputs, outputs = tuple(f"v{i}" for i in range(6)), ("u",), ("middle", "end")
    C = gb.Parameter(0.01, bounds=(0.001, 0.1))
    R = gb.Parameter(5.0, bounds=(0.5, 50))

    def derivative(self, x, u, p):
        v = u.u, x.v0, x.v1, x.v2, x.v3, x.v4, x.v5
        flows = [*(a - b for a, b in pairwise(v)), x.v5 / p.R]
        return [(a - b) / p.C for a, b in pairwise(flows)]

    def output(self, x, u, p):
        return x.v2, x.v5


def test_runs_pass_the_values_at_which_their_first_steps_are_unstable():
    # At the declared capacity five substeps are stable, at the true one eight.
    truth = {"C": 0.006, "R": 8.0}
    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, 15), 10)
    drive = gb.Record(0.05 * np.arange(150), {"u": u}, hold={"u": np.inf})
    motion = gb.simulate(Ladder(), truth, record=drive)
    noisy = {name: motion[name] + 0.005 * random.standard_normal(150) for name in Ladder.outputs}
    data = gb.Record(drive.time, {"u": u, **noisy}, hold={"u": np.inf})

    far = [{"C": 0.03, "R": 20.0}, {"C": 0.1, "R": 40.0}, {"C": 0.01, "R": 5.0}]
    found = fit(gb.Problem(Ladder(), data), far)
    assert found.agreeing == 3
    near(found, truth)


def test_what_the_data_hardly_determine_does_not_use_up_all_iterations():
    """Thirteen parameters of a chain of five states.

    What is left to gain is noise, in directions that stay unknown.
    """
    found = fit(tanh_chain(5, 200), [{}])
    assert found.converged
    assert max(run.iterations for run in found.runs) <= 300
    residuals = np.concatenate(
        [found.records[0].residual(name) for name in found.records[0].outputs]
    )
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(0.01, rel=0.1)
    assert any("determine" in text for text in found.warnings)


def test_a_state_that_nothing_shows_hinders_nothing_and_its_parameter_is_named():
    found = fit(unseen(), 3)
    assert found.agreeing == 3
    near(found, {"a": 3.0, "b": 2.0})
    assert np.isnan(found.standard_error["c"])
    assert any(text.startswith("c is not determined") for text in found.warnings)


@pytest.mark.parametrize("noise", ["diagonal", "full"])
def test_an_estimated_covariance_that_follows_the_parameters_does_not_slow_the_end(noise):
    """Of a wrong model; the minimum is one in all directions by finite differences of the cost."""
    problem = too_simple(noise)
    found = fit(problem, 2)
    assert sum(run.converged for run in found.runs) == len(found.runs)
    assert max(run.iterations for run in found.runs) <= 40
    objective = gb.objective(problem)
    for name in found.free:
        for sign in (-1, 1):
            moved = found.estimate | {
                name: found.estimate[name] + sign * 0.3 * found.standard_error[name]
            }
            assert objective.value(moved) >= found.cost - 1e-6


class Relaxation(gb.StateSpace):
    """Van der Pol's oscillator, whose second state no output shows."""

    states, inputs, outputs = ("x", "v"), (), ("x",)
    mu = gb.Parameter(4.0, bounds=(0.5, 100), starts=(3, 8), scale="log")
    w = gb.Parameter(1.1, bounds=(0.2, 5), starts=(0.8, 1.3))

    def derivative(self, x, u, p):
        return (x.v, p.mu * (1 - x.x**2) * x.v - p.w**2 * x.x)

    def output(self, x, u, p):
        return (x.x,)


def test_a_relaxation_oscillation_is_found_though_its_mean_is_zero():
    # At rest, where the states once began, this oscillator is unstable: no start arrived.
    def rates(_, z):
        return z[1], 5 * (1 - z[0] ** 2) * z[1] - z[0]

    t = np.arange(0, 60, 0.5)
    exact = solve_ivp(rates, (0, 60), (2, 0), "LSODA", t, rtol=1e-9, atol=1e-11).y[0]
    x = exact + 0.04 * np.random.default_rng(0).normal(size=t.size)
    found = fit(gb.Problem(Relaxation(), gb.Record(t, {"x": x})), 2)
    assert found.agreeing == 2
    near(found, {"mu": 5.0, "w": 1.0})
