"""From a log to a model in one go, held against a simulator's truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.identification.choices import choose
from greybox.identification.identify import FittedStep, _closer
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
        "Structure 3 (4 free) is supported",
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


@pytest.fixture(scope="module")
def filtered_rate_log():
    """A sweep of the control through K / ((T s + 1)(s + a)), logged behind the gyro's low-pass filter and its notch."""
    from scipy.signal import bilinear, chirp, lfilter, lsim

    time = np.arange(0, 60, 0.0025)
    inside = (time > 2) & (time < 58)
    u = np.where(inside, 0.1 * chirp(time - 2, 0.15, 56, 12, method="logarithmic", phi=-90), 0)
    rate = lsim(([90], [0.05, 1 + 0.05 * 0.7, 0.7]), u, time)[1]
    notch, low_pass = 2 * np.pi * 60, 2 * np.pi * 20
    width = notch * (16 / 9 - 1) / (4 / 3)  # of a bandwidth of 30 Hz: the lower edge lies at 45, the upper at 80 Hz
    for b, a in (
        ([1, 0.01 * width, notch**2], [1, width, notch**2]),
        ([low_pass**2], [1, 2**0.5 * low_pass, low_pass**2]),
    ):
        rate = lfilter(*bilinear(b, a, 400), rate)
    rate += 0.01 * np.random.default_rng(3).normal(size=time.size)
    settings = {"INS_GYRO_FILTER": 20.0, "INS_NOTCH_ENABLE": 1, "INS_NOTCH_FREQ": 60, "INS_NOTCH_ATT": 40}
    records = {
        "RATE": Record(time, {"POut": u, "P": rate}, {"P": "rad/s"}, hold={"POut": 0.0, "P": 0.0}),
        "SIDD": Record(time, {"Targ": u}),
    }
    return Recording(records, "made.bin", metadata={"parameters": settings | {"INS_NOTCH_BW": 30}})


def test_filters_of_the_log_are_in_series_with_the_model(filtered_rate_log):
    stated = {"input": "u=RATE.POut", "output": "q=RATE.P", "setpoint": "SIDD.Targ", "band": (1.5, 60.0), "starts": 5}
    ladder = [("rate:DampedRotation", (), "rate damping")]
    found = gb.identify(filtered_rate_log, ladder=ladder, **stated)
    assert found.chosen.through == ("gyro-notch", "gyro-filter")
    truth = {"K_phi": 90, "a": 0.7, "T_rotor": 0.05, "T_delay": 0}
    for name, value in truth.items():
        assert abs(found.fit.estimate[name] - value) < 3 * found.fit.standard_error[name] + 1e-4, name
    # What the filters delay at low frequencies, 2 ζ / ω_c and (1 - 0.01) / (Q ω_0), is in the other lag and delay.
    lag = 2**0.5 / (2 * np.pi * 20) + 0.99 * 7 / 12 / (2 * np.pi * 60)
    without = found.unfiltered.fit.estimate
    assert without["T_delay"] + without["T_rotor"] == pytest.approx(0.05 + lag, abs=0.003)
    assert "Lag and delay with and without the gyro-notch and gyro-filter" in str(found)
    assert "--through gyro-notch gyro-filter" in found.commands()[-1]
    about = found.measurement.response.about
    assert about["gyro-filter"] == "LowPass(20.0, 0.7071067811865476)"

    as_logged = gb.identify(filtered_rate_log, ladder=ladder, through=(), **stated)
    assert (as_logged.chosen.through, as_logged.unfiltered) == ((), None)
    with pytest.raises(ValueError, match="tells of no such filter; it tells of gyro-filter, gyro-notch"):
        gb.identify(filtered_rate_log, ladder=ladder, through=("d-term-filter",), **stated)


def test_the_signals_of_px4_are_known():
    time = np.arange(0, 60, 0.004)
    setpoint = np.where((time > 5) & (time < 55), 0.1 * np.sin(3 * (time - 5)), 0)
    records = {
        "vehicle_attitude_setpoint": Record(
            time, {"pitch": setpoint, "roll": 0 * time}, {"pitch": "rad", "roll": "rad"}
        ),
        "vehicle_attitude": Record(time, {"pitch": 0.9 * setpoint}, {"pitch": "rad"}),
        "vehicle_torque_setpoint": Record(time, {"xyz[0]": 0 * time, "xyz[1]": np.gradient(setpoint)}),
    }
    settings, choices = choose(Recording(records, "made.ulg"))
    assert (settings.input, settings.output) == ("u=vehicle_torque_setpoint.xyz[1]", "theta=vehicle_attitude.pitch")
    assert "axis pitch: vehicle_attitude_setpoint.pitch moves" in str(choices[0])


def test_a_structure_that_fails_close_to_the_data_is_named():
    """It may be the right one: of data without noise, the last digits of a minimum are not reached by every search."""
    unfinished = SimpleNamespace(converged=False, status="stagnated", cost=0.42, stage="")
    failed = SimpleNamespace(converged=False, runs=[unfinished], free=("K", "a"))
    found = SimpleNamespace(converged=True, runs=[], free=("K", "a", "b"), cost=0.41)
    steps = [FittedStep(name, (), "", (), "", fit) for name, fit in (("rate:A", failed), ("tilt:B", found))]
    (said,) = _closer(steps, steps[1])
    assert said.startswith(
        "Structure 1 did not converge, but came to a cost of 0.42 where the chosen one has 0.41: fit"
    )
    assert _closer(steps[1:], steps[1]) == []
