"""Figures of flight logs: tests, gaps, long lines."""

import matplotlib as mpl
import numpy as np
import pytest

import greybox as gb
from greybox.data.excited_segment import Segment
from greybox.data.record import Record, Recording

mpl.use("Agg")
TIME = np.arange(0, 100, 0.0025)
RECORD = Record(
    TIME, {"u": np.sin(20 * TIME), "theta": 0.1 * np.cos(20 * TIME), "r": 0.1 * np.sin(20 * TIME)},
    {"theta": "rad", "r": "rad"}, name="made",
)  # fmt: skip


def test_one_test_is_drawn_with_setpoint_and_output_together():
    control, angles = gb.plotting.traces(RECORD, Segment(10, 60, omega=20.0), periods=4)
    assert [line.get_label() for line in angles.lines] == ["theta", "r"]
    assert "°" in angles.get_ylabel()
    assert np.nanmax(angles.lines[0].get_ydata()) == pytest.approx(np.degrees(0.1), rel=1e-3)
    times = control.lines[0].get_xdata()
    assert np.nanmax(times) == pytest.approx(60, abs=0.01)
    assert np.ptp(times[np.isfinite(times)]) == pytest.approx(4 * 2 * np.pi / 20, rel=0.01)
    assert "20 rad/s" in control.get_title()


@pytest.mark.parametrize("wrong", ["SINE", (10, 60), [Segment(10, 60, omega=20.0)]], ids=repr)
def test_what_is_no_segment_is_named(wrong):
    log = Recording({"table": RECORD}, "made.csv")
    for draw in (
        lambda: gb.plotting.traces(RECORD, wrong),
        lambda: gb.plotting.recording(log, [wrong]),
    ):
        with pytest.raises(TypeError, match=r"a segment is .*: give those of"):
            draw()


def test_long_lines_are_thinned_without_losing_their_extremes():
    line = gb.plotting.traces(RECORD)[0].lines[0]
    assert len(line.get_xdata()) < 5000
    assert np.nanmax(line.get_ydata()) == pytest.approx(1, abs=1e-3)


def test_gaps_stay_open():
    holed = RECORD.time[(RECORD.time < 1) | (RECORD.time > 2)][:800]
    (axes,) = gb.plotting.traces(Record(holed, {"x": holed}))
    assert np.isnan(axes.lines[0].get_ydata()).sum() == 1


def test_a_change_of_rate_is_no_gap():
    """Steps of 0.5 s behind steps of 0.01 s: a line, not points that nobody sees."""
    time = np.r_[np.arange(1000) * 0.01, 10 + np.arange(100) * 0.5]
    (axes,) = gb.plotting.traces(Record(time, {"x": np.sin(time)}))
    assert np.isfinite(axes.lines[0].get_ydata()).all()


def test_a_recording_is_drawn_with_its_tests_shaded():
    degrees = Record(
        TIME, {"DesPitch": TIME, "Pitch": (10 * TIME) % 360}, {"DesPitch": "deg", "Pitch": "deg"}
    )
    segments = [Segment(10, 20, omega=3.0), Segment(30, 40, omega=2.0, usable=False)]
    (axes,) = gb.plotting.recording(Recording({"ATT": degrees}, "made.bin"), segments)
    assert len(axes.patches) == 2
    assert np.nanmax(axes.lines[1].get_ydata()) == pytest.approx(1000, rel=1e-2)


def test_any_signals_will_do_and_none_is_said():
    assert len(gb.plotting.recording(Recording({"table": RECORD}, "made.csv"))) == 3
    with pytest.raises(ValueError, match=r"made\.csv has no signal"):
        gb.plotting.recording(Recording({}, "made.csv"))
