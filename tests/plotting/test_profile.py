"""Profiles and contours show the numbers that they hold."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import greybox as gb
from greybox.estimate.profiles import Contour

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


def test_a_profile_has_its_limit_its_interval_and_walds_cone():
    found = SimpleNamespace(
        profiles=[profile(), profile(name="K", unit="", standard_error=np.nan)],
        limit={"T": 2.0, "K": 3.0},
    )
    lag, gain = gb.plotting.profiles(found)
    cone, curve, estimate = lag.get_lines()
    np.testing.assert_allclose(curve.get_xydata(), np.column_stack([VALUES, [2.5, 0.0, 2.6]]))
    np.testing.assert_allclose(
        cone.get_xydata(), np.column_stack([VALUES, [0.3 / 0.15, 0.0, 0.4 / 0.15]])
    )
    assert list(estimate.get_xdata()) == [1.0, 1.0]
    limit, inside = lag.patches
    np.testing.assert_allclose(limit.get_data().values, [2.1, 1.9])
    np.testing.assert_allclose(limit.get_data().edges, VALUES)
    box = inside.get_extents().transformed(lag.transData.inverted())
    assert (box.x0, box.x1) == (
        pytest.approx(0.8),
        pytest.approx(1.4),
    )  # open above: to the end of the curve
    assert lag.get_xlim() == (0.7, 1.4)
    assert (lag.get_ylim()[0], gain.get_ylim()[1] > 3.0) == (0, True)
    assert [ax.get_xlabel() for ax in (lag, gain)] == ["T [s]", "K"]
    assert len(gain.get_lines()) == 2  # no cone
    figure = Figure()
    with pytest.raises(ValueError, match="axes has 3 Axes and there are 2 profiles: give as many"):
        gb.plotting.profiles(found, figure.subplots(3))
    assert len(lag.figure.axes) == 2
    four = SimpleNamespace(profiles=[profile() for _ in range(4)], limit={"T": 2.0})
    assert len(gb.plotting.profiles(four)[0].figure.axes) == 4  # of a grid of six


def test_a_contour_is_closed_with_hollow_open_ends():
    points = np.array([[1.5, 2.0], [1.0, 3.0], [0.5, 2.0], [1.0, 1.0]])
    ends = ("crossed", "bound", "crossed", "flat")
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    found = Contour(
        ("a", "b"), ("s", ""), 0.95, np.array([1.0, 2.0]), covariance, 2.0, points, ends
    )
    ax = gb.plotting.contour(found)
    around, closed, hollow, ellipse, center = (line.get_xydata() for line in ax.get_lines())
    np.testing.assert_array_equal(around, [*points, points[0]])
    np.testing.assert_array_equal(closed, points[[0, 2]])
    np.testing.assert_array_equal(hollow, points[[1, 3]])
    np.testing.assert_array_equal(center, [[1.0, 2.0]])
    # The Mahalanobis distance of the ellipse is the limit everywhere.
    off = ellipse - [1.0, 2.0]
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off), 4.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a [s]", "b")
    unknown = Contour(
        ("a", "b"), ("s", ""), 0.95, np.array([1.0, 2.0]), np.nan * covariance, 2.0, points, ends
    )
    assert len(gb.plotting.contour(unknown, Figure().subplots()).get_lines()) == 4


@pytest.mark.parametrize(("error", "lines"), [(0.15, 3), (0.0, 2), (np.inf, 2), (np.nan, 2)])
def test_a_cone_needs_a_standard_error(error, lines):
    found = SimpleNamespace(profiles=[profile(standard_error=error)], limit={"T": 2.0})
    (ax,) = gb.plotting.profiles(found)
    assert len(ax.get_lines()) == lines
