"""Controllers with the gains that a log holds, and the check against the logged control."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Recording
from greybox.models.ardupilot import AngleController, RateController
from greybox.models.firmware import from_log

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
    assert "log has 200.1 of 400 Hz" in str(check)


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
    assert "200 of 400 Hz" in str(check)


def test_gains_that_changed_are_refused_with_names_and_times(flight):
    changes = ((1.0, "ATC_RAT_PIT_P", 0.1, 0.15), (4.0, "ATC_RAT_PIT_D", 0.003, 0.004))
    changed = replace(flight, metadata={**flight.metadata, "parameter_changes": changes})
    with pytest.raises(ValueError, match=r"PIT_P from 0.1 to 0.15 at 1.0 s, ATC_RAT_PIT_D from"):
        from_log(changed)
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
