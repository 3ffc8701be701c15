"""From a log to a model in one go, held against a simulator's truth."""

import re
from dataclasses import replace

import numpy as np
import pytest
from linear_simulation import lsim

import greybox as gb
from greybox.data.excited_segment import Segment
from greybox.data.record import Record, Recording
from greybox.models.polynomial import Polynomial
from greybox.models.rate import DampedAngle, DampedRotation, LaggedAngle, YawRateLag
from greybox.models.tilt import LinearTilt, Tilt
from greybox.problems import sitl_pitch
from greybox.workflows.identification.choices import choose, motion
from greybox.workflows.identification.structure_fit import Structure


@pytest.fixture(scope="module")
def flown():
    return gb.identify(sitl_pitch.LOG)


def test_the_default_finds_the_simulators_structure_and_values(flown):
    """It knows no vehicle: K / (s (s + a) (T s + 1)) is b0 / (s (s² + a2 s + a1)) with b0 = K / T and so on."""
    truth = sitl_pitch.published["values"]
    lag = 1 / truth["T_rotor"]
    expected = {
        "b0": truth["K_phi"] * lag,
        "a1": truth["a"] * lag,
        "a2": truth["a"] + lag,
    }
    fit = flown.fit
    assert flown.selection.explains
    assert flown.selection.chosen.label.startswith("n = 3, m = 0, 1 integrator")
    for name, value in expected.items():
        assert abs(fit.estimate[name] - value) < 3 * fit.standard_error[name], name


def test_structures_are_fitted_on_request():
    free = ("T_rotor", "T_delay")
    listed = [
        Structure(LaggedAngle(), "rate:LaggedAngle"),
        Structure(DampedAngle(), "rate:DampedAngle", free),
        Structure(Tilt(), "tilt:Tilt", (*free, "a5")),
    ]
    found = gb.identify(sitl_pitch.LOG, structures=listed, starts=2)
    assert found.selection.chosen.label == "rate:DampedAngle"
    for name, truth in sitl_pitch.published["values"].items():
        if name == "T_delay":  # the published one contains half of the hold of the control
            assert found.fit.estimate[name] == 0
            continue
        assert abs(found.fit.estimate[name] - truth) < 2 * found.fit.standard_error[name], name
    assert set(found.selection.candidates[-1].fit.free) >= {"T_rotor", "T_delay", "a5"}
    held = gb.identify(
        sitl_pitch.LOG,
        structures=listed[1:2],
        starts=2,
        fixed={"T_rotor": 0.05},
        bounds={"a": (0, 2)},
    )
    quantities = {q.name: q for q in held.fit.quantities}
    assert (quantities["T_rotor"].kind, held.fit.estimate["T_rotor"]) == ("fixed", 0.05)
    assert quantities["a"].bounds == (0, 2)


def test_what_no_structure_has_is_refused():
    with pytest.raises(ValueError, match="has no parameter 'K_psi'"):
        gb.identify(sitl_pitch.LOG, structures=[DampedAngle()], fixed={"K_psi": 1.0})
    with pytest.raises(TypeError, match="a structure is 'rate:DampedAngle': give models"):
        gb.identify(sitl_pitch.LOG, structures=["rate:DampedAngle"])
    record = gb.Record([0.0, 1.0], {"u": [0.0, 1.0]})
    with pytest.raises(TypeError, match=r"path is <Record .*: give the name of a file"):
        gb.identify(record)


