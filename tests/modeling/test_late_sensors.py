"""Sensors of different latency: the refusal of a delayed output, and the way out that it names."""

import numpy as np
import pytest
from scipy.signal import lsim

import greybox as gb

pytestmark = pytest.mark.usefixtures("unjudged_file")

LATENCY = 0.06


class TwoSensors(gb.StateSpace):
    """A rate and its angle, whose sensor is late, as the refusal of `delays` says."""

    states, inputs, outputs = ("q", "theta", "theta_late"), ("u",), ("q", "theta")
    K = gb.Parameter(3.0, bounds=(0.1, 30))
    a = gb.Parameter(1.0, bounds=(0.1, 10))
    T = gb.Parameter(0.03, bounds=(0.001, 0.3), unit="s")

    def derivative(self, x, u, p):
        return p.K * u.u - p.a * x.q, x.q, 2 * (x.theta - x.theta_late) / p.T

    def output(self, x, u, p):
        return x.q, 2 * x.theta_late - x.theta


def test_a_delayed_output_is_refused_with_a_way_out():
    with pytest.raises(ValueError, match=r"Own\.delays.*'theta'.*2 \* x\.theta_late - theta"):
        type("Own", (TwoSensors,), {"delays": {"theta": "T"}})


def test_the_way_out_finds_the_latency_in_records_and_in_responses():
    fine = np.arange(0, 20, 0.001)
    u = np.sin(0.9 * fine) + np.sin(2.3 * fine + 1) + np.sin(4.1 * fine + 2)
    plant = ([[-2.0, 0], [1, 0]], [[5.0], [0]], np.eye(2), np.zeros((2, 1)))
    _, exact, _ = lsim(plant, u, fine)
    rows = np.arange(0, fine.size, 20)
    late = np.interp(fine[rows] - LATENCY, fine, exact[:, 1])
    noise = 1e-3 * np.random.default_rng(0).normal(size=(2, rows.size))
    signals = {"u": u[rows], "q": exact[rows, 0] + noise[0], "theta": late + noise[1]}
    fit = gb.fit(gb.Problem(TwoSensors(), gb.Record(fine[rows], signals)), starts=2, progress=False)
    assert fit.estimate["T"] == pytest.approx(LATENCY, rel=0.02)

    omega = np.geomspace(0.5, 8, 30)
    rate = 5 / (1j * omega + 2) * (1 + 1e-3 * np.exp(1j * 7 * omega**1.3))
    angle = rate / (1j * omega) * np.exp(-1j * omega * LATENCY)
    pairs = {"q": rate, "theta": angle}
    first, second = (
        gb.Problem(TwoSensors(), gb.FrequencyResponse(omega, response, "u", name))
        for name, response in pairs.items()
    )
    fit = gb.fit(first + second, starts=2, progress=False)
    assert fit.estimate["T"] == pytest.approx(LATENCY, rel=0.02)
