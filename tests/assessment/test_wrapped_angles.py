"""Measured angles that jump by a full turn: named first, and only where the model has no jumps."""

import re

import numpy as np
import pytest
from scipy.signal import lsim
from unfolded import unfolded

import greybox as gb

TIME = np.arange(0, 30, 0.05)
INPUT = 1 + np.sign(np.sin(0.5 * TIME))
PLANT = ([[0, 1], [0, -2.0]], [[0], [1.5]], [[1, 0]], 0)
NOISE = 0.01 * np.random.default_rng(0).normal(size=TIME.size)
HEADING = lsim(PLANT, INPUT, TIME)[1] + NOISE
WRAPPED = np.angle(np.exp(1j * HEADING))


class Turn(gb.StateSpace):
    """Heading and rate of turn."""

    states, inputs, outputs = ("psi", "r"), ("u",), ("psi",)
    K = gb.Parameter(1.0, bounds=(0.1, 10))
    a = gb.Parameter(1.0, bounds=(0.1, 10))

    def derivative(self, x, u, p):
        return x.r, p.K * u.u - p.a * x.r

    def output(self, x, u, p):
        return (x.psi,)


class TurnOnCompass(Turn):
    """The same, whose output is wrapped like the measurement, and a square wave that is no angle."""

    outputs = ("psi", "square")

    def output(self, x, u, p):
        return gb.arctan2(gb.sin(x.psi), gb.cos(x.psi)), 180 * u.u


def fitted(model, values, unit="", **more):
    record = gb.Record(TIME, {"u": INPUT, "psi": values, **more}, {"psi": unit})
    start = [{"K": 1.5, "a": 2.0}]
    return gb.fit(gb.Problem(model, record), start, profiles=False, progress=False)


@pytest.mark.parametrize(
    ("values", "unit", "call"),
    [
        (WRAPPED, "rad", r"numpy\.unwrap\(psi\)"),
        (WRAPPED % (2 * np.pi), "", r"numpy\.unwrap\(psi\)"),
        (np.degrees(WRAPPED), "deg", r"numpy\.unwrap\(psi, period=360\)"),
        (np.degrees(WRAPPED) % 360, "", r"numpy\.unwrap\(psi, period=360\)"),
    ],
)
def test_a_wrapped_angle_is_named_first_with_the_cure(values, unit, call):
    fit = fitted(Turn(), values, unit)
    said = rf"measured psi of .* jumps by a full turn .*unwrap it, {call}"
    assert re.search(said, fit.warnings[0])
    assert re.search(said, unfolded(str(fit).split("\n\n")[1]))  # with the grade


def test_the_cure_works():
    fit = fitted(Turn(), np.unwrap(WRAPPED))
    assert fit.estimate["K"] == pytest.approx(1.5, rel=0.02)
    assert not any("unwrap" in text for text in fit.warnings)


def test_a_model_that_wraps_and_a_signal_that_really_jumps_are_left_alone():
    square = 180 * INPUT + 0.1 * NOISE
    fit = fitted(TurnOnCompass(), WRAPPED, square=square)
    assert not any("unwrap" in text for text in fit.warnings)
    fit = fitted(Turn(), WRAPPED, "m")
    assert not any("unwrap" in text for text in fit.warnings)
