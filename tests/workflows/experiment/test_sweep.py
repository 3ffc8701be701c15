import math

import numpy as np
import pytest

from greybox.workflows.experiment.sweeps import sweep

HZ = 2 * math.pi


def chirp_cpp(time, magnitude, record, start_hz, stop_hz, fade_in, fade_out):
    """ArduPilot's libraries/AP_Math/chirp.cpp, written down again from its formulas."""
    low, high = HZ * start_hz, HZ * stop_hz
    constant = 2 / start_hz
    rise = math.log(high / low)
    window = np.select(
        [time <= 0, time <= fade_in, time <= record - fade_out, time <= record],
        [
            0,
            0.5 - 0.5 * np.cos(math.pi * time / fade_in),
            1,
            0.5 - 0.5 * np.cos(math.pi * (time - (record - fade_out)) / fade_out + math.pi),
        ],
    )
    late = (
        low
        * (record - constant)
        / rise
        * (np.exp(rise * (time - constant) / (record - constant)) - 1)
    )
    return (
        window * magnitude * np.sin(np.where(time <= constant, low * time - low * constant, late))
    )


def test_logarithmic_sweep_is_the_vehicles():
    made = sweep(HZ * 0.1, HZ * 6, 60, 400, amplitude=0.06)
    np.testing.assert_allclose(made["u"], chirp_cpp(made.time, 0.06, 60, 0.1, 6, 5, 5), atol=1e-9)


def test_sweep_reaches_its_frequencies():
    made = sweep(1.0, 20.0, 60, 200, dwell=0, fade_in=0, fade_out=0)
    crossings = made.time[1:][np.diff(np.sign(made["u"])) != 0]
    frequency = math.pi / np.diff(crossings)
    assert frequency[0] == pytest.approx(1.0, rel=0.15)  # rises within the half wave
    assert frequency[-1] == pytest.approx(20.0, rel=0.05)
    middle = np.interp(30, crossings[:-1], frequency)
    assert middle == pytest.approx(math.sqrt(20), rel=0.1)


def test_the_schedule_and_the_settings_say_what_is_flown():
    made = sweep(
        1.0,
        20.0,
        30.0,
        100,
        amplitude=0.2,
        fade_in=2.0,
        fade_out=1.0,
        dwell=1,
        signal="q",
    )
    assert made.schedule == (("q", "logarithmic sweep", 0.0, 0.0, 30.0, 1.0, 20.0, 0.2, 0.0),)
    assert made.settings == {
        "low": 1.0, "high": 20.0, "duration": 30.0, "amplitude": 0.2, "fade_in": 2.0, "fade_out": 1.0,
        "dwell": 1,
    }  # fmt: skip
    assert (made.time[0], made.time[-1], made.time.size) == (0.0, 30.0, 3001)
    # One period at the lowest frequency, then equal times an octave; half cosines fade at both ends.
    late = np.maximum(made.time - HZ, 0)
    octave = (30 - HZ) / math.log(20)
    phase = np.minimum(made.time, HZ) + octave * (np.exp(late / octave) - 1) - HZ
    fades = (
        np.sin(math.pi / 4 * np.minimum(made.time, 2.0)) ** 2
        * np.sin(math.pi / 2 * np.minimum(30 - made.time, 1)) ** 2
    )
    np.testing.assert_allclose(made["q"], 0.2 * fades * np.sin(phase), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: sweep(10, 1, 60, 100), "must rise"),
        (lambda: sweep(2, 2, 60, 100), "must rise"),
        (lambda: sweep(0.1, 10, 60, 100), "too short for 2 periods"),
        (
            lambda: sweep(1, 1000, 60, 50),
            "omega is 1000 rad/s: give frequencies above 0 and up to 62.83 rad/s",
        ),
        (lambda: sweep(0, 10, 60, 50), "omega is 0 rad/s"),
        (lambda: sweep(1, 10, 60, 100, fade_in=-1), "fades of -1 and"),
        (lambda: sweep(1, 10, 60, 100, fade_out=-1), "and -1 s: raise"),
        (lambda: sweep(1, 10, math.nan, 100), "nan s are too short"),
        (lambda: sweep(1, 10, 60, 100, fade_in=math.nan), "fades of nan"),
        (lambda: sweep(1, 10, 60, 100, amplitude=math.nan), "amplitude is nan"),
        (lambda: sweep(1, 10, 9, 100, dwell=0, fade_in=5, fade_out=5), "9 s are too short"),
    ],
)
def test_mistakes_are_sentences(make, words):
    with pytest.raises(ValueError, match=words):
        make()
