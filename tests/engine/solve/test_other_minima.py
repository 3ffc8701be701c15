"""Other minima than the one that all runs reach, after a fit from the default starts."""

import numpy as np
import pytest

import greybox as gb


class Decay(gb.StateSpace):
    states, inputs, outputs = ("fast", "slow"), (), ("y",)
    a = gb.Parameter(3.0, bounds=(0.1, 10))
    b = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return -p.a * x.fast, -p.b * x.slow

    def output(self, x, u, p):
        return (x.fast + x.slow,)


def test_a_linear_model_without_inputs_has_no_response_to_search():
    time = np.arange(200) * 0.02
    y = np.exp(-time) + 2 * np.exp(-4 * time)
    y += 0.001 * np.random.default_rng(0).standard_normal(time.size)
    fit = gb.fit(gb.Problem(Decay(), gb.Record(time, {"y": y})), progress=False)
    assert sorted(fit.estimate.values()) == pytest.approx([1, 4], rel=0.01)
