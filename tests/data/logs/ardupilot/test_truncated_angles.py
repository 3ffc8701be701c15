"""Angles cut to whole hundredths of a degree toward zero, against the angles before."""

import numpy as np
import pytest
from sampled_sines import amplitude

import greybox as gb
from greybox.data.record import Record, Recording

TIME = np.arange(8000) / 400
OMEGA = 2 * np.pi * 3
AMPLITUDE = 0.4654  # deg, as a quadcopter answers 3° at 20 rad/s
NOISE = np.random.default_rng(0).normal(0, 0.02, TIME.size)


def prepared(cut, message="ATT[0]", offset=0.0):
    """An angle as the log has it, on its own time base."""
    angle = AMPLITUDE * np.sin(OMEGA * TIME) + offset + NOISE
    log = Recording({message: Record(TIME, {"Pitch": cut(angle)}, {"Pitch": "deg"})})
    return np.degrees(gb.prepare(log, {"theta": f"{message}.Pitch"})["theta"])


def gain(values):
    return abs(amplitude(TIME, values, OMEGA)) / AMPLITUDE


def truncated(angle):
    return np.trunc(100 * angle) / 100


@pytest.mark.parametrize("offset", [0.0, 5.0, -0.3])
def test_the_half_that_was_cut_off_is_added(offset):
    """What is left is below a tenth of the 1.4 % that a sine around zero loses; the mean is right, too."""
    values = prepared(truncated, offset=offset)
    assert gain(values) == pytest.approx(gain(prepared(np.asarray, offset=offset)), abs=1e-3)
    assert values.mean() == pytest.approx(offset + NOISE.mean(), abs=5e-4)


def test_the_cut_loses_what_the_formula_says():
    assert gain(truncated(AMPLITUDE * np.sin(OMEGA * TIME) + NOISE)) == pytest.approx(
        1 - 2 * 0.01 / np.pi / AMPLITUDE, abs=2e-3
    )


@pytest.mark.parametrize(("cut", "message"), [(np.asarray, "ATT"), (truncated, "ANG")])
def test_what_was_not_cut_remains(cut, message):
    angle = AMPLITUDE * np.sin(OMEGA * TIME) + NOISE
    assert prepared(cut, message) == pytest.approx(cut(angle), abs=1e-9)
