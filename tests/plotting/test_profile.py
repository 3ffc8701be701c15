"""Profiles and contours show the numbers that they hold."""

from types import SimpleNamespace

import numpy as np
import pytest
from drawn_lines import named
from matplotlib.figure import Figure

import greybox as gb
from greybox.estimate.profiles import Contour
from greybox.plotting.profile import profile_figures

VALUES = np.array([0.7, 1.0, 1.4])


def profile(**given):
    known = {
        "interval": (0.8, np.inf),
        "estimate": 1.0,
        "bias": 0.1,
        "standard_error": 0.15,
        "unit": "s",
        "name": "T",
    }
    return SimpleNamespace(values=VALUES, roots=np.array([-2.5, 0.0, 2.6]), **known | given)


def test_a_profile_has_its_limit_its_interval_and_the_cone_of_the_standard_error():
    profiles = [profile(), profile(name="K", unit="", standard_error=np.nan)]
    first, second = profile_figures(
        SimpleNamespace(profiles=profiles, limit={"T": 2.0, "K": 3.0}, level=0.95)
    )
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
    four = SimpleNamespace(profiles=[profile() for _ in range(4)], limit={"T": 2.0}, level=0.95)
    axes = gb.plotting.profiles(four)
    assert len(axes[0].figure.axes) == len(axes) == 4  # of a grid of six
    assert axes[0].get_xlim() == (0.7, 1.4)
    with pytest.raises(ValueError, match="has 4 panels"):
        gb.plotting.profiles(four, Figure().subplots(3))


def test_a_contour_is_closed_with_hollow_open_ends():
    points = np.array([[1.5, 2.0], [1.0, 3.0], [0.5, 2.0], [1.0, 1.0]])
    ends = ("crossed", "bound", "crossed", "flat")
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    found = Contour(
        ("a", "b"), ("s", ""), 0.95, np.array([1.0, 2.0]), covariance, 2.0, points, ends
    )
    ax = gb.plotting.contour(found)
    lines = {line.get_label(): line.get_xydata() for line in ax.get_lines()}
    np.testing.assert_array_equal(lines["region"], [*points, points[0]])
    np.testing.assert_array_equal(lines["_"], points[[0, 2]])
    np.testing.assert_array_equal(lines["open end"], points[[1, 3]])
    np.testing.assert_array_equal(lines["estimate"], [[1.0, 2.0]])
    _, ellipse = (areas.get_paths()[0].vertices for areas in ax.collections)
    # The Mahalanobis distance of the ellipse is the limit everywhere.
    off = ellipse - [1.0, 2.0]
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off), 4.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a, s", "b")
    unknown = Contour(
        ("a", "b"), ("s", ""), 0.95, np.array([1.0, 2.0]), np.nan * covariance, 2.0, points, ends
    )
    assert len(gb.plotting.contour(unknown, Figure().subplots()).collections) == 1


def test_a_closed_contour_is_smooth_and_passes_through_its_points():
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    points = np.column_stack([1 + 0.3 * np.cos(angle), 2 + 0.5 * np.sin(angle)])
    found = Contour(
        *(("a", "b"), ("s", ""), 0.95, np.array([1.0, 2.0])),
        *(np.eye(2), 2.0, points, ("crossed",) * 36),
    )
    lines = {line.get_label(): line.get_xydata() for line in gb.plotting.contour(found).get_lines()}
    x, y = (lines["region"] - [1.0, 2.0]).T
    assert x.size == 360
    np.testing.assert_allclose((x / 0.3) ** 2 + (y / 0.5) ** 2, 1.0, atol=1e-4)
