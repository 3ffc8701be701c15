"""The costs that the starts reached."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from greybox.assessment.result import Fit
from greybox.data.files.arrays import Interval
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.engine.solve.runs import SCREENED, Run
from greybox.reporting.plotting.figure import (
    CROSS,
    GRAY,
    INK,
    Figure,
    Panel,
    Series,
    require_drawable,
)
from greybox.reporting.plotting.matplotlib_figure import draw

COLORED = 5  # minima with a color of their own; the others are gray


@public
def starts(fit: Fit, ax: Axes | None = None) -> Axes:
    """Draw the final cost of every run, sorted and colored by the minimum that it reached.

    Failed runs are crosses at the right; their height means nothing. The scale is logarithmic
    where the costs span decades.

    Parameters
    ----------
    fit : Fit
    ax : Axes, optional
        By default a new figure is made.

    Returns
    -------
    Axes
        In a notebook, ``gb.plotting.starts(fit).figure`` shows the figure.
    """
    return draw([starts_figure(fit)], ax)[0]


def starts_figure(fit: Fit) -> Figure:
    """Return the final costs of all runs, sorted, by the minimum that they reached."""
    require_drawable(fit, Fit, "a Fit")
    # Screened starts were only evaluated: their cost is not the result of a run.
    completed = [run for run in fit.runs if run.stage != SCREENED]
    converged = sorted((r for r in completed if r.converged), key=lambda r: (r.cost, r.index))
    failed = [run for run in completed if not run.converged]
    costs = [run.cost for run in converged]
    # A linear scale shows how close costs are; over decades it would hide all but the highest.
    is_logarithmic = bool(costs) and costs[0] > 0 and costs[-1] > 30 * costs[0]
    limits = _limits(costs, is_logarithmic)

    series = [*_minima(fit, converged)]
    if failed:
        low, high = limits
        # Failed runs have no cost that could be compared: they are drawn near the top.
        top = high / 1.2 if is_logarithmic else high - 0.07 * (high - low)
        places = np.arange(len(converged) + 1.0, len(completed) + 1.0)
        notes = [f"start {run.index}, {run.status}" for run in failed]
        name = f"{len(failed)} × failed"
        heights = np.full(len(failed), top)
        series.append(Series(name, "points", places, heights, INK, CROSS, notes=notes))

    count = counted(len(completed), "start")
    if len(completed) < len(fit.runs):
        count = f"{len(completed)} most promising of {counted(len(fit.runs), 'start')}"
    agree = "agrees" if fit.agreeing == 1 else "agree"
    result = f"{fit.agreeing} of {count} {agree} on the best minimum"
    if not fit.converged:
        result = f"None of {count} converged"
    note = " Failed runs are at the right; their height means nothing." if failed else ""
    panel = Panel("Cost", series, height=1.3, is_logarithmic=is_logarithmic, limits=limits)
    return Figure(
        "Starts",
        "Runs, sorted by cost",
        [panel],
        subject=result,
        caption=f"{result}.{note}",
        spans=[(len(converged) + 0.5, len(completed) + 0.5, GRAY)] if failed else (),
        is_whole=True,
        limits=(0.0, len(completed) + 1.0),
    )


def _minima(fit: Fit, converged: Sequence[Run]) -> Iterator[Series]:
    """Yield the costs of the sorted runs by minimum."""
    # Five colors can be distinguished; nobody needs to distinguish twenty minima.
    groups = [
        (f"minimum {k}: {len(minimum.runs)} × cost {minimum.cost:.5g}", minimum.runs)
        for k, minimum in enumerate(fit.minima[:COLORED], 1)
    ]
    further = fit.minima[COLORED:]
    runs = tuple(index for minimum in further for index in minimum.runs)
    if runs:
        minima = counted(len(further), "further minimum", "further minima")
        groups.append((f"{counted(len(runs), 'run')} in {minima}", runs))

    for color, (name, indices) in enumerate(groups):
        members = [(k, run) for k, run in enumerate(converged, 1) if run.index in indices]
        yield Series(
            name,
            "points",
            *np.array([(k, run.cost) for k, run in members], dtype=float).reshape(-1, 2).T,
            color=color if color < COLORED else GRAY,
            style=color % COLORED,
            notes=[
                f"start {run.index}, cost {run.cost:.6g}, {counted(run.iterations, 'iteration')}"
                for _, run in members
            ],
        )


def _limits(costs: Sequence[float], is_logarithmic: bool) -> Interval:
    """Return limits that hide no minimum among the sorted costs and do not magnify rounding."""
    if not costs:
        return 0.0, 1.0
    if is_logarithmic:
        return costs[0] / 1.5, costs[-1] * 1.5
    # At least a tenth of the cost: equal costs differ by rounding, which must not fill the panel.
    room = 0.1 * max(costs[-1] - costs[0], abs(costs[0]), 1e-12)
    return costs[0] - room, costs[-1] + 2 * room
