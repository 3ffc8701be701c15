"""The waterfall of the starts: the cost that each of them ended at."""

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.text_table import counted
from greybox.html_report.figure import Figure, Panel, Series
from greybox.plotting.starts import LOG_SPAN
from greybox.solve.outcome import SCREENED

COLORED = 5  # minima with a color of their own; the others are gray
CROSS = -1  # the marker of what failed


def starts_figure(fit: Fit) -> Figure:
    """Return the final costs of all runs, sorted, by the minimum that they reached; failed ones to their right."""
    brought = [run for run in fit.runs if run.stage != SCREENED]
    ended = sorted((run for run in brought if run.converged), key=lambda run: (run.cost, run.index))
    failed = [run for run in brought if not run.converged]
    place = {run.index: k for k, run in enumerate(ended, 1)}
    by_index = {run.index: run for run in ended}

    series = []
    for k, minimum in enumerate(fit.minima):
        runs = sorted((by_index[i] for i in minimum.runs), key=lambda run: place[run.index])
        is_colored = k < COLORED
        name = (
            f"minimum {k + 1}: {len(runs)} × cost {minimum.cost:.5g}"
            if is_colored
            else "further minima"
        )
        series.append(
            Series(
                name=name,
                kind="points",
                x=np.array([place[run.index] for run in runs], dtype=float),
                y=np.array([run.cost for run in runs]),
                color=k if is_colored else -1,
                style=k if is_colored else 0,
                notes=[
                    f"start {run.index}, cost {run.cost:.6g}, {counted(run.iterations, 'iteration')}"
                    for run in runs
                ],
            )
        )
    costs = [run.cost for run in ended]
    is_logarithmic = bool(costs) and costs[0] > 0 and costs[-1] > LOG_SPAN * costs[0]
    limits = _limits(costs, is_logarithmic)
    if failed:
        top = (
            (limits[1] - 0.07 * (limits[1] - limits[0])) if not is_logarithmic else limits[1] / 1.2
        )
        count = len(ended)
        series.append(
            Series(
                name=f"{len(failed)} × failed",
                kind="points",
                x=np.arange(count + 1, count + len(failed) + 1, dtype=float),
                y=np.full(len(failed), top),
                color=-2,
                style=CROSS,
                notes=[f"start {run.index}, {run.status}" for run in failed],
            )
        )

    count = counted(len(brought), "start")
    if len(brought) < len(fit.runs):
        count = f"{len(brought)} most promising of {counted(len(fit.runs), 'start')}"
    agreement = f"{fit.agreeing} of {count} {'agrees' if fit.agreeing == 1 else 'agree'} on the best minimum."
    caption = agreement if fit.converged else f"None of {count} converged."
    if failed:
        caption += " Failed runs stand at the right; their height means nothing."
    panel = Panel("Cost", series, height=1.3, is_logarithmic=is_logarithmic, limits=limits)
    return Figure(
        "Starts",
        "Runs, sorted by cost",
        [panel],
        caption,
        is_whole=True,
        limits=(0.0, len(brought) + 1.0),
    )


def _limits(costs: list[float], is_logarithmic: bool) -> tuple[float, float]:
    """Return the ends of the axis, so that neither rounding nor a large range hides the minima."""
    if not costs:
        return 0.0, 1.0
    if is_logarithmic:
        return costs[0] / 1.5, costs[-1] * 1.5
    room = 0.1 * max(costs[-1] - costs[0], abs(costs[0]), 1e-12)
    return costs[0] - room, costs[-1] + 2 * room
