"""Parameters that enter only through a switch: the reason, and the cure that the sentence gives."""

import numpy as np
import pytest

import greybox as gb


class Switched(gb.StateSpace):
    """A lag with an input that ends at an unknown time T."""

    states = outputs = ("y",)
    inputs = ("t",)
    a = gb.Parameter(1.0, bounds=(0, 10))
    T = gb.Parameter(2.0, bounds=(0, 5), unit="s")

    def derivative(self, x, u, p):
        return (gb.where(u.t < p.T, p.a, 0) - x.y,)

    def output(self, x, u, p):
        return (x.y,)


class Relay(Switched):
    def derivative(self, x, u, p):
        return (p.a * gb.sign(p.T - u.t) - x.y,)


class Ramp(Switched):
    """The switch of `Switched`, as wide as a sample."""

    def derivative(self, x, u, p):
        return (p.a * gb.maximum(gb.minimum((p.T - u.t) / 0.1 + 0.5, 1), 0) - x.y,)


class Absent(Switched):
    def derivative(self, x, u, p):
        return (p.a * (u.t < 3.0) - x.y,)


def fitted(model, starts=2):
    """A fit to data with a = 2 and T = 3.03, by the closed form, with noise of 0.01."""
    time = np.arange(60) * 0.1
    y = 2 * (1 - np.exp(-np.minimum(time, 3.03))) * np.exp(-np.maximum(time - 3.03, 0))
    y += 0.01 * np.random.default_rng(2).normal(size=60)
    record = gb.Record(time, {"t": time, "y": y}, hold={"t": 0.0})
    problem = gb.Problem(model, record, gb.OutputError(initial={"y": 0.0}))
    return gb.fit(problem, starts=starts, seed=1, progress=False)


@pytest.mark.parametrize("model", [Switched(), Relay()])
def test_a_threshold_is_said_to_enter_only_through_a_switch(model):
    fit = fitted(model)
    assert np.isnan(fit.standard_error["T"])
    (said,) = [text for text in fit.warnings if text.startswith("T is not determined")]
    assert "only through a switch" in said
    assert "gb.minimum" in said
    assert "does not change the response" not in said


def test_the_ramp_that_is_advised_determines_the_threshold():
    fit = fitted(Ramp(), starts=4)
    assert fit.estimate["T"] == pytest.approx(3.03, abs=5 * fit.standard_error["T"] + 0.02)
    assert fit.standard_error["T"] < 0.05
    assert not any("switch" in text for text in fit.warnings)


def test_a_parameter_that_no_formula_contains_does_not_change_the_response():
    (said,) = [text for text in fitted(Absent()).warnings if text.startswith("T is not determined")]
    assert "does not change the response" in said