def test_the_chain_says_what_it_chose(flown):
    text = str(flown)
    for words in (
        "tests of SINE: the message announces them (announced=...)",
        "axis pitch: its setpoint moves most (axis=...)",
        "input u=RATE.POut: the control of pitch (input=...)",
        "output theta=ATT.Pitch: the pitch angle, at 5",
        "closed loop (ATT.DesPitch is in the log)",
        "free) is supported",
        "times the noise",
    ):
        assert words in text
    # The verdict is the first that it says; the coefficients of the chosen structure are details.
    assert text.split("\n\n")[1] == str(flown.fit).split("\n\n")[1]
    assert "coefficient of s^0" not in text
    assert "coefficient of s^0" in flown.details
    assert str(flown.selection) in flown.details
    assert str(flown.measurement) in flown.details
    assert repr(flown).startswith("<Identification sitl_pitch.BIN, n = 3, m = 0, 1 integrator")
    assert len(flown.measurement.response) == 10
    about = dict(flown.measurement.response.about)
    assert about.pop("log sha256") == flown.recordings[0].checksum
    assert about == {
        "log": "sitl_pitch.BIN",
        "signals": "u = RATE.POut, theta = ATT.Pitch",
        "converted": "theta from deg to rad with half a step of 0.01 deg, which the log truncates",
        "sampling": "57.166 Hz",
        "hold of the input, s": "0.0025",
        "excitation": "10 sines of 2, amplitude 3, 1 to 20.11 rad/s, 65.70 to 309.99 s",
        "estimate": "single sines",
        "errors along frequency": "independent",
        "gyro-filter": "LowPass(20.0, 0.7071067811865476)",
        "d-term-filter": "FirstOrderLowPass(20.0)",
        "target-filter": "FirstOrderLowPass(20.0)",
    }


def made_log(**extra):
    """A sweep of the roll setpoint, with angles in two messages, one of them slow."""
    time, slow = np.arange(0, 80, 0.01), np.arange(0, 80, 0.1)
    inside = (time > 10) & (time < 70)
    phase = 0.5 * (time - 10) + 4.5 / 120 * (time - 10) ** 2
    setpoint = np.where(inside, 5 * np.sin(phase), 0)
    roll = setpoint + 0.01 * np.random.default_rng(0).normal(size=time.size)
    records = {
        "ATT": Record(
            slow, {"DesRoll": np.interp(slow, time, setpoint), "Roll": np.interp(slow, time, roll)}
        ),
        "ANG": Record(time, {"DesRoll": setpoint, "Roll": roll}, {"Roll": "deg"}),
        "RATE": Record(time, {"ROut": setpoint - roll, "R": np.gradient(roll, 0.01)}),
        **extra,
    }
    return Recording(records, "made.bin")


def test_the_best_sampled_signal_is_chosen():
    settings, choices = choose(made_log())
    assert settings.output == "phi=ANG.Roll"
    assert settings.input == "u=RATE.ROut"
    assert list(map(str, choices)) == [
        "axis roll: ATT.DesRoll moves (axis=...)",
        "input u=RATE.ROut: the control of roll (input=...)",
        "output phi=ANG.Roll: the roll angle, at 100 Hz (output=...)",
    ]
    # Within 5 % of the fastest, the first of the list is as good.
    for rate, output in ((96.0, "phi=ATT.Roll"), (94.0, "phi=ANG.Roll")):
        time = np.arange(0, 80, 1 / rate)
        log = made_log()
        att = {
            name: np.interp(time, log["ANG"].time, log["ANG"][name]) for name in ("DesRoll", "Roll")
        }
        settings, choices = choose(made_log(ATT=Record(time, att)))
        assert settings.output == output


def test_of_two_axes_the_one_with_the_longer_tests_is_taken_and_the_other_is_named():
    log = made_log()
    time = log["ANG"].time
    pitch = np.where(
        (time > 10) & (time < 40), np.interp(2 * time - 10, time, log["ANG"]["DesRoll"]), 0
    )
    signals = {**log["ATT"].signals, "DesPitch": np.interp(log["ATT"].time, time, pitch)}
    fast = {**log["ANG"].signals, "DesPitch": pitch, "Pitch": pitch}
    both = made_log(
        ATT=Record(time, {n: np.interp(time, log["ATT"].time, v) for n, v in signals.items()}),
        ANG=Record(time, fast),
        RATE=log["RATE"].with_signals(POut=np.gradient(pitch)),
    )
    settings, choices = choose(both)
    assert (settings.axis, settings.input) == ("ATT.DesRoll", "u=RATE.ROut")
    assert (
        str(choices[0]) == "axis roll: ATT.DesRoll moves; there are tests of pitch too (axis=...)"
    )
    for wanted in ("pitch", "ATT.DesPitch"):
        settings, _ = choose(both, axis=wanted)
        assert (settings.axis, settings.input, settings.output) == (
            "ATT.DesPitch",
            "u=RATE.POut",
            "theta=ANG.Pitch",
        )


