"""Tables as blackbox_decode and Blackbox Explorer write them."""

import numpy as np
import pytest

from greybox.data.logs.readers import read

DECODED = "loopIteration, time (us), axisP[0], gyroADC[0], setpoint[0], setpoint[3], motor[0], flightModeFlags (flags)"
EXPLORED = '"loopIteration","time","axisP[0]","gyroADC[0]","setpoint[0]","setpoint[3]","motor[0]","flightModeFlags"'
SETTINGS = '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"looptime","125"\n"rollPID","45,80,40"\n'


@pytest.mark.parametrize("head", [DECODED, SETTINGS + EXPLORED])
def test_signals_have_times_and_units(tmp_path, head):
    time = 1_000_000 + 500 * np.arange(400)
    rate = np.sin(0.05 * np.arange(400))
    rows = [
        f"{k},{t},1,{w:.6f},0,1500,1100,ANGLE_MODE"
        for k, (t, w) in enumerate(zip(time, rate, strict=True))
    ]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
    record = read(tmp_path / "log.csv")["log"]
    assert record.rate == pytest.approx(2000)
    np.testing.assert_allclose(record["gyroADC[0]"], rate, atol=1e-6)
    assert record.units["gyroADC[0]"] == record.units["setpoint[0]"] == "deg/s"
    assert not record.units.get("setpoint[3]")


def logged(tmp_path, passes=1, settings=SETTINGS):
    """A loop of 8 kHz, of which one pass in so many is logged."""
    columns = EXPLORED.replace('"axisP[0]"', '"axisP[0]","axisI[0]","axisF[0]","axisP[2]"')
    rows = [
        f"{passes * k},{1000 + 125 * passes * k},4,2,0.5,3,50,-30,1500,1100,ARM" for k in range(400)
    ]
    (tmp_path / "log.csv").write_text("\n".join([settings + columns, *rows]) + "\n")
    return read(tmp_path / "log.csv")["log"]


@pytest.mark.parametrize(("passes", "lasts"), [(1, np.inf), (2, 125e-6), (16, 125e-6)])
def test_what_the_loop_computes_lasts_for_one_pass_of_it(tmp_path, passes, lasts):
    hold = logged(tmp_path, passes).hold
    for name in ("axisP[0]", "axisSum[0]", "setpoint[0]", "motor[0]"):
        assert hold[name] == pytest.approx(lasts)
    assert hold["gyroADC[0]"] == 0
    assert "setpoint[3]" not in hold


def test_the_control_is_the_sum_of_the_logged_terms(tmp_path):
    record = logged(tmp_path)
    assert np.all(record["axisSum[0]"] == 6.5)
    assert np.all(record["axisSum[2]"] == 3)
    assert "axisSum[1]" not in record.signals


def test_high_resolution_is_in_tenths_of_a_degree(tmp_path):
    plain = logged(tmp_path)
    tenths = logged(tmp_path, settings=SETTINGS + '"blackbox_high_resolution","1"\n')
    for name in ("gyroADC[0]", "setpoint[0]"):
        assert tenths[name] == pytest.approx(plain[name] / 10)
    for name in ("setpoint[3]", "axisP[0]"):
        assert tenths[name] == pytest.approx(plain[name])
    # Only the settings before the header tell.
    records = plain, tenths, logged(tmp_path, settings="")
    doubts = [any("blackbox_high_resolution" in text for text in r.findings) for r in records]
    assert doubts == [False, False, True]


def test_the_phase_of_a_chirp_in_a_debug_field_is_its_signal(tmp_path):
    """In 1/5000 rad, modulo a turn, and zero at rest, where a cosine would be one."""
    phase = 2 * np.pi * np.cumsum(np.linspace(0, 0.05, 300)) % (2 * np.pi)
    debug = np.r_[np.zeros(100), np.rint(5000 * phase)].astype(int)
    rows = [f"{k},{125 * k},{count},0" for k, count in enumerate(debug)]
    head = '"loopIteration","time","debug[0]","gyroADC[0]"'
    (tmp_path / "log.csv").write_text("\n".join([SETTINGS + head, *rows]) + "\n")
    chirp = read(tmp_path / "log.csv")["log"]["chirp"]
    moves = debug > 0
    np.testing.assert_allclose(chirp[moves], np.cos(np.r_[np.zeros(100), phase])[moves], atol=2e-4)
    assert not chirp[~moves].any()
