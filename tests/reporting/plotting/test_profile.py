"""Profiles show the numbers that they hold."""

import numpy as np
import pytest
from drawn_lines import named
from matplotlib.figure import Figure

import greybox as gb
from greybox.assessment.profile_result import ProfileOf
from greybox.reporting.plotting.profile import profile_figures

VALUES = np.array([0.7, 1.0, 1.4])


def profile(**given):
    known = {
        "interval": (0.8, np.inf),
        "estimate": 1.0,
        "bias": 0.1,
        "standard_error": 0.15,
        "unit": "s",
        "name": "T",
        "values": VALUES,
        "costs": VALUES,
        "roots": np.array([-2.5, 0.0, 2.6]),
        "others": VALUES[:, None],
        "ends": ("crossed", "flat"),
        "bounds": (0.0, np.inf),
    }
    return ProfileOf(**known | given)


def profiles_of(*profiles, limit):
    return gb.Profiles("lag", 0.95, limit, ("T",), profiles)


def test_a_profile_has_its_limit_its_interval_and_the_cone_of_the_standard_error():
    profiles = [profile(), profile(name="K", unit="", standard_error=np.nan)]
    first, second = profile_figures(profiles_of(*profiles, limit={"T": 2.0, "K": 3.0}))
    (panel,) = first.panels
    curve, points = named(panel, "profile", "line"), named(panel, "", "points")
    assert points.y == pytest.approx([2.5, 0.0, 2.6])
    # Smooth, through the points, and without bends of its own.
    assert curve.x.size > 190
    assert curve.y[np.isin(curve.x, points.x)] == pytest.approx(points.y)
    turns = np.diff(np.sign(np.diff(curve.y)))
    assert np.count_nonzero(turns) == 1
    cone = named(panel, "standard error", "line")
    assert cone.x == pytest.approx([1 - 0.15 * 3.2, 1, 1 + 0.15 * 3.2])
    assert cone.y == pytest.approx([3.2, 0, 3.2])
    assert named(panel, "limit", "line").y == pytest.approx([2.1, 2.1, 1.9, 1.9])
    # Open above: to the end of the curve.
    assert named(panel, "95 % interval", "band").x == pytest.approx([0.8, 1.4])
    assert (first.limits, panel.limits, first.label) == ((0.7, 1.4), (0.0, 3.2), "T, s")
    assert second.label == "K"
    assert "standard error" not in [series.name for series in second.panels[0].series]


def test_profiles_stand_in_a_grid_or_in_axes_of_a_user():
    four = profiles_of(*(profile() for _ in range(4)), limit={"T": 2.0})
    axes = gb.plotting.profiles(four)
    assert len(axes[0].figure.axes) == len(axes) == 4  # of a grid of six
    assert axes[0].get_xlim() == (0.7, 1.4)
    with pytest.raises(ValueError, match="has 4 panels"):
        gb.plotting.profiles(four, Figure().subplots(3))
