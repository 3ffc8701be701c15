"""Formulas are traced once a fit, and anew after the model has changed."""

from dataclasses import dataclass

import numpy as np
import pytest

import greybox as gb
from greybox.modeling.linearization import jacobians
from greybox.modeling.traced_once import traced_once

OMEGA = np.geomspace(0.5, 20, 10)


class Counted(gb.StateSpace):
    states, inputs, outputs = ("x",), ("a", "b"), ("x", "rate")
    k = gb.Parameter(2.0, bounds=(0.1, 10))
    calls, gain = 0, 1.0

    def derivative(self, x, u, p):
        self.calls += 1
        return (self.gain * (u.a + 2 * u.b) - p.k * x.x,)

    def output(self, x, u, p):
        return x.x, u.a - p.k * x.x


def test_all_responses_of_a_fit_share_one_trace_that_ends_with_it():
    model = Counted()
    responses = [
        gb.frequency_response(model, None, OMEGA, input=u, output=y)
        for u in model.inputs
        for y in model.outputs
    ]
    model.calls = 0
    fit = gb.fit(gb.several(model, responses), starts=4, progress=False)
    assert fit.estimate["k"] == pytest.approx(2.0)
    assert model.calls == 1

    before = gb.frequency_response(model, None, OMEGA, input="a", output="x")
    model.gain = 3.0
    after = gb.frequency_response(model, None, OMEGA, input="a", output="x")
    np.testing.assert_allclose(after.response, 3 * before.response)


def test_an_inner_block_continues_the_outer_one():
    model = Counted()
    with traced_once():
        function = jacobians(model)
        with traced_once():
            assert jacobians(model) is function
        assert jacobians(model) is function
    assert jacobians(model) is not function


@dataclass
class Chosen(Counted):
    """A model with an option of its own; a dataclass that compares its fields has no hash."""

    gain: float = 1.0


def test_a_model_that_is_a_dataclass_is_fitted():
    for gain in (1.0, 3.0):
        truth = gb.frequency_response(Chosen(gain), None, OMEGA, input="a", output="x")
        fit = gb.fit(gb.Problem(Chosen(gain), truth), starts=4, progress=False)
        assert fit.estimate["k"] == pytest.approx(2.0)
