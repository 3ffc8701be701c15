"""Loops with confidence bands, as Bode, Nichols, Nyquist diagram and step."""

import math
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.frequency_response import decibels_of
from greybox.reporting.plotting.bode import BARS, error_bars
from greybox.reporting.plotting.figure import (
    ANGLES,
    Figure,
    Panel,
    Series,
    band,
    require_drawable,
    rule,
)
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.nyquist import CIRCLES, in_plane
from greybox.workflows.experiment.closed_loop import step_responses
from greybox.workflows.experiment.drawn_loops import DRAWN
from greybox.workflows.experiment.loop_numbers import loop_frequencies
from greybox.workflows.experiment.margin_values import Margins

# Gains of the broken loop that are drawn, over its gain nearest to one
SHOWN = (1e-2, 1e2)


def loop(margins: Margins, axes: GivenAxes | None = None, *, hz: bool = False) -> AxesArray:
    """Draw the broken loop (magnitude, phase, Nichols, Nyquist) and the step of its setpoint.

    Shaded are bands at the level of the margins; in the Nichols and Nyquist diagrams thin curves
    are draws from the distribution of the estimates, and the critical point is marked.

    Parameters
    ----------
    margins : Margins
        Its `points` are drawn, too, with bars of one standard deviation; in the Nyquist diagram
        with circles, their regions at the level of the margins.
    axes : array-like of Axes, optional
        Four for the broken loop, and one more for the step. By default a new figure is made.
    hz : bool
        Frequencies in Hz.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
    """
    return draw(loop_figures(margins), axes, columns=3, size=(4.2, 3.6), title=margins.plant, hz=hz)


def loop_figures(margins: Margins) -> list[Figure]:
    """Return the Bode, Nichols and Nyquist diagrams, and the step if there is a setpoint."""
    require_drawable(margins, Margins, "the Margins that gb.margins returns")
    loops = margins.require_loop()
    signal = margins.signal
    omega = loop_frequencies(loops)
    size = np.abs(loops.first.broken_at(signal, omega)[0])
    middle = np.clip(1.0, size.min(), size.max())
    omega = omega[(size > SHOWN[0] * middle) & (size < SHOWN[1] * middle)]
    gain = loops.broken_at(signal, omega)
    decibel, phase = decibels_of(gain), np.degrees(np.unwrap(np.angle(gain)))
    phase -= 360 * np.round((phase - phase[0]).mean(axis=1, keepdims=True) / 360)
    # In the turn that has -180 degrees in its middle, at the gain nearest to one.
    phase -= 360 * math.ceil(phase[0, np.abs(decibel[0]).argmin()] / 360)
    curves: list[list[Series]] = [
        [*_banded(margins, omega, decibel), rule()],
        [*_banded(margins, omega, phase), rule(-180.0)],
        _plane(phase, decibel, (-180.0, 0.0)),
        _plane(gain.real, gain.imag, (-1.0, 0.0)),
    ]
    for k, data in enumerate(margins.points, start=2):
        size, angle = data.decibels, data.degrees
        # Both phases in the same turn.
        angle -= 360 * np.round(np.mean(angle - np.interp(data.omega, omega, phase[0])) / 360)
        sizes, angles = error_bars(data, np.array([size, angle]))
        looks: list[dict[str, Any]] = [
            {"x": data.omega, "y": size, **sizes},
            {"x": data.omega, "y": angle, **angles},
            {"x": angle, "y": size, **sizes},
            in_plane(data, margins.level),
        ]
        for series, look in zip(curves, looks, strict=True):
            series.append(Series(data.name or "measured", "points", color=k, style=k, **look))

    panels = [Panel("Gain, dB", curves[0]), Panel("Phase, °", curves[1], steps=ANGLES)]
    nichols = Panel("Gain, dB", curves[2])
    # Low frequencies are far away; what matters is around the critical point.
    nyquist = Panel("Imaginary part", curves[3], limits=(-2.0, 2.0))
    captions = (BARS, CIRCLES) if margins.points else ("", "")
    figures = [
        Figure(
            f"Loop broken at {signal}", "ω, rad/s", panels, caption=captions[0], is_logarithmic=True
        ),
        Figure("Nichols diagram", "Phase, °", [nichols], caption=captions[0]),
        Figure(
            "Nyquist diagram",
            "Real part",
            [nyquist],
            limits=(-2.5, 1.5),
            is_plane=True,
            caption=captions[1],
        ),
    ]
    for settling in (row.value for row in margins.margins if row.name == "settling time"):
        time, steps = step_responses(loops, margins.setpoint, margins.response)
        is_shown = time <= 4 * settling  # the slowest pole may have no part in the step
        series = [*_banded(margins, time[is_shown], steps[:, is_shown]), rule(1.0)]
        label = f"{margins.response} over its final value"
        figures.append(Figure(f"Step of {margins.setpoint}", "Time, s", [Panel(label, series)]))
    return figures


def _banded(margins: Margins, x: Array, values: Array) -> list[Series]:
    """Return the curve of the estimate, and the band between quantiles of the draws."""
    curve = [Series("estimate", "line", x, values[0])]
    if len(values) == 1:
        return curve
    tail = (1 - margins.level) / 2
    return [band("", x, *np.quantile(values[DRAWN], [tail, 1 - tail], axis=0)), *curve]


def _plane(x: Array, y: Array, critical: tuple[float, float]) -> list[Series]:
    """Return the curve of the estimate over those of draws, and the critical point."""
    # Draws in the Nichols and Nyquist diagrams, where a band has no direction
    return [
        *(Series("", "line", x[k], y[k], 5, is_hollow=True) for k in range(len(x))[DRAWN][:25]),
        Series("estimate", "line", x[0], y[0]),
        Series("critical point", "points", *np.array(critical)[:, None], color=1),
    ]
