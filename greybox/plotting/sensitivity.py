"""Which frequencies, or which times of a flight, tell of each parameter."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from greybox.estimate.result import Fit
from greybox.estimate.sensitivity import Sensitivity
from greybox.plotting.style import (
    GRAYS,
    TITLE_SIZE,
    AxesArray,
    Entries,
    GivenAxes,
    align_and_explain,
    color_of,
    finish,
    label_horizontal,
    plain,
    stacked_axes,
    symbol,
)

LOG_RANGE = 5.0  # ratio of the highest to the lowest frequency from which the axis is logarithmic


def sensitivity(
    fit: Fit, part: int = 0, *, axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw what each frequency, or each time of a record, tells of each free parameter.

    In percent of what all data of the fit tell of it: in color with the other parameters estimated
    along, an output a color, in gray with the others known, all outputs together. Where gray is
    high and color is low, another parameter has the same effect. `Fit.sensitivity` has the numbers.

    Parameters
    ----------
    fit : Fit
    part : int
        Which part of the fit.
    axes : array-like of Axes, optional
        One for each free parameter. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and in the first panel of given
        axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (p,)
        The last line of a notebook cell is ``gb.plotting.sensitivity(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For a fit without an estimate or standard errors, or for a wrong number of axes.
    """
    if not isinstance(fit, Fit):
        raise TypeError(f"cannot draw {fit!r:.80}: give a Fit.")
    found = fit.sensitivity(part)
    drawn = stacked_axes(
        axes, found.names, "this figure of sensitivities", 7.0, 1.0 + 1.15 * len(found.names)
    )
    for k, ax in enumerate(drawn):
        _draw(ax, found, k)
    drawn[0].set_title(plain(fit.parts[part].name), fontsize=TITLE_SIZE)
    label_horizontal(drawn, {"rad/s": "ω, rad/s", "s": "Time, s", "row": "Row"}[found.unit])
    align_and_explain(drawn, _legend(found), given=axes is not None, legend=legend)
    return drawn


def _draw(ax: Axes, found: Sensitivity, k: int) -> None:
    marker = "o" if found.unit == "rad/s" else ""
    ax.plot(
        found.at,
        100 * found.alone[k].sum(axis=0),
        color=GRAYS[2],
        linewidth=1.2,
        marker=marker,
        markersize=3,
    )
    for j, shares in enumerate(100 * found.shares[k]):
        ax.plot(found.at, shares, color=color_of(j), linewidth=1.4, marker=marker, markersize=4)
    if np.isnan(found.shares[k]).all():
        ax.text(
            0.5,
            0.5,
            "not determined",
            transform=ax.transAxes,
            ha="center",
            va="center",
            color="0.4",
        )
    ax.set_ylim(bottom=0)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    finish(ax, f"{symbol(found.names[k])}, %")
    if found.unit == "rad/s" and found.at[-1] > LOG_RANGE * found.at[0]:
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(
            LogLocator(subs=(1, 2, 5) if found.at[-1] < 1e3 * found.at[0] else (1,))
        )
        ax.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())


def _legend(found: Sensitivity) -> Entries:
    entries = {
        f"{symbol(output)}, others estimated": (Line2D([], [], color=color_of(j)),)
        for j, output in enumerate(found.outputs)
    }
    return {**entries, "others known": (Line2D([], [], color=GRAYS[2]),)}
