import math

import numpy as np
import pytest
from resonance_records import RATE, covered, record, resonance
from scipy.signal import freqz, lfilter

from greybox.data.frequency_response import Stretch
from greybox.data.record import Record
from greybox.data.spectral.multisine_lines import periodic_response, whole_periods
from greybox.data.spectral.uniform_stretches import UniformStretch
from greybox.workflows.experiment.multisines import multisine

RECORD = Record(np.arange(2.0), {"u": np.zeros(2)})


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
    assert (
        np.abs(second.response / (2 * freqz([0.1], [1, -0.9], second.omega / RATE)[1]) - 1).max()
        < 1e-9
    )
    assert not set(np.rint(first.omega * 1e6)) & set(np.rint(second.omega * 1e6))


def test_scatter_of_periods_covers():
    b, a = resonance()
    made = multisine(0.6, 6.0, 10.0, RATE, periods=9)
    clean = lfilter(b, a, made["u"])
    rng = np.random.default_rng(2)
    hits = []
    for _ in range(100):
        flown = record(u=made["u"], theta=clean + 0.2 * rng.standard_normal(clean.size)).between(
            20.0, 1e9
        )
        got = periodic_response(flown, 10.0)
        hits.append(covered(got, freqz(b, a, got.omega / RATE)[1]).mean())
    assert 0.935 <= np.mean(hits) <= 0.965
    np.testing.assert_allclose(got.dof, 12)


@pytest.mark.parametrize("joint", [False, True])
def test_an_estimate_is_that_of_its_matrices(joint):
    """By matrices that are written out."""
    rng = np.random.default_rng(2)
    n, count, line = 15, 20, 3
    u, r, v = rng.standard_normal((3, n, count))
    u += 3 * np.sin(2 * math.pi * line / count * np.arange(count))
    signals = {"u": u, "r": u + r if joint else u, "theta": 2 * u + v}
    period = count / RATE
    got = periodic_response(
        record(**{name: x.ravel() for name, x in signals.items()}),
        period,
        instrument="r",
    )
    got = got.where(np.isclose(got.omega, 2 * math.pi * line / period))

    def at(name, line):
        return signals[name] @ np.exp(-2j * math.pi * line / count * np.arange(count))

    x, z, y = (at(name, line) for name in ("u", "r", "theta"))
    a = z.conj() / np.vdot(z, x)
    q = np.eye(n) - np.outer(x, a)
    m = q @ q.conj().T
    noise = np.linalg.norm(q @ y) ** 2 / np.trace(m).real
    assert got.response == pytest.approx(a @ y)
    assert got.dof == pytest.approx(2 * np.trace(m).real ** 2 / np.trace(m @ m).real)
    # With an instrument, the neighbors say how strongly it moves the input.
    own, *beside = (
        abs(np.vdot(at("r", k), at("u", k))) / np.linalg.norm(at("r", k)) ** 2
        for k in (line, 1, 2, 4, 5)
    )
    factor = (own / np.exp(np.mean(np.log(beside)))) ** 4 if joint else 1
    assert got.variance == pytest.approx(factor * noise * np.linalg.norm(a) ** 2)
    shares = [abs(np.vdot(z, b)) ** 2 / (np.vdot(z, z) * np.vdot(b, b)).real for b in (y, x)]
    if not joint:
        assert got.coherence == pytest.approx(min(shares))


@pytest.mark.parametrize(("factor", "weak"), [(0.98, False), (1.02, True)])
def test_an_instrument_is_weak_if_it_explains_less_than_ten_times_the_noise(factor, weak):
    """What it explains of the input is |rᴴu|²/|r|², and the noise the rest over n - 1."""
    rng = np.random.default_rng(6)
    n = 12
    r, noise = rng.standard_normal((2, n)) + 1j * rng.standard_normal((2, n))
    noise -= r * np.vdot(r, noise) / np.vdot(r, r)
    noise *= np.linalg.norm(r) * math.sqrt((n - 1) / 10) * factor / np.linalg.norm(noise)
    u = r + noise

    def periods(amplitudes):
        """Four lines of forty samples, with one noise, so that neighbors expect what is there."""
        lines = np.exp(2j * math.pi * np.outer(range(2, 6), np.arange(40)) / 40).sum(axis=0)
        return np.outer(amplitudes, lines).real.ravel()

    data = record(u=periods(u), theta=periods(2 * u + 0.01 * r.conj()), r=periods(r))
    if weak:
        with pytest.raises(ValueError, match="hardly moves u"):
            periodic_response(data, 40 / RATE, instrument="r")
    else:
        assert len(periodic_response(data, 40 / RATE, instrument="r")) == 4


def test_noise_does_not_choose_the_lines_of_a_loop():
    """Joint estimates in gusts: of the lines that are left, errors are as large as stated.

    With their own coherence to choose them, the rms of normalized errors is 1.40 instead of 1.15,
    the root of the mean 4/3 of F with 2 and 8 degrees of freedom.
    """
    omega = 2 * np.pi / 20 * np.arange(3, 120, 4)
    s = 1j * omega
    plant, law = 20 / (s * (0.1 * s + 1)), 1.2 * (1 + 0.05 * s)
    loop = 1 / (1 + plant * law)
    time = np.arange(400) / 20
    waves = np.exp(1j * np.outer(omega, time))
    squares = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        injected = np.exp(2j * np.pi * random.random(omega.size)) * np.ones((5, 1))
        gust = 3 * plant / np.abs(1 + s / 2) * (random.normal(size=(5, omega.size, 2)) @ [1, 1j])
        signals = {
            "r": injected,
            "u": loop * (injected - law * gust),
            "theta": loop * (plant * injected + gust),
        }
        data = Record(
            np.arange(2000) / 20, {n: (x @ waves).real.ravel() for n, x in signals.items()}
        )
        got = periodic_response(data, 20.0, instrument="r")
        true = np.interp(got.omega, omega, plant)
        squares += [*(np.abs(got.response - true) ** 2 / got.variance)]
    assert len(squares) > 1000
    assert 1.05 < np.sqrt(np.mean(squares)) < 1.25


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda r: periodic_response(r, 3.001), "whole number"),
        (lambda r: periodic_response(r, 15.0), "needs at least three"),
    ],
)
def test_mistakes_are_sentences(call, words):
    u = np.random.default_rng(0).standard_normal(30 * RATE)
    with pytest.raises(ValueError, match=words):
        call(record(u=u, theta=u))


