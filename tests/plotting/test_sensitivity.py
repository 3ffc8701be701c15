"""What tells of each parameter is drawn with its numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

import greybox as gb
from greybox.estimate.sensitivity import Sensitivity
from greybox.plotting.sensitivity import _draw
from greybox.plotting.style import COLORS, GRAYS, new_figure

ALONE = np.array([[[0.1, 0.2, 0.3], [0.15, 0.05, 0.1]], [[0.3, 0.1, 0.05], [0.2, 0.25, 0.1]]])
ALONG = np.array([[[0.4, 0.05, 0.15], [0.1, 0.2, 0.1]], np.full((2, 3), np.nan)])


def found(at, unit):
    return Sensitivity(("K", "tau"), ("p", "q"), unit, np.array(at), ALONG, ALONE)


def test_shares_are_drawn_in_percent_an_output_a_color_and_all_together_in_gray():
    told, untold = new_figure(5, 4).subplots(2)
    _draw(told, found([0.5, 2.0, 9.0], "s"), 0)
    _draw(untold, found([0.5, 2.0, 9.0], "s"), 1)
    alone, first, second = told.get_lines()
    assert alone.get_ydata() == pytest.approx([25, 25, 40])
    assert first.get_ydata() == pytest.approx([40, 5, 15])
    assert second.get_ydata() == pytest.approx([10, 20, 10])
    assert [to_hex(line.get_color()).upper() for line in (alone, first, second)] == [
        GRAYS[2],
        *COLORS[:2],
    ]
    assert [*first.get_xdata()] == [0.5, 2.0, 9.0]
    assert [line.get_marker() for line in told.get_lines()] == [""] * 3
    assert (told.get_ylabel(), untold.get_ylabel()) == ("K, %", "τ, %")
    assert ([t.get_text() for t in told.texts], [t.get_text() for t in untold.texts]) == (
        [],
        ["not determined"],
    )
    assert told.get_ylim()[0] == untold.get_ylim()[0] == 0


@pytest.mark.parametrize(
    ("at", "unit", "scale"),
    [
        ([2.0, 5.0, 10.1], "rad/s", "log"),
        ([2.0, 5.0, 9.9], "rad/s", "linear"),
        ([2.0, 5.0, 2e4], "s", "linear"),
        ([2.0, 5.0, 2e4], "rad/s", "log"),
        ([2.0, 5.0, 1900.0], "rad/s", "log"),
        ([2.0, 5.0, 2100.0], "rad/s", "log"),
    ],
)
def test_frequencies_beyond_a_ratio_of_five_have_a_logarithmic_axis(at, unit, scale):
    ax = new_figure(5, 4).subplots()
    _draw(ax, found(at, unit), 0)
    assert ax.get_xscale() == scale
    assert {line.get_marker() for line in ax.get_lines()} == {"o" if unit == "rad/s" else ""}
    if scale == "log":  # three ticks a decade within three decades, else one
        ticks = ax.xaxis.get_major_locator().tick_values(1.0, 100.0)
        assert (20.0 in ticks.round(6)) == (at[-1] < 2000)
        assert ax.xaxis.get_major_formatter()(20.0) == "20"


def test_a_panel_for_each_parameter_with_one_axis_and_one_legend():
    fit = SimpleNamespace(parts=[SimpleNamespace(name="a"), SimpleNamespace(name="b$")])
    drawn = {}

    class Fitted(gb.Fit):
        """What is drawn of a fit."""

        parts = fit.parts

        def __init__(self):
            pass

        def sensitivity(self, part=0):
            drawn["part"] = part
            return found([0.5, 2.0, 9.0], "s")

    first, second = gb.plotting.sensitivity(Fitted(), 1)
    assert drawn["part"] == 1
    assert first.get_title() == r"b\$"
    assert (first.get_xlabel(), second.get_xlabel()) == ("", "Time, s")
    (legend,) = first.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "p, others estimated",
        "q, others estimated",
        "others known",
    ]
    keys = [to_hex(key.get_color()).upper() for key in legend.legend_handles]
    assert keys == [*COLORS[:2], GRAYS[2]]
    assert first.figure.get_size_inches()[1] > 2
    given = new_figure(5, 4).subplots(2)
    gb.plotting.sensitivity(Fitted(), axes=given)
    assert given[0].get_legend() is not None
    assert given[0].figure.legends == []
    with pytest.raises(TypeError, match="cannot draw 3: give a Fit"):
        gb.plotting.sensitivity(3)
