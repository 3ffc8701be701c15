"""Figures of a measurement: what is drawn is what was flown."""

import matplotlib as mpl
import numpy as np
import pytest

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.data.test_segment import Segment
from greybox.identification import Settings, measure

mpl.use("Agg")
TIME = np.arange(0, 40, 0.01)
RATIO = 20.0  # of the frequencies at the ends of the sweep


def sweep():
    """From 2 to 40 rad/s, logarithmic, as u; through 1 / (0.1 s + 1) as q, in rad/s; clipped at its first peaks."""
    from scipy.signal import lsim

    rate = np.log(RATIO) / TIME[-1]
    u = np.sin(2 * (np.exp(rate * TIME) - 1) / rate)
    clipped = np.minimum(u, np.where(TIME < 8, 0.8, 2.0))
    return clipped, lsim(([1], [0.1, 1]), clipped, TIME)[1]


@pytest.fixture(scope="module")
def measured():
    u, q = sweep()
    q = q + 1e-4 * np.random.default_rng(0).normal(size=q.size)
    records = {
        "RATE": Record(TIME, {"POut": u, "P": q}, {"P": "rad/s"}),
        "RCOU": Record(TIME[::10], {"C1": np.where(TIME[::10] < 4, 1950, 1500)}),
    }
    parameters = {
        "INS_GYRO_FILTER": 20.0,
        "SERVO1_FUNCTION": 33,
        "MOT_SPIN_MIN": 0.15,
        "MOT_SPIN_MAX": 0.95,
    }
    log = Recording(records, "made.bin", metadata={"parameters": parameters})
    return log, measure(log, Settings("u=RATE.POut", "q=RATE.P", whole=True, open_loop=True))


def test_signals_have_axes_of_their_own_and_limits_are_marked(measured):
    log, found = measured
    figure = gb.plotting.measurement(found, log)
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels[:3] == ["u", "q, °/s", "motors, µs"]
    marked = [
        line.get_xdata()
        for ax in (figure.axes[0], figure.axes[2])
        for line in ax.lines
        if line.get_label() == "at a limit"
    ]
    assert marked[1].max() < 4 < marked[1].size
    assert "without the 20 Hz low-pass filter" in {
        text.get_text() for text in figure.findobj(mpl.text.Text)
    }


def test_the_ridge_of_a_spectrogram_is_the_law_of_the_sweep():
    record = Record(TIME, {"u": sweep()[0]})
    ax = gb.plotting.spectrogram(record, "u", Segment(0.0, TIME[-1], "sweep", band=(2.0, 40.0)))
    (mesh,) = ax.collections
    corners = mesh.get_coordinates()
    power = np.asarray(mesh.get_array()).reshape(corners.shape[0] - 1, -1)
    times, omega = corners[0, :, 0], corners[:, 0, 1]
    middle = np.asarray(times[1:] + times[:-1]) / 2
    ridge = np.asarray(omega[1:] + omega[:-1])[np.argmax(power, axis=0)] / 2
    law = 2 * RATIO ** (middle / TIME[-1])
    late = (middle > 15) & (middle < 38)
    assert np.median(np.abs(ridge[late] / law[late] - 1)) < 0.1
    with pytest.raises(ValueError, match="too few for a spectrogram"):
        gb.plotting.spectrogram(record, "u", Segment(0.0, 0.2, "sweep", band=(2.0, 40.0)))


def test_the_demodulated_sine_lies_over_the_raw_one():
    rng = np.random.default_rng(0)
    theta = 0.05 * np.sin(3 * TIME) + 0.3 - 0.02 * TIME + 0.01 * rng.normal(size=TIME.size)
    record = Record(TIME, {"u": np.cos(3 * TIME), "theta": theta}, {"theta": "rad"})
    control, angle = gb.plotting.demodulated(record, Segment(0.0, 40.0, omega=3.0), ("u", "theta"))
    raw, sine = angle.lines
    at = sine.get_xdata()
    assert sine.get_ydata() == pytest.approx(
        np.degrees(0.05 * np.sin(3 * at) + 0.3 - 0.02 * at), abs=0.08
    )
    assert np.ptp(raw.get_xdata()) == pytest.approx(4 * 2 * np.pi / 3, rel=0.01)
    assert (control.get_ylabel(), angle.get_ylabel()) == ("u", "θ, °")
    with pytest.raises(ValueError, match="the test is a sweep"):
        gb.plotting.demodulated(record, Segment(0.0, 40.0, "sweep", band=(1, 2)), ("u",))


def test_sines_are_drawn_with_the_one_of_the_largest_error():
    from greybox.problems import sitl_pitch

    log = gb.read(sitl_pitch.LOG)
    found = measure(log, Settings("u=RATE.POut", "theta=ATT.Pitch", announced="SINE"))
    figure = gb.plotting.measurement(found, log)
    titles = [ax.get_title() for ax in figure.axes]
    assert any(title.startswith("Sine with the largest error") for title in titles)
    assert len(figure.axes[0].patches) == 10
