"""Profiles of the likelihood: the mismatch as one quantity moves away from its estimate."""

import numpy as np

from greybox.estimate.profiles import ProfileOf, Profiles
from greybox.plotting.figure import GRAY, Figure, Panel, Series, band
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw_grid


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
    return draw_grid(figures, axes, columns=min(len(figures), 3), size=(3.0, 2.5))


def profile_figures(profiles: Profiles) -> list[Figure]:
    """Return one figure for every profiled quantity."""
    return [_figure(profile, profiles.limit[profile.name]) for profile in profiles.profiles]


def _label(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name


def _figure(profile: ProfileOf, limit: float) -> Figure:
    ends = profile.values[[0, -1]]
    interval = np.where(np.isfinite(profile.interval), profile.interval, ends)
    sides = np.array([ends[0], profile.estimate, profile.estimate, ends[1]])
    limits = limit + profile.bias * np.array([1, 1, -1, -1])
    top = 1.6 * limit
    series = [
        band("interval", interval, np.zeros(2), np.full(2, limit)),
        Series("limit", "line", sides, limits, GRAY, width=0.8),
    ]
    if 0 < profile.standard_error < np.inf:
        reach = np.array([-top, 0, top])
        cone = profile.estimate + profile.standard_error * reach
        series.append(Series("standard error", "line", cone, np.abs(reach), GRAY, 1, width=0.9))
    roots = np.abs(profile.roots)
    series += [
        Series("profile", "line", profile.values, roots, width=1.4),
        Series("", "points", profile.values, roots),
    ]
    panel = Panel("|r|", series, limits=(0.0, top))
    return Figure(
        f"Profile of {profile.name}",
        _label(profile.name, profile.unit),
        [panel],
        limits=(float(ends[0]), float(ends[1])),
    )
