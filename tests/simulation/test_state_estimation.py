"""States that lead-ins tell stay where the model has finite values, and what is not finite is named."""

import numpy as np
import pytest

import greybox as gb


class Tanks(gb.StateSpace):
    """Two tanks below one another by Torricelli's law, of which the lower level is measured."""

    states, inputs, outputs = ("upper", "lower"), ("flow",), ("lower",)
    k1 = gb.Parameter(0.5, bounds=(0.1, 2))
    k2 = gb.Parameter(0.6, bounds=(0.1, 2))

    def root(self, level):
        return gb.sqrt(level)

    def derivative(self, x, u, p):
        between = p.k1 * self.root(x.upper)
        return (u.flow - between, between - p.k2 * self.root(x.lower))

    def output(self, x, u, p):
        return (x.lower,)


class SafeTanks(Tanks):
    """The same with roots below zero."""

    def root(self, level):
        return gb.sqrt(gb.maximum(level, 0))


def tanks(model, flow, noise=0.02):
    record = gb.Record(np.arange(flow.size) / 5.0, {"flow": flow}, name="tanks")
    lower = gb.simulate(model, {}, record, initial={"upper": 2.0, "lower": 1.5})["lower"]
    return record.with_signals(lower=lower + noise * np.random.default_rng(0).normal(size=flow.size))


def test_lead_ins_stay_where_the_model_is_finite():
    flow = 0.6 + 0.3 * np.repeat(np.random.default_rng(1).uniform(-1, 1, 25), 20)
    record = tanks(Tanks(), flow)
    found = gb.predict(Tanks(), {}, record, horizon=2.0, lead=6.0)
    exact = gb.simulate(Tanks(), {}, record, initial={"upper": 2.0, "lower": 1.5})["lower"][found.rows]
    assert np.sqrt(np.mean((found.predicted[0] - exact) ** 2)) < 0.02
    assert np.all(found.trajectory > 0)


def test_what_is_not_finite_is_named_with_its_place():
    flow = np.where(np.arange(300) < 150, 0.6, 0.0)
    record = tanks(SafeTanks(), flow)
    with pytest.raises(
        ValueError, match=r"not finite in \d+ windows of 58: (upper|lower) at 3\d.\d* s, .*after upper = "
    ):
        gb.predict(Tanks(), {}, record, horizon=1.0, lead=2.0, integrator=gb.RungeKutta(substeps=8))
    with pytest.raises(ValueError, match=r"is not finite from 3\d\.?\d* s on, \w+ first, after upper = .*gb.maximum"):
        gb.simulate(Tanks(), {}, record, initial={"upper": 2.0, "lower": 1.5})
