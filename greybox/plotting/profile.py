"""Profiles of the likelihood: how much worse the fit becomes as one quantity moves away from its estimate."""

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from greybox.estimate.profiles import Contour, ProfileOf, Profiles
from greybox.plotting.style import COLORS, DARK, GRAYS, new_figure

COLUMNS = 3


def profiles(found: Profiles, axes: Any = None) -> NDArray[Any]:
    """Draw |r|, the root of the likelihood ratio, over every profiled quantity, with the interval and Wald's cone.

    The limit of |r| has a step at the estimate where a relative criterion biases it.

    Parameters
    ----------
    found : Profiles
    axes : array-like of Axes, optional
        As many as there are profiles. Without them a new figure is made.

    Returns
    -------
    (n,) array of Axes
    """
    many = len(found.profiles)
    if axes is None:
        columns = min(many, COLUMNS)
        rows = math.ceil(many / columns)
        made = new_figure(3.0 * columns, 2.5 * rows).subplots(rows, columns, squeeze=False).ravel()
        for ax in made[many:]:
            ax.remove()
        axes = made[:many]
    drawn = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
    if len(drawn) != many:
        raise ValueError(f"axes has {len(drawn)} Axes and there are {many} profiles: give as many.")
    for ax, profile in zip(drawn, found.profiles, strict=True):
        _draw(ax, profile, found.limit[profile.name])
    return drawn


def contour(found: Contour, axes: Any = None) -> Axes:
    """Draw the region of two parameters, and the ellipse of the standard errors; open ends are hollow.

    Parameters
    ----------
    found : Contour
    axes : Axes, optional
        Without them a new figure is made.
    """
    ax = new_figure(4.0, 3.4).subplots() if axes is None else axes
    points = np.vstack([found.points, found.points[:1]])
    ax.fill(*points.T, color=COLORS[0], alpha=0.12, linewidth=0)
    ax.plot(*points.T, color=COLORS[0], linewidth=1.4)
    closed = np.array([end == "crossed" for end in found.ends])
    ax.plot(*found.points[closed].T, color=COLORS[0], marker="o", markersize=3, linestyle="")
    ax.plot(
        *found.points[~closed].T,
        color=COLORS[0],
        marker="o",
        markersize=4,
        linestyle="",
        markerfacecolor="white",
    )
    if np.all(np.isfinite(found.covariance)):
        ax.set(
            xlim=ax.get_xlim(), ylim=ax.get_ylim()
        )  # of the region: the ellipse may be many times as long
        ax.plot(*found.ellipse().T, color=GRAYS[0], linestyle="--", linewidth=0.9)
    ax.plot(*found.estimate, color=DARK, marker="+", markersize=7)
    for axis, name, unit in zip((ax.xaxis, ax.yaxis), found.names, found.units, strict=True):
        axis.set_major_locator(MaxNLocator(5))
        axis.set_label_text(f"{name} [{unit}]" if unit else name)
    return ax


def _draw(ax: Axes, profile: ProfileOf, limit: float) -> None:
    size = np.abs(profile.roots)
    low, high = (
        end if math.isfinite(end) else value
        for end, value in zip(
            profile.interval, (profile.values[0], profile.values[-1]), strict=True
        )
    )
    sides = [profile.values[0], profile.estimate, profile.values[-1]]
    ax.stairs(
        [limit + profile.bias, limit - profile.bias],
        sides,
        baseline=None,
        color=GRAYS[0],
        linewidth=0.8,
    )
    ax.axvspan(low, high, color=COLORS[0], alpha=0.12, linewidth=0)
    if math.isfinite(profile.standard_error) and profile.standard_error > 0:
        grid = np.array([profile.values[0], profile.estimate, profile.values[-1]])
        wald = np.abs(grid - profile.estimate) / profile.standard_error
        ax.plot(grid, wald, color=GRAYS[0], linestyle="--", linewidth=0.9)
    ax.plot(profile.values, size, color=COLORS[0], marker="o", markersize=3, linewidth=1.4)
    ax.axvline(profile.estimate, color=DARK, linewidth=0.8)
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.set_ylim(0, 1.6 * limit)
    ax.set_xlim(profile.values[0], profile.values[-1])
    ax.set_xlabel(f"{profile.name} [{profile.unit}]" if profile.unit else profile.name)
    ax.set_ylabel("|r|")
