"""Controllers with the gains that a log holds, and the check against the logged control."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import greybox as gb
from greybox.data.record import Recording
from greybox.models import betaflight, px4
from greybox.models.ardupilot import AngleController, RateController
from greybox.models.firmware import flown_controllers, from_log, loop_of_log

ROOT = Path(__file__).parents[2]
SWEEP = ROOT / "tests" / "data" / "sitl_sweep_cut.BIN"
GAINS = {
    "P": 0.15,
    "I": 0.2,
    "D": 0.004,
    "FF": 0.01,
    "D_FF": 0.0,
    "IMAX": 0.4,
    "FLTT": 30.0,
    "FLTE": 0.0,
    "FLTD": 25.0,
}


@pytest.fixture(scope="module")
def log():
    return gb.read(SWEEP)


class Plant(gb.TransferFunction):
    input, output = "u", "theta"
    K = gb.Parameter(90.0)

    def response(self, s, p):
        return p.K / (s * (s + 0.7) * (0.05 * s + 1))


@pytest.fixture(scope="module")
def flight():
    """A flight with known gains, logged by ArduPilot's names and in its units."""
    signals = {"q": "theta_dot"}
    controllers = [AngleController(), RateController(GAINS, signals=signals)]
    t = np.arange(2400) / 400
    excitation = {"reference": 0.1 * np.sin(2 * np.pi * (0.5 * t + 0.3 * t**2))}
    record = gb.virtual_flight(
        Plant(), None, excitation, controller=controllers, noise={"theta_dot": 0.01}
    )
    columns = {
        "P": np.degrees(record["theta_dot"]),
        "PDes": np.degrees(record["q_reference"]),
        "POut": record["u"],
    }
    units = {"P": "deg/s", "PDes": "deg/s"}
    parameters = {f"ATC_RAT_PIT_{n}": v for n, v in GAINS.items()}
    parameters |= {"ATC_ANG_PIT_P": 4.5, "SCHED_LOOP_RATE": 400.0, "INS_GYRO_FILTER": 40.0}
    rate = gb.Record(record.time, columns, units)
    return Recording(
        {"RATE": rate}, "a.BIN", "", {"parameters": parameters, "vehicle": "ArduCopter"}
    )


def with_gains(recording, **others):
    parameters = recording.metadata["parameters"] | others
    return replace(recording, metadata={**recording.metadata, "parameters": parameters})


def test_gains_rate_and_filters_come_from_the_log(log):
    flown = from_log(log, "pitch", signals={"q": "theta_dot"})
    low_pass, angle, rate = flown.controllers
    assert low_pass.values["cutoff"] == 20
    assert angle.values["P"] == 4.5
    assert angle.values["acceleration"] == pytest.approx(np.radians(550))
    assert rate.values["P"] == pytest.approx(0.135)
    assert rate.values["FLTT"] == 20
    assert {c.rate for c in flown.controllers} == {400.0}
    assert "mixer" not in flown.signals
    record = gb.Record([60.0, 61.0], {"Ax": [11.0, 11.0]})  # the mixer of pitch
    injected = replace(log, records={**log.records, "SIDS": record})
    assert from_log(injected, "pitch").signals["mixer"] == "SIDD.Targ"
    assert "mixer" not in from_log(injected, "roll").signals
    assert "ATC_RATE_FF_ENAB" in str(flown)
    assert len(from_log(log, "roll").controllers) == 2  # the rate of the gyro is filtered already


def test_the_firmware_itself_is_reproduced(log):
    # The cut log has 1.5 s of every second pass, of which the first is lost to the filters.
    check = from_log(log, "yaw").check(log)
    assert check.residual < 0.02
    assert check.late == {"q_reference": 2}
    assert "logged at 200.1 Hz of 400 Hz" in str(check)


def test_a_flight_is_reproduced_to_rounding_and_other_gains_are_not(flight):
    check = from_log(flight).check(flight)
    assert check.residual < 1e-9
    assert check.late == {"q_reference": 0}
    assert check.reproduces
    other = with_gains(flight, ATC_RAT_PIT_P=0.19)
    check = from_log(other).check(other)
    assert 0.1 < check.residual < 0.5
    assert "does not reproduce" in str(check)
    wrong = with_gains(flight, ATC_RAT_PIT_P=0.4)
    with pytest.raises(ValueError, match=r"does not reproduce the logged u: \d+ %"):
        from_log(wrong).check(wrong)


