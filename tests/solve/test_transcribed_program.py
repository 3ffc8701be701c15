"""The whole problem as one program for IPOPT, of several records of different lengths and weights."""

import numpy as np
import pytest

import greybox as gb


class Lag(gb.StateSpace):
    states = outputs = ("x",)
    inputs = ("u",)
    a = gb.Parameter(1.0, bounds=(0.01, 50))

    def derivative(self, x, u, p):
        return (p.a * (u.u - x.x),)

    def output(self, x, u, p):
        return (x.x,)


def record(samples, seed):
    random = np.random.default_rng(seed)
    time, u = 0.1 * np.arange(samples), np.repeat(random.normal(size=samples // 10), 10)
    flown = gb.simulate(Lag(), {"a": 2.0}, gb.Record(time, {"u": u}), inputs="held")
    return gb.Record(time, {"u": u, "x": flown["x"] + 0.05 * (1 + seed) * random.normal(size=samples)})


@pytest.mark.parametrize("method", [gb.MultipleShooting(ipopt=True), gb.Collocation()], ids=["shooting", "collocation"])
def test_records_of_different_lengths_and_weights_are_one_program(method):
    """Against the Gauss-Newton solver, whose sums are tested against their definition."""
    held = gb.OutputError(inputs="held")
    parts = [gb.Problem(Lag(), record(40 + 30 * k, k), held, weight=1.0 + 2 * k) for k in range(3)]
    problem = parts[0] + parts[1] + parts[2]
    wanted, found = (gb.fit(problem, starts=[{}], method=m, progress=False) for m in (None, method))
    assert found.converged
    assert found.cost == pytest.approx(wanted.cost, abs=1e-3)
    assert found.estimate["a"] == pytest.approx(wanted.estimate["a"], rel=1e-3)
