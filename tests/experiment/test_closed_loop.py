"""Gains from an excitation to the signals of a loop, held against the discretized plant."""

import numpy as np
import pytest

import greybox as gb
from greybox.experiment.closed_loop import loop_gains

STEP = 0.02


class Lag(gb.StateSpace):
    """y' = (K u - y) / T."""

    states, inputs, outputs = ("y",), ("u",), ("y",)
    K = gb.Parameter(2.0)
    T = gb.Parameter(0.5)

    def derivative(self, x, u, p):
        return ((p.K * u.u - x.y) / p.T,)

    def output(self, x, u, p):
        return (x.y,)


class Proportional(gb.Controller):
    """u = k (r - y)."""

    rate = 1 / STEP
    inputs, setpoints, outputs = ("y",), ("r",), ("u",)

    def update(self, x, u, p):
        return (), (1.5 * (u.r - u.y),)


@pytest.mark.parametrize("closed", [False, True])
def test_gains_are_those_of_the_sampled_loop(closed):
    wanted = [9.0, 2.0, 4.25]
    options = (
        {"excitation": "r", "controller": Proportional()}
        if closed
        else {"excitation": "u", "controller": None}
    )
    signals = ["y", "u"] if closed else ["y"]
    omega, gains = loop_gains(
        Lag(), {"K": 3.0}, wanted, signals, amplitude=0.5, rate=1 / STEP, **options
    )
    # Lines of four periods of the lowest frequency.
    assert omega == pytest.approx(np.sort(wanted), abs=0.26)
    assert np.rint(4 * omega / omega[0]) == pytest.approx(4 * omega / omega[0], abs=1e-6)
    z, a = np.exp(1j * omega * STEP), np.exp(-STEP / 0.5)
    plant = 3 * (1 - a) / (z - a)
    expected = (
        {"y": 1.5 * plant / (1 + 1.5 * plant), "u": 1.5 / (1 + 1.5 * plant)}
        if closed
        else {"y": plant}
    )
    assert set(gains) == set(signals)
    for name, truth in expected.items():
        assert gains[name] == pytest.approx(truth, rel=1e-3)
