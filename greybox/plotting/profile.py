"""Profiles of the likelihood: the mismatch as one quantity moves away from its estimate."""

import numpy as np
from matplotlib.axes import Axes

from greybox.estimate.profiles import Contour, ProfileOf, Profiles
from greybox.plotting.figure import GRAY, INK, Figure, Panel, Series, band
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.plotting.signals import with_unit


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
    interval = f"{100 * profiles.level:g} % interval"
    return [_figure(p, profiles.limit[p.name], interval) for p in profiles.profiles]


def contour(contour: Contour, axes: Axes | None = None) -> Axes:
    """Draw the confidence region of two parameters, and the ellipse of the standard errors.

    Open ends are hollow.

    Parameters
    ----------
    contour : Contour
    axes : Axes, optional
        By default a new figure is made.
    """
    x, y = np.vstack([contour.points, contour.points[:1]]).T
    is_closed = np.array([end == "crossed" for end in contour.ends])
    closed = contour.points[is_closed].T
    hollow = contour.points[~is_closed].T
    if is_closed.all():
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  (imports slowly)

        rays = np.arange(len(x))
        x, y = CubicSpline(rays, [x, y], 1, "periodic")(np.linspace(0, rays[-1], 360))
    series = [
        Series("", "regions", x, y),
        Series("region", "line", x, y),
        Series("", "points", *closed),
    ]
    if hollow.size:
        series.append(Series("open end", "points", *hollow, is_hollow=True))
    # Regions leave the limits to the other series: the ellipse may be many times as long.
    if np.all(np.isfinite(contour.covariance)):
        look = {"color": INK, "style": 1, "is_hollow": True}
        series.append(Series("standard errors", "regions", *contour.ellipse().T, **look))

    estimate = contour.estimate[:, None]
    series.append(Series("estimate", "points", *estimate, color=INK))
    across, upward = map(with_unit, contour.names, contour.units)
    figure = Figure("Region", across, [Panel(upward, series)], "Region")
    return draw([figure], axes, size=(5.0, 2.9))[0]


def _figure(profile: ProfileOf, limit: float, interval_name: str) -> Figure:
    ends = profile.values[[0, -1]]
    # An open interval is shaded as far as the profile goes.
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
