"""Axes that a user gives: what is drawn stays inside them."""

import numpy as np
import pytest
from drawn_lines import TRUTH, curves, points
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import greybox as gb
from greybox.data.record import Record, Recording
from greybox.models.tilt import Tilt
from greybox.plotting.style import legend_below

RECORD = Record(
    np.arange(0, 5, 0.01),
    {"u": np.arange(500.0), "theta": np.zeros(500)},
    {"theta": "rad"},
    name="made",
)


@pytest.fixture
def page():
    """A user's figure with a panel of their own, which stays as it is."""
    figure = Figure(figsize=(9, 7))
    axes = figure.subplots(2, 2)
    axes[1, 1].plot([1, 2], [3, 4])
    axes[1, 1].set_title("mine")
    yield axes
    assert figure.get_suptitle() == ""
    assert not figure.legends
    assert tuple(figure.get_size_inches()) == (9, 7)
    assert figure.axes == axes.ravel().tolist()
    assert axes[1, 1].get_title() == "mine"
    assert len(axes[1, 1].lines) == 1


def test_a_bode_diagram_goes_into_two_panels_of_a_users_figure(page, pitch):
    drawn = gb.plotting.bode(pitch, axes=page[:, 0])
    assert drawn.tolist() == [page[0, 0], page[1, 0]]
    assert [text.get_text() for text in page[0, 0].get_legend().get_texts()] == [
        "pitch",
        "fit of Tilt",
        "95 % band",
    ]
    assert page[1, 0].get_legend() is None
    assert [ax.get_xscale() for ax in drawn] == ["log", "log"]
    assert [ax.get_xlabel() for ax in drawn] == ["ω, rad/s", "ω, rad/s"]
    assert drawn[0].get_xlim() == drawn[1].get_xlim()


def test_a_coherence_needs_a_third_panel(page, sweep, pitch):
    assert len(gb.plotting.bode(sweep, axes=page[0])) == 2
    drawn = gb.plotting.bode(sweep, axes=[*page[0], page[1, 0]])
    np.testing.assert_array_equal(points(drawn[2])[0].get_ydata(), sweep.coherence)
    with pytest.raises(
        ValueError,
        match=r"draws 2 panels \(magnitude, phase\), but `axes` has 3: give one for each",
    ):
        gb.plotting.bode(pitch, axes=[*page[0], page[1, 0]])


def test_a_bode_diagram_drawn_over_another_shows_the_frequencies_of_both(page):
    drawn = gb.plotting.bode(
        gb.frequency_response(Tilt(), TRUTH, [1.0, 2.0]), axes=page[0], legend=False
    )
    gb.plotting.bode(gb.frequency_response(Tilt(), TRUTH, [5.0, 90.0]), axes=drawn)
    low, high = drawn[0].get_xlim()
    assert low < 1
    assert high > 90


def test_a_nyquist_diagram_takes_one_panel_for_all_or_one_for_each_pair(page, rotors, pitch):
    assert gb.plotting.nyquist(rotors, pitch, axes=page[0, 0]).tolist() == [page[0, 0]]
    assert len(points(page[0, 0])) == 5
    _, second = gb.plotting.nyquist(rotors, pitch, axes=page[:, 0], legend=False)
    assert second is page[1, 0]
    assert len(points(second)) == len(curves(second)) == 1
    with pytest.raises(
        ValueError, match="`axes` has 3 axes for 2 input-output pairs: give one, or one for each"
    ):
        gb.plotting.nyquist(rotors, pitch, axes=page.ravel()[:3])


def test_starts_go_into_one_panel(page, pitch):
    assert gb.plotting.starts(pitch, ax=page[0, 1]) is page[0, 1]
    assert page[0, 1].get_legend() is not None
    assert gb.plotting.starts(pitch, ax=page[0, 0], legend=False).get_legend() is None


def test_a_log_goes_into_given_panels(page):
    assert gb.plotting.traces(RECORD, axes=page[0]).tolist() == page[0].tolist()
    assert [ax.get_xlabel() for ax in page[0]] == ["Time, s", "Time, s"]
    log = Recording({"table": RECORD}, "made.csv")
    assert gb.plotting.recording(log, axes=page[0], legend=False).tolist() == page[0].tolist()
    with pytest.raises(
        ValueError, match=r"this log draws 2 panels \(table.u, table.theta\), but `axes` has 1"
    ):
        gb.plotting.recording(log, axes=page[0, 0])


def test_what_is_no_axes_is_refused(pitch):
    with pytest.raises(TypeError, match=r"cannot draw into 'left': give matplotlib Axes"):
        gb.plotting.bode(pitch, axes=["left", "right"])
    with pytest.raises(TypeError, match="cannot draw into <Figure"):
        gb.plotting.starts(pitch, ax=Figure())


def test_only_the_lowest_of_stacked_panels_is_labeled(pitch):
    assert [ax.get_xlabel() for ax in gb.plotting.bode(pitch)] == ["", "", "", "ω, rad/s"]
    stacked = Figure().subplots(2, 1, sharex=True)
    assert [ax.get_xlabel() for ax in gb.plotting.bode(pitch, axes=stacked)] == ["", "ω, rad/s"]


@pytest.mark.parametrize(("width", "columns"), [(4.0, 2), (6.0, 4), (20.0, 5)])
def test_a_legend_below_has_as_many_columns_as_fit(width, columns):
    """A letter takes an eleventh of an inch, a key six letters: of ten letters 16 / 11 in each."""
    figure = Figure(figsize=(width, 3))
    legend_below(figure, {f"{k} {'x' * 8}": (Line2D([], []),) for k in range(5)})
    (legend,) = figure.legends
    assert legend._ncols == columns
