"""From a log to a model in one go, held against a simulator's truth."""

from dataclasses import replace

import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.identification.choices import choose
from greybox.problems import sitl_pitch


@pytest.fixture(scope="module")
def flown():
    return gb.identify(sitl_pitch.LOG)


def test_the_simulators_truth_is_within_two_standard_errors(flown):
    fit = flown.fit
    assert flown.chosen.model == "rate:DampedAngle"
    for name, truth in sitl_pitch.published["values"].items():
        assert abs(fit.estimate[name] - truth) < 2 * fit.standard_error[name], name


def test_the_chain_says_what_it_chose(flown):
    text = str(flown)
    for words in (
        "tests of SINE: the message announces them (--announced)",
        "axis pitch: its setpoint moves most (--axis)",
        "input u=RATE.POut: the control of pitch (--input)",
        "output theta=ATT.Pitch: the pitch angle, at 5",
        "closed loop (ATT.DesPitch is in the log)",
        "Structure 3 is chosen",
        "Hold the model against a flight that it has not seen",
    ):
        assert words in text
    assert flown.comparison.value("BIC less the least", "1") > 100
    assert len(flown.measurement.response) == 10


def made_log(**extra):
    """A sweep of the roll setpoint, with angles in two messages, one of them slow."""
    time, slow = np.arange(0, 80, 0.01), np.arange(0, 80, 0.1)
    inside = (time > 10) & (time < 70)
    phase = 0.5 * (time - 10) + 4.5 / 120 * (time - 10) ** 2
    setpoint = np.where(inside, 5 * np.sin(phase), 0)
    roll = setpoint + 0.01 * np.random.default_rng(0).normal(size=time.size)
    records = {
        "ATT": Record(slow, {"DesRoll": np.interp(slow, time, setpoint), "Roll": np.interp(slow, time, roll)}),
        "ANG": Record(time, {"DesRoll": setpoint, "Roll": roll}, {"Roll": "deg"}),
        "RATE": Record(time, {"ROut": setpoint - roll, "R": np.gradient(roll, 0.01)}),
        **extra,
    }
    return Recording(records, "made.bin")


def test_the_best_sampled_signal_is_chosen():
    settings, choices = choose(made_log())
    assert settings.output == "phi=ANG.Roll"
    assert settings.input == "u=RATE.ROut"
    assert "the roll angle, at 100 Hz, ATT.Roll at 10 Hz" in str(choices[-1])


def test_what_is_stated_is_kept():
    settings, choices = choose(made_log(), output="p=RATE.R", band=(1.0, 4.0), settle=3.0)
    assert (settings.output, settings.band, settings.settle) == ("p=RATE.R", (1.0, 4.0), 3.0)
    assert not any(choice.option == "--output" for choice in choices)
    with pytest.raises(ValueError, match="no usable test has the axis 'yaw'; there are roll"):
        choose(made_log(), axis="yaw")


def test_a_log_without_a_test_says_how_to_name_one():
    log = made_log()
    still = replace(
        log, records={name: r.with_signals(DesRoll=0 * r.time) for name, r in log.items() if name != "RATE"}
    )
    with pytest.raises(ValueError, match=r"no usable test was found in made\.bin: say where they are, --announced"):
        choose(still)
