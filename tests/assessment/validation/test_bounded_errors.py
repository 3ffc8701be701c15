"""Bounded errors have no likelihood that could be compared: their cost is that of pseudo-values."""

import numpy as np
import pytest
from driven_lag import Lag

import greybox as gb


@pytest.fixture(scope="module")
def shown():
    """A lag with three outliers, fitted with bounded and with normal errors."""
    random = np.random.default_rng(0)
    t, u = 0.05 * np.arange(400), np.repeat(random.choice([-1.0, 1.0], 40), 10)
    empty = gb.Record(t, {"u": u}, hold={"u": np.inf})
    y = gb.simulate(Lag(), {"g": 3.0, "tau": 0.4}, record=empty)["y"]
    y = y + 0.02 * random.standard_normal(len(t))
    y[[50, 170, 300]] += 1.5
    record = gb.Record(t, {"u": u, "y": y}, hold={"u": np.inf, "y": 0.0})
    fits = [
        gb.fit(gb.Problem(Lag(), record, gb.OutputError(errors=errors)), 2, progress=False)
        for errors in ("huber", "normal")
    ]
    # The estimates hardly differ, but the cost of the pseudo-values is that of far smaller errors.
    assert fits[0].cost < fits[1].cost - 100
    return gb.compare(*fits, labels=["bounded", "normal"])


def test_costs_and_criteria_are_not_compared(shown):
    assert "not compared: the large errors of bounded are bounded" in str(shown)
    assert "AIC" not in shown.verdict


def test_predictions_are_compared(shown):
    assert "predict the identification data equally well" in shown.verdict