def test_an_unannounced_name_takes_the_axis_whose_setpoint_moves_most():
    """By its largest motion in any test, of angles that jump by a whole turn."""
    log = made_log()
    time = log["ANG"].time
    test = Record(
        time,
        {"W": np.where((time > 10) & (time < 70), 2.0, 0.0), "Seg": 0 * time, "Eta": 0 * time + 1},
    )
    yaw = Record(
        time,
        {"DesRoll": log["ANG"]["DesRoll"], "DesYaw": np.where(time % 2 < 1, 0.5, 359.5)},
        {"DesYaw": "deg"},
    )
    settings, choices = choose(made_log(TEST=test, ATT=yaw))
    assert (settings.announced, settings.input) == ("TEST", "u=RATE.ROut")
    assert str(choices[1]) == "axis roll: its setpoint moves most (axis=...)"
    controls = {name: r for name, r in made_log(TEST=test).items() if name == "TEST"}
    alone = Recording(
        {**controls, "RATE": Record(time, {"POut": np.sin(time), "ROut": 0 * time, "P": 0 * time})},
        "a.bin",
    )
    settings, _ = choose(alone)
    assert (settings.input, settings.output) == ("u=RATE.POut", "q=RATE.P")
    with pytest.raises(
        ValueError,
        match="give output=NAME=SIGNAL",
    ):
        choose(Recording({**controls, "RATE": Record(time, {"POut": np.sin(time)})}, "a.bin"))
    with pytest.raises(ValueError, match="give input=NAME=SIGNAL"):
        choose(Recording(controls, "a.bin"))


def test_what_is_stated_is_kept():
    settings, choices = choose(made_log(), output="p=RATE.R", band=(1.0, 4.0), settle=3.0)
    assert (settings.output, settings.band, settings.settle) == ("p=RATE.R", (1.0, 4.0), 3.0)
    assert not any(choice.argument == "output" for choice in choices)
    with pytest.raises(ValueError, match="no usable test has the axis 'yaw'; there are roll"):
        choose(made_log(), axis="yaw")


def test_a_log_without_a_test_says_how_to_name_one():
    log = made_log()
    still = replace(
        log,
        records={
            name: r.with_signals(DesRoll=0 * r.time) for name, r in log.items() if name != "RATE"
        },
    )
    with pytest.raises(ValueError, match="announced=MESSAGE or setpoint=SIGNAL"):
        choose(still)


@pytest.fixture(scope="module")
def filtered_rate_log():
    """A sweep of the control through K / ((T s + 1)(s + a)), logged behind the gyro's low-pass filter and its notch."""
    from scipy.signal import bilinear, chirp, lfilter

    time = np.arange(0, 32, 0.0025)
    inside = (time > 2) & (time < 30)
    u = np.where(inside, 0.1 * chirp(time - 2, 0.15, 28, 12, method="logarithmic", phi=-90), 0)
    rate = lsim(([90], [0.05, 1 + 0.05 * 0.7, 0.7]), u, time)
    notch, low_pass = 2 * np.pi * 60, 2 * np.pi * 20
    width = (
        notch * (16 / 9 - 1) / (4 / 3)
    )  # of a bandwidth of 30 Hz: the lower edge lies at 45, the upper at 80 Hz
    for b, a in (
        ([1, 0.01 * width, notch**2], [1, width, notch**2]),
        ([low_pass**2], [1, 2**0.5 * low_pass, low_pass**2]),
    ):
        rate = lfilter(*bilinear(b, a, 400), rate)
    rate += 0.01 * np.random.default_rng(3).normal(size=time.size)
    settings = {
        "INS_GYRO_FILTER": 20.0,
        "INS_NOTCH_ENABLE": 1,
        "INS_NOTCH_FREQ": 60,
        "INS_NOTCH_ATT": 40,
    }
    records = {
        "RATE": Record(time, {"POut": u, "P": rate}, {"P": "rad/s"}, hold={"POut": 0.0, "P": 0.0}),
        "SIDD": Record(time, {"Targ": u}),
    }
    return Recording(records, "made.bin", metadata={"parameters": settings | {"INS_NOTCH_BW": 30}})


