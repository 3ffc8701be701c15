"""Tanks that run empty: a guarded root has no slope there, and the integrated cost has kinks."""

import numpy as np
from hard_models import GuardedTanks, simulated
from spring_lag_tilt import HELD

import greybox as gb
from greybox.estimate.verdict import verdict


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


def test_a_minimum_at_a_kink_is_named():
    found = gb.fit(emptied(0), [{}], progress=False)
    assert found.converged
    assert any("kink of 'GuardedTanks'" in warning for warning in found.warnings)
    assert verdict(found).grade == "doubt"
