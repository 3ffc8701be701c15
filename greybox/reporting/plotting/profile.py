"""Profiles of the likelihood: the mismatch as one quantity moves away from its estimate."""

import numpy as np

from greybox.assessment.profile_result import ProfileOf, Profiles
from greybox.data.files.public import public
from greybox.reporting.plotting.figure import GRAY, Figure, Panel, Series, band, require_drawable
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.signals import with_unit


@public
def profiles(profiles: Profiles, axes: GivenAxes | None = None) -> AxesArray:
    """Draw |r|, the root of the likelihood ratio, over every profiled quantity.

    The interval is shaded. The dashed cone is what the standard error predicts. The limit of |r|
    has a step at the estimate where a relative criterion biases it.

    Parameters
    ----------
    profiles : Profiles
    axes : array-like of Axes, optional
        One for each profile. By default a new figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
    """
    figures = profile_figures(profiles)
    return draw(figures, axes, columns=min(len(figures), 3), size=(3.0, 2.5))


def profile_figures(profiles: Profiles) -> list[Figure]:
    """Return one figure for every profiled quantity."""
    require_drawable(profiles, Profiles, "the Profiles that gb.profile returns")
    interval = f"{100 * profiles.level:g} % interval"
    return [_figure(p, profiles.limit[p.name], interval) for p in profiles.profiles]


def _figure(profile: ProfileOf, limit: float, interval_name: str) -> Figure:
    ends = profile.values[[0, -1]]
    # An open interval is shaded to the end of the profile.
    interval = np.where(np.isfinite(profile.interval), profile.interval, ends)
    # With a bias the limit of |r| differs on the two sides of the estimate.
    sides = np.array([ends[0], profile.estimate, profile.estimate, ends[1]])
    limits = limit + profile.bias * np.array([1, 1, -1, -1])
    # A profile that never crosses the limit rises without end: cut it above the crossing.
    top = 1.6 * limit
    series = [
        band(interval_name, interval, np.zeros(2), np.full(2, limit)),
        Series("limit", "line", sides, limits, GRAY),
    ]
    if 0 < profile.standard_error < np.inf:
        reach = np.array([-top, 0, top])
        cone = profile.estimate + profile.standard_error * reach
        series.append(Series("standard error", "line", cone, np.abs(reach), GRAY, 1))

    from scipy.interpolate import PchipInterpolator  # noqa: PLC0415  (imports slowly)

    # The signed root rises along the profile: monotone cubics add no bends of their own.
    fine = np.union1d(np.linspace(ends[0], ends[1], 200), profile.values)
    curve = PchipInterpolator(profile.values, profile.roots)(fine)
    series += [
        Series("profile", "line", fine, np.abs(curve)),
        Series("", "points", profile.values, np.abs(profile.roots)),
    ]
    panel = Panel("|r|", series, limits=(0.0, top))
    return Figure(
        f"Profile of {profile.name}",
        with_unit(profile.name, profile.unit),
        [panel],
        bands=interval_name,
        limits=(float(ends[0]), float(ends[1])),
    )