def test_filters_of_the_log_are_in_series_with_the_model(filtered_rate_log):
    stated = {
        "input": "u=RATE.POut",
        "output": "q=RATE.P",
        "setpoint": "SIDD.Targ",
        "band": (1.5, 60.0),
        "starts": 2,
    }
    structures = [DampedRotation()]
    found = gb.identify(filtered_rate_log, structures=structures, **stated)
    assert found.through == ("gyro-notch", "gyro-filter")
    truth = {"K_phi": 90, "a": 0.7, "T_rotor": 0.05, "T_delay": 0}
    for name, value in truth.items():
        # A delay at its bound of zero has no standard error.
        error = np.nan_to_num(found.fit.standard_error[name])
        assert abs(found.fit.estimate[name] - value) < 3 * error + 1e-4, name
    about = found.measurement.response.about
    assert about["gyro-filter"] == "LowPass(20.0, 0.7071067811865476)"

    # Half of the log is enough for what is stated.
    stated |= {"structures": structures, "points": 8, "band": (1.5, 10.0)}
    records = {name: record.between(0, 16) for name, record in filtered_rate_log.items()}
    early = replace(filtered_rate_log, records=records)
    assert gb.identify(early, through=(), **stated).through == ()
    with pytest.raises(ValueError, match="it has gyro-filter, gyro-notch"):
        gb.identify(early, through=("d-term-filter",), **stated)


def test_the_signals_of_px4_are_known():
    time = np.arange(0, 60, 0.004)
    setpoint = np.where((time > 5) & (time < 55), 0.1 * np.sin(3 * (time - 5)), 0)
    records = {
        "vehicle_attitude_setpoint": Record(
            time, {"pitch": setpoint, "roll": 0 * time}, {"pitch": "rad", "roll": "rad"}
        ),
        "vehicle_attitude": Record(time, {"pitch": 0.9 * setpoint}, {"pitch": "rad"}),
        "vehicle_torque_setpoint": Record(
            time, {"xyz[0]": 0 * time, "xyz[1]": np.gradient(setpoint)}
        ),
    }
    settings, choices = choose(Recording(records, "made.ulg"))
    assert (settings.input, settings.output) == (
        "u=vehicle_torque_setpoint.xyz[1]",
        "theta=vehicle_attitude.pitch",
    )
    assert "axis pitch: vehicle_attitude_setpoint.pitch moves" in str(choices[0])


def test_the_motion_of_a_setpoint_is_that_during_the_tests():
    """The largest of all tests; what moves before, between and after them is none. Angles jump by a whole turn."""
    time = np.arange(0, 50, 0.01)
    inside = np.where(time < 25, 3.0, 5.0) * np.sin(2 * np.pi * time)
    is_test = ((time >= 10) & (time < 20)) | ((time >= 30) & (time < 40))
    moved = np.where(is_test, inside, 80 * np.sin(9 * time))
    record = Record(
        time, {"deg": moved, "rad": np.radians(moved) % (2 * np.pi)}, {"deg": "deg", "rad": "rad"}
    )
    log = Recording({"ATT": record})
    tests = [Segment(start, start + 9.99, omega=2 * np.pi) for start in (10.0, 30.0)]
    assert motion(log, "ATT.deg", tests) == pytest.approx(5 / np.sqrt(2), rel=1e-3)
    assert motion(log, "ATT.rad", tests) == pytest.approx(np.radians(5) / np.sqrt(2), rel=1e-3)
    assert motion(log, "ATT.deg", tests[:1]) == pytest.approx(3 / np.sqrt(2), rel=1e-3)
    assert motion(log, "ATT.other", tests) == 0.0