def test_a_thinned_log_is_reproduced_nearly(flight):
    rate = flight["RATE"]
    thinned = replace(flight, records={"RATE": rate.rows(slice(None, None, 2))})
    check = from_log(thinned).check(thinned)
    assert check.residual < 0.3
    assert "200 Hz of 400 Hz" in str(check)


def test_gains_that_changed_are_refused_with_names_and_times(flight):
    changes = ((1.0, "ATC_RAT_PIT_P", 0.1, 0.15), (4.0, "ATC_RAT_PIT_D", 0.003, 0.004))
    changed = replace(flight, metadata={**flight.metadata, "parameter_changes": changes})
    with pytest.raises(ValueError, match=r"PIT_P from 0.1 to 0.15 at 1.0 s, ATC_RAT_PIT_D from"):
        from_log(changed)
    later = (*changes, (9.0, "INS_GYRO_FILTER", 25.0, 40.0))
    of_filter = replace(flight, metadata={**flight.metadata, "parameter_changes": later})
    earlier = from_log(of_filter, start=5, end=6, signals={"q": "theta_dot"})
    assert earlier.controllers[0].values["cutoff"] == 25
    between = from_log(changed, start=2, end=3).controllers[-1]
    assert between.values["P"] == 0.15
    assert between.values["D"] == 0.003  # the last value came later


def test_logs_without_gains_or_signals_are_refused(flight):
    with pytest.raises(ValueError, match="has no parameters"):
        from_log(replace(flight, metadata={}))
    with pytest.raises(ValueError, match="no parameter ATC_ANG_RLL_P"):
        from_log(flight, "roll")
    with pytest.raises(ValueError, match="not one of roll"):
        from_log(flight, "heave")
    rate = flight["RATE"]
    without = gb.Record(rate.time, {"POut": rate["POut"]})
    with pytest.raises(ValueError, match="does not show its control law"):
        from_log(flight).check(replace(flight, records={"RATE": without}))


def test_what_is_not_modeled_is_noted(flight):
    notes = from_log(with_gains(flight, ATC_RAT_PIT_SMAX=20.0)).notes
    assert any("ATC_RAT_PIT_SMAX = 20 is not modeled" in note for note in notes)
    notch = {"ATC_RAT_PIT_NEF": 1.0, "FILT1_TYPE": 1.0}
    notch |= {"FILT1_NOTCH_FREQ": 60.0, "FILT1_NOTCH_Q": 3.0, "FILT1_NOTCH_ATT": 30.0}
    assert from_log(with_gains(flight, **notch)).controllers[-1].values["notch"] == 60


def test_a_plane_has_the_speed_scaler_of_its_log(flight):
    gains = {f"PTCH_RATE_{n}": v for n, v in GAINS.items()} | {"PTCH2SRV_TCONST": 0.4}
    plane = replace(
        with_gains(flight, **gains, SCHED_LOOP_RATE=50.0),
        records={"AETR": gb.Record([0.0, 1, 2], {"SS": [0.8, 0.9, 1.0]})},
    )
    plane = replace(plane, metadata={**plane.metadata, "vehicle": "ArduPlane"})
    angle, rate = from_log(plane).controllers
    assert (angle.values["tau"], rate.values["scaler"], rate.rate) == (0.4, 0.9, 50)
    with pytest.raises(ValueError, match=r"AETR\.SS"):
        from_log(replace(plane, records={}))

    # The copter of a plane has flown if its rates are in the log.
    hover = {n.replace("ATC_", "Q_A_"): v for n, v in flight.metadata["parameters"].items()}
    about = {"vehicle": "ArduPlane", "parameters": plane.metadata["parameters"] | hover}
    hovered = from_log(replace(flight, metadata=about))
    assert hovered.check(flight).residual < 1e-9
    assert hovered.gain_names["Q_A_RAT_PIT_P"] == "RateController.P"


