import math

import numpy as np
import pytest
from resonance_records import RATE, covered, record, resonance
from scipy.signal import freqz, lfilter

from greybox.data.record import Record
from greybox.experiment.multisine import multisine
from greybox.spectral.composite_windows import spectral_response
from greybox.spectral.multisine_lines import periodic_response


def test_multisine_in_steady_state_is_exact():
    b, a = resonance()
    made = multisine(0.6, 25.0, 20.0, RATE, periods=14)
    flown = record(u=made["u"], theta=lfilter(b, a, made["u"]) + 3.0).between(200.0, 1e9)
    got = periodic_response(flown, 20.0)
    step = 2 * math.pi / 20
    np.testing.assert_allclose(got.omega, step * np.array(made.settings["harmonics"]["u"]))
    assert np.abs(got.response / freqz(b, a, got.omega / RATE)[1] - 1).max() < 1e-9


def test_two_inputs_at_once():
    b, a = resonance()
    made = multisine(0.6, 25.0, 20.0, RATE, signals=["p", "q"], periods=14)
    y = lfilter(b, a, made["p"]) + 2 * lfilter([0.1], [1, -0.9], made["q"])
    flown = record(p=made["p"], q=made["q"], y=y).between(200.0, 1e9)
    first, second = (periodic_response(flown, 20.0, name, "y") for name in "pq")
    assert np.abs(first.response / freqz(b, a, first.omega / RATE)[1] - 1).max() < 1e-9
    assert np.abs(second.response / (2 * freqz([0.1], [1, -0.9], second.omega / RATE)[1]) - 1).max() < 1e-9
    assert not set(np.rint(first.omega * 1e6)) & set(np.rint(second.omega * 1e6))


def test_scatter_of_periods_covers():
    b, a = resonance()
    made = multisine(0.6, 20.0, 10.0, RATE, points=8, periods=9)
    clean = lfilter(b, a, made["u"])
    omega = 2 * math.pi / 10 * np.array(made.settings["harmonics"]["u"])
    rng = np.random.default_rng(2)
    hits = []
    for _ in range(100):
        flown = record(u=made["u"], theta=clean + 0.2 * rng.standard_normal(clean.size)).between(20.0, 1e9)
        got = periodic_response(flown, 10.0, omega=omega)
        hits.append(covered(got, freqz(b, a, got.omega / RATE)[1]).mean())
    assert 0.935 <= np.mean(hits) <= 0.965
    np.testing.assert_allclose(got.dof, 12)


def test_periodic_and_windowed_estimates_agree():
    b, a = resonance()
    made = multisine(1.0, 20.0, 10.0, RATE, periods=12)
    rng = np.random.default_rng(3)
    flown = record(u=made["u"], theta=lfilter(b, a, made["u"]) + 0.05 * rng.standard_normal(made.time.size))
    exact = periodic_response(flown.between(20.0, 1e9), 10.0)
    windowed = spectral_response(flown, omega=exact.omega, windows=[20.0])
    difference = np.abs(exact.response - windowed.response)
    assert np.mean(difference < 3 * np.sqrt(exact.variance + windowed.variance)) > 0.95


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r: periodic_response(r, 3.001), "whole number"),
        (lambda r: periodic_response(r, 15.0), "fewer than three periods"),
        (lambda r: periodic_response(r, 2.0, omega=[4.0]), "not a multiple"),
    ],
)
def test_mistakes_are_sentences(call, words):
    u = np.random.default_rng(0).standard_normal(30 * RATE)
    with pytest.raises(ValueError, match=words):
        call(record(u=u, theta=u))


def test_lines_that_the_output_does_not_answer_are_left_out():
    """A notch of the plant at three of the lines leaves noise there, which is said; asked for, they are given."""
    time = np.arange(6000) / 50
    lines = np.arange(2, 30)
    passed = lines[(lines < 10) | (lines > 12)]
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, 30)
    u, y = (sum(np.sin(2 * np.pi * k / 10 * time + phase[k]) for k in some) for some in (lines, passed))
    data = Record(time, {"u": u, "y": y + 0.3 * np.random.default_rng(5).standard_normal(time.size)})
    found = periodic_response(data, 10.0, "u", "y")
    assert found.about["dropped"] == "3 of 28 points, of a coherence below 0.6, at 6.283 to 7.54 rad/s"
    assert len(found) == 25
    assert len(periodic_response(data, 10.0, "u", "y", omega=2 * np.pi / 10 * lines)) == 28