def test_an_axis_without_a_known_control_asks_for_the_input():
    time = np.arange(0, 60, 0.01)
    moved = np.where((time > 5) & (time < 55), 0.1 * np.sin(3 * (time - 5)), 0)
    log = Recording(
        {
            "ATT": Record(
                time, {"DesPitch": moved, "Pitch": 0.9 * moved}, {"DesPitch": "rad", "Pitch": "rad"}
            )
        }
    )
    with pytest.raises(
        ValueError,
        match="give input=u=MESSAGE",
    ):
        choose(log)


def plant_log(duration=40.0, gain=-4e-4, delay=0.03, seed=0):
    """A chirp through gain / (s (s + 2)) with a delay, from a control in hundreds to an output named y."""
    time = np.arange(0, duration, 0.01)
    rate = np.log(12 / 0.4) / (duration - 4)
    since = np.clip(time - 2, 0, duration - 4)
    u = 300 * np.sin(0.4 / rate * np.expm1(rate * since)) * (since > 0) * (since < duration - 4)
    y = lsim(([gain], [1, 2, 0]), np.interp(time - delay, time, u), time)
    y += 0.02 * np.std(y) * np.random.default_rng(seed).normal(size=time.size)
    return Recording({"log": Record(time, {"u": u, "y": y})}, "made")


OF_PLANT = {"input": "u=log.u", "output": "y=log.y", "whole": True}


@pytest.fixture(scope="module")
def plant():
    return gb.identify(plant_log(), **OF_PLANT)


def test_any_output_sign_and_unit_is_identified(plant):
    assert plant.selection.explains
    assert plant.selection.chosen.label == "n = 2, m = 0, 1 integrator, delay"
    for name, truth in {"b0": -4e-4, "a1": 2.0, "T_delay": 0.03}.items():
        assert abs(plant.fit.estimate[name] - truth) < 3 * plant.fit.standard_error[name], name


def test_several_logs_of_one_axis_are_fitted_together(plant):
    logs, chosen = [plant_log(), plant_log(seed=1)], [Polynomial(2, 0, 1, delay=0.3)]
    near = {"start": {"b0": -1e-3, "a1": 1.0}, "starts": 1}
    both = gb.identify(logs, structures=chosen, **near, **OF_PLANT)
    assert len(both.measurements) == len(both.fit.responses) == 2
    assert both.fit.standard_error["b0"] < plant.fit.standard_error["b0"]
    assert abs(both.fit.estimate["b0"] + 4e-4) < 3 * both.fit.standard_error["b0"]


def test_one_log_is_no_two():
    with pytest.raises(ValueError, match="a log is given twice"):
        gb.identify([sitl_pitch.LOG, sitl_pitch.LOG])


def test_a_structure_that_does_not_explain_the_data_says_so():
    found = gb.identify(plant_log(), structures=[YawRateLag()], starts=4, **OF_PLANT)
    assert not found.selection.explains
    assert "does not explain the data" in found.fit.warnings[0]
    assert "No structure explains the data" in str(found)
    assert "at their bound" in str(found.selection)  # the lag and the delay


def test_an_ode_is_a_structure():
    found = gb.identify(sitl_pitch.LOG, structures=[LinearTilt()], starts=2)
    assert found.selection.chosen.label == "LinearTilt"


def test_less_than_an_octave_and_noise_are_no_basis_for_a_model():
    narrow = gb.identify(plant_log(), band=(2.0, 3.5), **OF_PLANT)
    assert narrow.selection is None
    assert "less than an octave: no basis for a model" in narrow.refusals[0]
    log = plant_log()
    random = np.random.default_rng(0).normal(size=len(log["log"]))
    noise = gb.identify(Recording({"log": log["log"].with_signals(y=random)}, "noise"), **OF_PLANT)
    assert noise.fit is None
    assert any(re.search(r"coherence .*no basis for a model", text) for text in noise.refusals)
