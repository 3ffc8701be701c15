"""The costs that the starts reached."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.plotting.style import (
    COLORS,
    DARK,
    GRAYS,
    MARKERS,
    TITLE_SIZE,
    finish,
    flat_axes,
    legend_below,
    legend_inside,
    new_figure,
)
from greybox.solve.outcome import SCREENED

LOG_SPAN = 30.0  # ratio of the largest to the smallest cost above which the scale is logarithmic


def starts(fit: Fit, ax: Axes | None = None, legend: bool = True) -> Axes:
    """Draw the final cost of every run, sorted and colored by the minimum reached.

    Failed runs are crosses at the right; their cost means nothing and is not shown. The scale is
    logarithmic where the costs span decades.

    Parameters
    ----------
    fit : Fit
        Its runs are shown, one for each start.
    ax : Axes, optional
        Where to draw. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and inside axes that are given.

    Returns
    -------
    Axes
        The last line of a notebook cell is ``gb.plotting.starts(fit).figure``.
    """
    if ax is not None:
        flat_axes(ax)
        entries = draw_starts(ax, fit)
        if legend:
            legend_inside(ax, entries)
        return ax

    figure = new_figure(6.4, 4.0)
    ax = figure.subplots()
    entries = draw_starts(ax, fit)
    if legend:
        legend_below(figure, entries)
    return ax


def draw_starts(ax: Axes, fit: Fit) -> dict[str, tuple[Line2D, ...]]:
    """Draw the runs into a panel and return the legend."""
    brought = [run for run in fit.runs if run.stage != SCREENED]
    costs = sorted((run.cost, run.index) for run in brought if run.converged)
    lines = [
        *_draw_minima(ax, fit, costs),
        *_draw_failed(ax, len(costs), len(brought) - len(costs)),
    ]
    _scale_costs(ax, [cost for cost, _ in costs])

    finish(ax, "Cost")
    ax.set_xlabel("Runs, sorted by cost", fontsize=11)
    ax.set_xlim(0, len(brought) + 1)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))

    count = counted(len(brought), "start")
    if len(brought) < len(fit.runs):
        count = f"{len(brought)} most promising of {counted(len(fit.runs), 'start')}"
    agreement = f"{fit.agreeing} of {count} {'agrees' if fit.agreeing == 1 else 'agree'} on the best minimum"
    ax.set_title(agreement if fit.converged else f"none of {count} converged", fontsize=TITLE_SIZE)
    return {str(line.get_label()): (line,) for line in lines}


def _draw_minima(ax: Axes, fit: Fit, costs: Sequence[tuple[float, int]]) -> list[Line2D]:
    """Draw the sorted `costs` and indices of runs, one color a minimum; all beyond the colors are gray."""
    places = {index: (k, cost) for k, (cost, index) in enumerate(costs, 1)}
    named = fit.minima[: len(COLORS)]
    others = fit.minima[len(COLORS) :]
    groups = [
        (f"minimum {k}: {len(m.runs)} × cost {m.cost:.5g}", m.runs) for k, m in enumerate(named, 1)
    ]
    rest = tuple(index for minimum in others for index in minimum.runs)
    if rest:
        label = f"{counted(len(rest), 'run')} in {counted(len(others), 'further minimum', 'further minima')}"
        groups.append((label, rest))

    lines = []
    for (label, members), color, marker in zip(groups, (*COLORS, GRAYS[1]), MARKERS, strict=False):
        x, y = zip(*(places[index] for index in members), strict=True)
        lines += ax.plot(
            x, y, color=color, marker=marker, markersize=4.5, linestyle="none", label=label
        )
    return lines


def _draw_failed(ax: Axes, before: int, count: int) -> list[Line2D]:
    """Draw `count` crosses to the right of the `before` converged runs, at a height that is no cost."""
    if not count:
        return []
    x = np.arange(before + 1, before + count + 1)
    y = np.full(count, 0.93)  # of the height of the panel
    ax.axvspan(before + 0.5, before + count + 0.5, color="0.95", zorder=0)
    look = {"color": DARK, "marker": "x", "markersize": 5, "transform": ax.get_xaxis_transform()}
    return ax.plot(x, y, linestyle="none", label=f"{count} × failed", **look)


def _scale_costs(ax: Axes, costs: Sequence[float]) -> None:
    """Scale the axis to the sorted costs, so that neither rounding nor a large range hides the minima."""
    if not costs:
        ax.set_yticks([])
    elif costs[0] > 0 and costs[-1] > LOG_SPAN * costs[0]:
        ax.set_yscale("log")
    else:
        room = 0.1 * max(costs[-1] - costs[0], abs(costs[0]), 1e-12)
        ax.set_ylim(costs[0] - room, costs[-1] + 2 * room)
