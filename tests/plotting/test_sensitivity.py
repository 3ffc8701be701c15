"""The information on each parameter is drawn with its numbers."""

from types import SimpleNamespace

import numpy as np
import pytest
from drawn_lines import legend
from page_results import lag

import greybox as gb
from greybox.estimate.sensitivity import Sensitivity
from greybox.plotting.figure import GRAY
from greybox.plotting.sensitivity import information_figure

ALONE = np.array([[[0.1, 0.2, 0.3], [0.15, 0.05, 0.1]], [[0.3, 0.1, 0.05], [0.2, 0.25, 0.1]]])
SHARES = np.array([[[0.4, 0.05, 0.15], [0.1, 0.2, 0.1]], np.full((2, 3), np.nan)])


@pytest.fixture(scope="module")
def fit():
    return lag()


def made(at, unit):
    """What is drawn of a fit."""
    information = Sensitivity(("K", "tau"), ("p", "q"), unit, np.array(at), SHARES, ALONE)
    part = SimpleNamespace(name="flight", data=SimpleNamespace(name=""))
    return SimpleNamespace(parts=[part], sensitivity=lambda part: information)


def test_shares_are_in_percent_an_output_a_color_and_all_together_in_gray():
    figure = information_figure(made([0.5, 2.0, 9.0], "s"), 0)
    determined, unknown = figure.panels
    alone, first, second = determined.series
    assert alone.y == pytest.approx([25, 25, 40])
    assert first.y == pytest.approx([40, 5, 15])
    assert second.y == pytest.approx([10, 20, 10])
    assert [series.color for series in determined.series] == [GRAY, 0, 1]
    assert [series.x.tolist() for series in determined.series] == [[0.5, 2.0, 9.0]] * 3
    assert (determined.label, unknown.label) == ("K, %", "τ, %")
    assert (determined.title, unknown.title) == ("", "not determined")
    assert determined.limits == pytest.approx((0, 44))
    assert (figure.label, figure.is_wide) == ("Time, s", True)


@pytest.mark.parametrize(
    ("at", "unit", "is_logarithmic"),
    [
        ([2.0, 5.0, 10.1], "rad/s", True),
        ([2.0, 5.0, 9.9], "rad/s", False),
        ([2.0, 5.0, 2e4], "s", False),
    ],
)
def test_frequencies_beyond_a_ratio_of_five_have_a_logarithmic_axis(at, unit, is_logarithmic):
    assert information_figure(made(at, unit), 0).is_logarithmic == is_logarithmic


def test_a_panel_for_each_parameter(fit):
    axes = gb.plotting.sensitivity(fit)
    assert [ax.get_ylabel() for ax in axes] == [f"{name}, %" for name in fit.free]
    assert legend(axes[0]) == ["others known", "y, others estimated"]
    shares = 100 * fit.sensitivity(0).shares[1, 0]
    assert axes[1].get_lines()[1].get_ydata() == pytest.approx(shares)
    with pytest.raises(TypeError, match="cannot draw 3: give a Fit"):
        gb.plotting.sensitivity(3)