def px4_log(parameters=None):
    """A flight with PX4's controllers, by its topics, and what reads them."""
    gains = {"K": 1.2, "P": 0.15, "I": 0.3, "D": 0.003, "FF": 0.0, "i_max": 0.3, "cutoff": 30.0}
    laws = [
        px4.AngleController(rate=250),
        px4.RateController(gains, rate=250, signals={"q": "theta_dot"}),
    ]
    t = np.arange(1000) / 250
    excitation = {"reference": 0.1 * np.sin(2 * np.pi * (0.5 * t + 0.4 * t**2))}
    flown = gb.virtual_flight(Plant(), None, excitation, controller=laws)
    written = {f"MC_PITCHRATE_{n}": gains[n] for n in ("K", "P", "I", "D", "FF")}
    written |= {"MC_PR_INT_LIM": 0.3, "MC_PITCH_P": 6.5, "MC_PITCHRATE_MAX": 220.0}
    written |= {"IMU_GYRO_RATEMAX": 250.0, "IMU_DGYRO_CUTOFF": 30.0, "IMU_GYRO_CUTOFF": 40.0}
    topics = {
        "vehicle_torque_setpoint": gb.Record(flown.time, {"xyz[1]": flown["u"]}),
        "vehicle_angular_velocity": gb.Record(flown.time, {"xyz[1]": flown["theta_dot"]}),
        "vehicle_rates_setpoint": gb.Record(flown.time, {"pitch": flown["q_reference"]}),
    }
    return Recording(
        topics, metadata={"vehicle": "PX4", "parameters": written | (parameters or {})}
    )


def test_a_log_of_px4():
    flown = from_log(px4_log(), "pitch", signals={"q": "theta_dot"})
    assert [type(c).__name__ for c in flown.controllers] == [
        "SampledLowPass",
        "AngleController",
        "RateController",
    ]
    assert flown.controllers[-1].rate == 250
    assert flown.check(px4_log()).residual < 1e-9
    assert "MC_BAT_SCALE_EN" in str(from_log(px4_log({"MC_BAT_SCALE_EN": 1.0})))


HEADER = """"looptime","125"
"pid_process_denom","4"
"rollPID","45,80,40"
"d_min","30,34,0"
"dterm_lpf1_static_hz","75"
"dterm_lpf1_type","2"
"dterm_lpf2_static_hz","150"
"gyro_lpf1_static_hz","250"
"tpa_rate","65"
"""


def test_a_table_of_betaflight(tmp_path):
    class Roll(gb.TransferFunction):
        input, output = "u", "p"
        K = gb.Parameter(600.0)

        def response(self, s, p):
            return p.K / (s * (0.03 * s + 1))

    values = {"D": 30.0, "lpf1": 75.0, "lpf1_type": 2, "lpf2": 150.0}
    law = betaflight.RateController(values, rate=2000, signals={"q": "p"})
    t = np.arange(6000) / 2000
    excitation = {"q_reference": np.sin(2 * np.pi * (t + 2 * t**2))}
    flight = gb.virtual_flight(Roll(), None, excitation, controller=law)
    columns = {
        "loopIteration": np.arange(t.size),
        "time": 1e6 + 500 * np.arange(t.size),
        "axisP[0]": 1000 * flight["u"],  # in truth the sum of three
        "setpoint[0]": np.degrees(flight["q_reference"]),
        "gyroADC[0]": np.degrees(flight["p"]),
    }
    names = ",".join(f'"{name}"' for name in columns)
    rows = "\n".join(
        ",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)
    )
    path = tmp_path / "flight.csv"
    path.write_text(f"{HEADER}{names}\n{rows}\n")
    log = gb.read(path)
    flown = from_log(log, "roll", signals={"q": "p"}, raw_rate=True)
    lag, read = flown.controllers
    assert (lag.values["cutoff"], lag.rate) == (250.0, 2000)
    assert read.values["D"] == 30  # d_min, in quiet flight
    assert dict(read.values) == dict(law.values)
    assert flown.check(log).residual < 1e-6
    assert any("tpa_rate" in note for note in flown.notes)
    with pytest.raises(ValueError, match="no parameter pitchPID"):
        from_log(log, "pitch")

    # The plant of a control in pidSum, and of a gyro in front of its filters.
    truth = gb.margins(Roll(), flown.controllers)
    fit = fit_of(Roll(), 0.6, "u = axisSum[0], p = gyroUnfilt[0]", "p")
    answer = loop_of_log(log, fit).model
    for name in ("phase margin", "gain margin", "crossover"):
        assert answer[name].value == pytest.approx(truth[name].value, rel=1e-3)


def fit_of(model, gain, signals, output="theta"):
    """Return the fit of a nearly exact response that names its signals."""
    exact = gb.frequency_response(model, {"K": gain}, np.geomspace(2, 40, 12))
    error = 1 + 1e-4 * np.resize([1, -1], 12)
    about = {"signals": signals}
    data = gb.FrequencyResponse(exact.omega, error * exact.response, "u", output, about=about)
    return gb.fit(gb.Problem(model, data), starts=[{"K": 2 * gain}], progress=False)


class Rate(gb.TransferFunction):
    input, output = "u", "q"
    K = gb.Parameter(90.0)

    def response(self, s, p):
        return p.K / ((s + 0.7) * (0.05 * s + 1))


