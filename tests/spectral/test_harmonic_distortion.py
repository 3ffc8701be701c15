"""Harmonics that a linear plant does not explain, from tests of known plants behind known nonlinearities."""

import math

import numpy as np

from greybox.data.record import Record
from greybox.data.test_segment import Segment
from greybox.spectral.single_sine import finite_frequency

STEP, OMEGAS = 0.01, (2.0, 3.0, 4.5, 7.0, 10.0)


def truth(omega):
    return 40 / (1j * omega * (1j * omega + 4))


def flown(nonlinearity, noise=1e-3, harmonics=0.0, sensor=None):
    """Sines through a nonlinearity at the plant's input: the periodic steady state, by its Fourier series."""
    time, u, y, segments = [], [], [], []
    rng = np.random.default_rng(1)
    start = 0.0
    for omega in OMEGAS:
        n = round(12 * 2 * math.pi / omega / STEP)
        t = np.arange(n) * STEP
        control = np.sin(omega * t) + harmonics * np.sin(3 * omega * t + 0.4)
        phases = 2 * np.pi * np.arange(512) / 512
        one = np.fft.rfft(nonlinearity(np.sin(phases) + harmonics * np.sin(3 * phases + 0.4))) / 256
        response = sum((one[k] * truth(k * omega) * np.exp(1j * k * omega * t)).real for k in range(1, 20))
        time.append(start + t)
        u.append(control)
        response = sensor(response) if sensor else response
        y.append(response + noise * rng.normal(size=n))
        segments.append(Segment(start, start + t[-1], omega=omega))
        start += n * STEP + 5
    record = Record(np.concatenate(time), {"u": np.concatenate(u), "theta": np.concatenate(y)})
    return finite_frequency(record, segments, settle=0)


def test_harmonics_of_the_control_are_those_of_a_linear_plant():
    found = flown(lambda u: u, harmonics=0.2)
    assert all(p.unexplained == 0 for p in found.points)
    assert not any("does not explain" in text for text in found.findings)
    assert np.abs(found.response.response / truth(found.response.omega) - 1).max() < 0.01


def test_a_clipped_input_is_found_and_covered():
    """Behind the log: the harmonics in the output are small, as the plant takes them away."""
    found = flown(lambda u: np.clip(u, -0.75, 0.75))
    error = np.abs(found.response.response / truth(found.response.omega) - 1)
    stated = np.sqrt(found.response.variance) / np.abs(found.response.response)
    assert error.min() > 0.08
    assert np.all(error < 3 * stated)
    assert max(p.distortion[1] for p in found.points[2:]) < 0.03
    assert "does not explain harmonics" in " ".join(found.findings)


def test_harmonics_of_a_sensor_are_not_those_of_the_plant():
    """0.4 % of the output at three times the highest frequency would be a tenth of the control there."""
    found = flown(lambda u: u, sensor=lambda y: y + 0.004 * y**2 / np.abs(y).max())
    assert max(p.unexplained for p in found.points) < 0.003


def test_noise_is_not_taken_for_harmonics():
    found = flown(lambda u: u, noise=0.05)
    assert max(p.unexplained for p in found.points) == 0
