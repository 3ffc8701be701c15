"""Responses of several inputs at once, held against the plant that made the record."""

import numpy as np
import pytest

from greybox.data.files.numbers_in_text import number
from greybox.data.record import Record, Recording
from greybox.workflows.identification.matrix import measure_matrix

PERIOD, RATE = 8.0, 20.0
LINES = {"a": np.arange(2, 40, 2), "b": np.arange(3, 40, 2)}
GAINS = {"p": (2.0, -1.0), "q": (0.5, 3.0)}  # of y = K u / (0.5 s + 1)


def flown():
    """Five periods between rests, with one excitation for each input."""
    count = round(PERIOD * RATE)
    omega = 2 * np.pi / PERIOD * np.arange(count // 2 + 1)
    spectra = {}
    for name, lines in LINES.items():
        spectra[name] = np.zeros(omega.size, dtype=complex)
        spectra[name][lines] = np.exp(1j * lines**2)
    moved = {name: np.tile(np.fft.irfft(s, count) * count, 5) for name, s in spectra.items()}
    lag = 1 / (0.5j * omega + 1)
    noise = np.random.default_rng(0)
    signals = {f"e_{name}": values for name, values in moved.items()} | moved
    for name, gains in GAINS.items():
        whole = sum(k * s for k, s in zip(gains, spectra.values(), strict=True)) * lag
        y = np.tile(np.fft.irfft(whole, count) * count, 5)
        signals[name] = y + 0.01 * noise.normal(size=y.size)
    rest = np.zeros(round(2.5 * RATE))
    signals = {name: np.concatenate([rest, values, rest]) for name, values in signals.items()}
    time = np.arange(rest.size * 2 + 5 * count) / RATE
    return Recording({"FLY": Record(time, signals)}, "made.csv")


SIGNALS = (["FLY.a", "FLY.b"], ["p=FLY.p", "FLY.q"])


@pytest.fixture(scope="module")
def found():
    return measure_matrix(
        flown(), *SIGNALS, PERIOD, excitations=["FLY.e_a", "FLY.e_b"], settle=4.0, band=(2.0, 20.0)
    )


def test_every_output_has_a_response_to_every_input(found):
    assert [(r.output, r.input) for r in found.responses] == [
        ("p", "a"),
        ("p", "b"),
        ("q", "a"),
        ("q", "b"),
    ]
    for response in found.responses:
        lines = LINES[response.input] * 2 * np.pi / PERIOD
        assert response.omega == pytest.approx(lines[(lines >= 2) & (lines <= 20)])
        truth = GAINS[response.output]["ab".index(response.input)] / (0.5j * response.omega + 1)
        standardized = np.abs(response.response - truth) / np.sqrt(response.variance)
        assert 0.3 < np.sqrt(np.mean(standardized**2)) < 2


def test_what_was_used_is_said_and_tabulated(found):
    assert found.record.time[[0, -1]] == pytest.approx(
        [6.45, 42.5], abs=0.06
    )  # settled, to the end of the excitation
    first, loop = found.choices
    begin, end = found.record.time[[0, -1]]
    assert first.startswith(f"from {begin:.2f} to {end:.2f} s at 20 Hz: 4 periods of 8 s")
    for words in ("open loop", "whole periods", "FLY.e_a, FLY.e_b", "instrument=..."):
        assert words in loop
    lines = str(found).splitlines()
    assert lines[0].split() == [
        "output",
        "input",
        "points",
        "from",
        "rad/s",
        "to",
        "rad/s",
        "error",
        "%",
    ]
    for line, r in zip(lines[2:6], found.responses, strict=True):
        error = 100 * np.median(np.sqrt(r.variance / 2) / np.abs(r.response))
        ends = [number(float(r.omega[k]), 4) for k in (0, -1)]
        assert line.split() == [r.output, r.input, str(len(r)), *ends, number(float(error), 2)]
    assert lines[6:] == ["", first, loop]
    assert repr(found) == "<MatrixMeasurement 4 responses>"


def test_without_excitations_the_inputs_tell_and_a_period_is_a_whole_number_of_samples():
    record = flown()["FLY"].between(2.5, 42.5)
    slower = Record(
        record.time * 1.02, record.signals
    )  # 19.6 Hz: 8.16 s are a period, 8 s are 156.9 samples
    found = measure_matrix(Recording({"FLY": slower}, "made.csv"), *SIGNALS, 8.16, settle=0.0)
    assert found.record.rate == pytest.approx(160 / 8.16)
    assert "at the frequencies of the inputs themselves" in found.choices[1]
    assert found.choices[0].endswith("5 periods of 8.16 s, after 0 s of settling.")
    stated = measure_matrix(
        Recording({"FLY": slower}, "made.csv"), *SIGNALS, 8.0 * 1.02, rate=100 / 8.16
    )
    assert stated.record.rate == pytest.approx(100 / 8.16)
    between = measure_matrix(Recording({"FLY": slower}, "made.csv"), *SIGNALS, 8.0)
    assert between.record.rate == pytest.approx(156 / 8)


def test_excitations_that_rest_are_told():
    still = flown()["FLY"].with_signals(e_a=np.ones(900), e_b=np.zeros(900))
    with pytest.raises(
        ValueError,
        match="no excitation moves in the log: name the injected signals, one for each input",
    ):
        measure_matrix(
            Recording({"FLY": still}), *SIGNALS, PERIOD, excitations=["FLY.e_a", "FLY.e_b"]
        )