def test_a_fit_of_a_rate_has_the_margins_of_the_rate_loop_alone(flight):
    fit = fit_of(Rate(), 90.0, "u = RATE.POut, q = RATE.P", "q")
    flown, _ = flown_controllers(flight, fit)
    assert [type(c).__name__ for c in flown.controllers] == ["RateController"]
    assert "rate loop alone" in str(flown)
    # The injected signal has measured the loop with the angle controller.
    time = flight["RATE"].time
    injection = {
        "SIDS": gb.Record([0.0, 0.1], {"Ax": [11.0, 11.0]}),
        "SIDD": gb.Record(time, {"Targ": 0 * time}),
    }
    injected = replace(flight, records={**flight.records, **injection})
    assert "mixer" in from_log(injected).signals
    answer = loop_of_log(injected, fit)
    assert not any("injected" in text for text in answer.notes)


def test_settings_of_blackbox_explorer_have_older_names():
    settings = {f"rollPID[{k}]": v for k, v in enumerate((45.0, 80.0, 40.0, 30.0, 120.0))}
    settings |= {"looptime": 125.0, "dterm_lpf_hz": 75.0, "dterm_filter_type": 2.0}
    settings |= {"dterm_lpf2_hz": 150.0, "dterm_notch_hz": 260.0, "dterm_notch_cutoff": 160.0}
    settings |= {"gyro_lowpass_hz": 250.0, "dyn_notch_count": 3.0}
    log = Recording({}, metadata={"parameters": settings})
    flown = from_log(log, "roll", raw_rate=True)
    lag, law = flown.controllers
    assert lag.values["cutoff"] == 250
    assert (law.values["lpf1"], law.values["lpf1_type"], law.values["lpf2"]) == (75, 2, 150)
    assert law.values["notch_Q"] == pytest.approx(260 * 160 / (260**2 - 160**2))
    assert law.values["D"] == 30  # d_min is behind the gains
    assert any("dyn_notch_count" in note for note in flown.notes)


def test_what_the_log_lacks_is_named(flight):
    lacking = replace(
        flight,
        metadata={"parameters": {**flight.metadata["parameters"], "FSTRATE_ENABLE": 1.0}},
    )
    for name in ("ATC_RAT_PIT_FLTD", "INS_GYRO_FILTER"):
        del lacking.metadata["parameters"][name]
    notes = " ".join(from_log(lacking, signals={"q": "theta_dot"}).notes)
    for words in ("ATC_RAT_PIT_FLTD is not in the log", "no filter of the gyro", "FSTRATE_ENABLE"):
        assert words in notes
    about = {"vehicle": "PX4", "parameters": {"FW_PR_P": 0.1}}
    with pytest.raises(ValueError, match="no parameter MC_PITCHRATE_"):
        from_log(Recording({}, metadata=about))


def test_a_controller_without_gains_leaves_the_loop_open(flight):
    zero = {f"ATC_RAT_PIT_{name}": 0.0 for name in "PID"} | {"ATC_RAT_PIT_FF": 0.0}
    flown = from_log(with_gains(flight, **zero), signals={"q": "theta_dot"})
    data = fit_of(Plant(), 90.0, "u = RATE.POut, theta = ATT.Pitch").parts[0].data
    with pytest.raises(ValueError, match="the loop is open"):
        flown.loop_gain(data)


def test_a_fit_of_another_control_is_refused(flight):
    with pytest.raises(ValueError, match=r"RCOU\.C1, which is no control of pitch.*RATE\.POut"):
        flown_controllers(flight, fit_of(Plant(), 90.0, "u = RCOU.C1, theta = ATT.Pitch"))


def test_a_loop_holds_its_control_also_where_the_fit_divided_the_hold_out(flight):
    flown = from_log(flight, signals={"q": "theta_dot"})
    omega = np.array([1.0, 20.0, 300.0])
    exact = gb.frequency_response(Plant(), None, omega).response
    # Means over the 2.5 ms for which a value of the control lasts, by the sum of many delays.
    times = (np.arange(1000) + 0.5) / 1000 / 400
    held = exact * np.exp(-1j * np.outer(omega, times)).mean(axis=1)
    about = {"hold of the input, s": "0.0025"}
    measured = gb.FrequencyResponse(omega, held, "u", "theta", about=about)
    loop = flown.loop_gain(measured.without_hold())
    assert_allclose(loop.response, flown.loop_gain(measured).response, rtol=1e-6)
