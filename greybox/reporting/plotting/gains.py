"""Gains that meet requirements, and the loop with proposed gains beside that with today's."""

from collections.abc import Callable

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.data.frequency_response import decibels_of
from greybox.reporting.plotting.figure import (
    CROSS,
    GRAY,
    INK,
    Figure,
    Panel,
    Series,
    band,
    require_drawable,
    rule,
)
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.workflows.experiment.closed_loop import step_responses
from greybox.workflows.experiment.gain_comparison import GainComparison
from greybox.workflows.experiment.gain_objectives import moment_steps
from greybox.workflows.experiment.loop_numbers import loop_frequencies
from greybox.workflows.experiment.safe_gains import SafeGains
from greybox.workflows.experiment.sampled_loop import SampledLoop

SHOWN = (0.05, 8.0)  # frequencies of the sensitivity, over that of its peak


@public
def gains(safe: SafeGains, axes: GivenAxes | None = None) -> AxesArray:
    """Draw which sets of gains are allowed, and the loop with today's and with the other gains.

    The first panel has today's gains and the proposed ones, if any. A single gain has its
    confidence above it. With three gains, the first two are drawn at the proposed value of the
    third, or today's if none is proposed. The other panels have the sensitivity, the step of the
    setpoint and the response to a step moment, with bands at the level of the answer.

    Parameters
    ----------
    safe : SafeGains
    axes : array-like of Axes, optional
        One for the gains, and one for each of the other panels. By default a new figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
    """
    figures = [gains_figure(safe), *comparison_figures(safe)]
    return draw(figures, axes, columns=min(len(figures), 2), size=(5.0, 3.8))


def comparison_figures(safe: SafeGains) -> list[Figure]:
    """Return sensitivity, step of the setpoint and response to a moment, before and after.

    Empty if no gains are compared with today's.
    """
    comparison = safe.comparison
    if comparison is None or comparison.loops is None or comparison.today_loops is None:
        return []
    if not comparison.today_is_stable:
        return []
    signal = comparison.signal
    omega = loop_frequencies(comparison.loops)
    size = np.abs(comparison.loops.first.gains(signal, [signal], omega)[0, :, 0])
    peak = omega[size.argmax()]
    omega = omega[(omega > SHOWN[0] * peak) & (omega < SHOWN[1] * peak)]

    def sensitivity(loops: SampledLoop) -> tuple[Array, Array]:
        return omega, decibels_of(loops.gains(signal, [signal], omega)[..., 0])

    bands = f"{100 * comparison.level:g} % band"
    label = f"|S| at {signal}, dB"
    lines = [*_before_and_after(comparison, sensitivity), rule(), rule(-3.0, style=1)]
    figures = [
        Figure("Sensitivity", "ω, rad/s", [Panel(label, lines)], bands=bands, is_logarithmic=True)
    ]
    if comparison.tracking:
        setpoint, response = comparison.tracking

        def step(loops: SampledLoop) -> tuple[Array, Array]:
            time, steps = step_responses(loops, setpoint, response)
            is_shown = time <= comparison.horizon / 2
            return time[is_shown], steps[:, is_shown]

        label = f"{response} over its final value"
        panel = Panel(label, [*_before_and_after(comparison, step), rule(1.0)])
        figures.append(Figure(f"Step of {setpoint}", "Time, s", [panel], bands=bands))

    added_to, response = comparison.moment

    def moment(loops: SampledLoop) -> tuple[Array, Array]:
        time, steps = moment_steps(loops, added_to, response)
        is_shown = time <= comparison.horizon
        return time[is_shown], steps[:, is_shown]

    panel = Panel(f"{response} per moment", [*_before_and_after(comparison, moment), rule()])
    figures.append(Figure(f"Step moment at {added_to}", "Time, s", [panel], bands=bands))
    return figures


def _before_and_after(
    comparison: GainComparison, curves: Callable[[SampledLoop], tuple[Array, Array]]
) -> list[Series]:
    """Return the curves of both loops with their bands."""
    after = "refused" if comparison.refusals else "proposed"
    series = []
    for name, loops, color in (
        ("with today's gains", comparison.today_loops, 0),
        (f"with the {after} gains", comparison.loops, 1),
    ):
        assert loops is not None
        x, values = curves(loops)
        tail = (1 - comparison.level) / 2
        shown = f"{100 * comparison.level:g} % band"
        series.append(
            band(shown, x, *np.quantile(values[1:], [tail, 1 - tail], axis=0), color=color)
        )
        series.append(Series(name, "line", x, values[0], color, style=color))
    return series


def gains_figure(safe: SafeGains) -> Figure:
    """Return the region of allowed gains."""
    require_drawable(safe, SafeGains, "the SafeGains that gb.safe_gains returns")
    names, rows = [*safe.values], [*safe.values.values()]
    chosen = safe.best or safe.today
    allowed, confidence = safe.allowed, safe.confidence
    for name in names[2:]:
        nearest = np.abs(safe.values[name] - chosen[name]).argmin()
        allowed, confidence = allowed[..., nearest], confidence[..., nearest]

    if len(names) == 1:
        label = "Confidence"
        is_logarithmic = False
        heights = (safe.today_confidence, 1.0)
        level = rule(safe.requirements["level"])
        series = [Series("confidence", "line", rows[0], confidence), level]
    else:
        label = names[1]
        is_logarithmic = bool(rows[1][0] > 0)
        heights = safe.today[label], chosen[label]
        x, y = np.meshgrid(*rows[:2], indexing="ij")
        series = [
            Series("refused", "points", x[~allowed], y[~allowed], GRAY, CROSS),
            Series("allowed", "points", x[allowed], y[allowed], 2),
        ]
    for name, gains, height, look in (
        ("today", safe.today, heights[0], (INK, 3)),
        ("proposed", safe.best, heights[1], (1, 1)),
    ):
        if gains:
            place = np.array([gains[names[0]]]), np.array([height])
            series.append(Series(name, "points", *place, *look))
    panel = Panel(label, series, is_logarithmic=is_logarithmic)
    return Figure("Gains", names[0], [panel], is_logarithmic=bool(rows[0][0] > 0))