def test_lines_that_the_output_does_not_answer_are_left_out():
    """A notch of the plant at three of the lines leaves noise there, which is said."""
    time = np.arange(6000) / 50
    lines = np.arange(2, 30)
    passed = lines[(lines < 10) | (lines > 12)]
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, 30)
    u, y = (
        sum(np.sin(2 * np.pi * k / 10 * time + phase[k]) for k in some) for some in (lines, passed)
    )
    data = Record(
        time, {"u": u, "y": y + 0.3 * np.random.default_rng(5).standard_normal(time.size)}
    )
    found = periodic_response(data, 10.0, "u", "y")
    assert (
        found.about["dropped"]
        == "3 of 28 points, with a coherence below 0.6, or too uncertain at an end, at 6.283 to 7.54 rad/s"
    )
    assert len(found) == 25


@pytest.mark.parametrize(("samples", "left_out"), [(30, 0), (37, 7), (9, 9)])
def test_the_last_whole_periods_are_kept(samples, left_out):
    """Of ten samples each, which take a hundred thousandth less than the period that is stated."""
    values, origin = (
        np.arange(2.0 * samples).reshape(2, samples),
        Stretch("x", 5.0, 5.0 + 0.1 * (samples - 1)),
    )
    kept = whole_periods(UniformStretch(values, 0.1 * (1 - 9e-6), origin, RECORD), 1.0)
    np.testing.assert_array_equal(kept.values, values[:, left_out:])
    assert (kept.step, kept.record) == (0.1, RECORD)
    assert kept.origin.start == pytest.approx(min(5 + 0.1 * left_out, origin.end), abs=1e-4)
    assert (kept.origin.end, kept.origin.checksum) == (origin.end, "x")


def test_a_period_is_a_whole_number_of_samples_two_at_least():
    values = np.zeros((2, 40))
    rest = Stretch("x", 0.0, 40.0), RECORD
    for step in (0.1 * (1 + 1.1e-5), 0.1 * (1 - 1.1e-5)):
        with pytest.raises(
            ValueError,
            match=r"a period of 1 s has (10\.0001|9\.99989) samples: resample",
        ):
            whole_periods(UniformStretch(values, step, *rest), 1.0)
    with pytest.raises(ValueError, match="a period of 1 s has 1 samples"):
        whole_periods(UniformStretch(values, 1.0, *rest), 1.0)
    assert whole_periods(UniformStretch(values, 0.5, *rest), 1.0).values.shape == (2, 40)


def test_three_periods_are_the_fewest():
    rng = np.random.default_rng(0)
    u = np.tile(rng.standard_normal(50), 3)
    y = 3 * u + 0.1 * rng.standard_normal(150)
    found = periodic_response(record(u=u, theta=y), 50 / RATE)
    assert found.dof == pytest.approx(4)
    with pytest.raises(ValueError, match="needs at least three"):
        periodic_response(record(u=u[:149], theta=y[:149]), 50 / RATE)


def test_lines_are_excited_from_three_hundredths_of_the_largest_on():
    """Of sines with amplitudes from 1 down to 0.029, up to the last line below half of the sampling rate."""
    amplitude = {2: 0.5, 5: 1.0, 9: 0.031, 12: 0.029, 24: 0.4}
    period, t = 50 / RATE, np.arange(200) / RATE
    u = sum(a * np.sin(2 * math.pi * k / period * t + k) for k, a in amplitude.items())
    found = periodic_response(record(u=u, theta=2 * u), period)
    assert found.omega * period / (2 * math.pi) == pytest.approx([2, 5, 9, 24])
    assert found.response == pytest.approx(2)


def test_weights_do_not_favor_lines_that_feedback_made_strong():
    """A gain of 2 in a loop: its mean by the variances; by the input's own power it is off."""
    rng, n, lines, samples = np.random.default_rng(0), 6, 800, 2048
    e = np.tile(np.exp(2j * math.pi * rng.random(lines)), (n, 1))
    v = 0.6 * (rng.standard_normal((n, lines, 2)) @ [1, 1j]) / math.sqrt(2)
    u = (e - v) / 3  # feedback of the output: u = e - (2 u + v)
    signals = {}
    for name, values in (("u", u), ("r", e), ("theta", 2 * u + v)):
        spectrum = np.zeros((n, samples // 2 + 1), complex)
        spectrum[:, 1 : lines + 1] = values
        signals[name] = np.fft.irfft(spectrum, samples).ravel()
    got = periodic_response(record(**signals), samples / RATE, instrument="r")
    kept = np.round(got.omega * samples / RATE / (2 * math.pi)).astype(int) - 1
    assert len(kept) > 0.98 * lines

    def deviation(weight):
        error = math.sqrt(1 / 2) * np.linalg.norm(weight * np.abs(got.response - 2))
        return (weight @ (got.response - 2).real) / error

    assert abs(deviation(1 / got.variance)) < 2.5
    assert abs(deviation(np.abs(u.mean(axis=0)[kept]) ** 2)) > 4
