"""Harmonics that a linear plant does not explain, from tests of known plants behind known nonlinearities."""

import math

import numpy as np
import pytest

from greybox.data.excited_segment import Segment
from greybox.data.record import Record
from greybox.data.spectral import harmonic_distortion
from greybox.data.spectral.demodulation import spectral_line
from greybox.data.spectral.single_sine import finite_frequency

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
        response = sum(
            (one[k] * truth(k * omega) * np.exp(1j * k * omega * t)).real for k in range(1, 20)
        )
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


def test_harmonics_have_the_lines_beside_them():
    """Of 5 periods two on either side; of 3 one, of 1 none."""
    omega = 2 * math.pi
    for periods, expected in ((9, (1, -1, 2, -2)), (5, (1, -1, 2, -2)), (3, (1, -1)), (1, ())):
        t = 0.3 + np.arange(100 * periods) / 100
        x = np.random.default_rng(0).normal(size=(2, t.size))
        amplitudes = np.array([[1, 0.2j, 0.1], [3, 0.3, -0.4j]])
        found = harmonic_distortion.harmonics_of(t, amplitudes, x, omega, periods)
        assert (found.omega, found.sine) == (omega, 3)
        np.testing.assert_array_equal(found.control, [0.2j, 0.1])
        np.testing.assert_array_equal(found.output, [0.3, -0.4j])
        assert found.beside.shape == (2, 2, len(expected))
        for i, k in enumerate((2, 3)):
            for j, m in enumerate(expected):
                line = spectral_line(t, x, omega * (k + m / periods))
                np.testing.assert_allclose(found.beside[i, :, j], line)


def test_what_is_unexplained_is_beyond_the_errors_of_the_plant_and_the_noise():
    """Of 1/(jω), known from 1 to 4 rad/s: harmonics of 2 rad/s, of which the second and third lie beyond."""
    omega = np.array([1.0, 2.0, 4.0])
    response = 1 / (1j * omega)
    control, e, at = (
        np.array([0.1, 0.2j, 0.05]),
        np.array([0.3, 0.2, 0.2j]),
        np.array([4.0, 6.0, 8.0]),
    )
    beside = np.full((3, 2, 2), 0.005 + 0j)
    found = harmonic_distortion.Harmonics(2.0, 0.5, control, (control + e) / (1j * at), beside)
    noise = np.abs(0.005 * 1j * at - 0.005)
    assert np.all(np.abs(e) > 3 * noise)
    allowed = np.where(at > 4, 0.5, 0.1) * np.abs(control) + 0.005 * 0.5 * at
    expected = np.sqrt(np.sum((np.abs(e) - allowed) ** 2)) / 0.8
    share = harmonic_distortion.unexplained(omega, response, 0.8, found)
    assert share == pytest.approx(expected)
    # Noise three times as large hides all but the first.
    hidden = np.abs(e) / 3 / np.abs(1j * at - 1)
    loud = np.abs(np.array([0.9, 1.1, 1.1]) * hidden)[:, None, None] * np.ones((3, 2, 2))
    alone = (abs(e[0]) - allowed[0]) / 0.8
    share = harmonic_distortion.unexplained(omega, response, 0.8, found._replace(beside=loud))
    assert share == pytest.approx(alone)
    for u, some in ((0.0, found), (0.8, found._replace(beside=beside[:, :, :0]))):
        assert math.isnan(harmonic_distortion.unexplained(omega, response, u, some))
    assert math.isnan(harmonic_distortion.unexplained(omega[:1], response[:1], 0.8, found))


def test_a_plant_is_read_off_along_straight_lines_of_its_logarithm():
    """Those of 3 / (jω)^1.5, which is one, between, below and beyond the frequencies that are known."""
    omega = np.array([1.0, 2.0, 7.0, 9.0])
    at = np.array([1.0, 3.3, 8.0, 30.0])
    exact = 3 / (1j * at) ** 1.5
    np.testing.assert_allclose(
        harmonic_distortion.interpolated(omega, 3 / (1j * omega) ** 1.5, at), exact
    )
