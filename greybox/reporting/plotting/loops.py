"""Figures of loops with confidence bands: Bode, Nichols and Nyquist diagrams, and steps."""

import math
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array, ComplexArray
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse, decibels_of
from greybox.reporting.plotting.bode import BARS, error_bars
from greybox.reporting.plotting.figure import (
    ANGLES,
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
from greybox.reporting.plotting.nyquist import CIRCLES, in_plane
from greybox.workflows.experiment.closed_loop import step_responses
from greybox.workflows.experiment.drawn_loops import DRAWN
from greybox.workflows.experiment.loop_numbers import loop_frequencies
from greybox.workflows.experiment.margin_values import Margin, Margins, with_interval
from greybox.workflows.experiment.measured_loop_margins import measured_curves

# Factor by which the frequency axis extends below and above the frequencies of the margins.
REACH = 5.0
# Largest gain margin that is marked, dB.
FARTHEST = 30.0
# Largest limits of the axes of the Nichols diagram, degrees and dB.
PHASES = (-330.0, -30.0)
DECIBELS = (-40.0, 40.0)
# Curves of draws in the Nichols and Nyquist diagrams, where a band would have no direction.
DRAWN_CURVES = 25
ESTIMATE = "estimate"
# Points of the unit circle.
TURN = np.exp(1j * np.linspace(0, math.tau, 181))


@public
def loop(margins: Margins, axes: GivenAxes | None = None, *, hz: bool = False) -> AxesArray:
    """Draw the broken loop (magnitude, phase, Nichols, Nyquist), its sensitivity and a step.

    The phase and gain margins are marked with their intervals, and in the Nyquist diagram the
    modulus margin by a circle. Bands at the level of the margins are shaded. In the Nichols and
    Nyquist diagrams, thin curves show draws from the distribution of the estimates. The frequencies
    are those around the margins.

    Parameters
    ----------
    margins : Margins
        Its `points` are drawn, too, with bars of one standard deviation. In the Nyquist diagram,
        circles show their confidence regions at the level of the margins.
    axes : array-like of Axes, optional
        Four for the broken loop, and with a model and a setpoint two more, for the sensitivity and
        the step. By default a new figure is made.
    hz : bool
        Frequencies in Hz.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
    """
    figures = loop_figures(margins)
    panels = sum(len(figure.panels) for figure in figures)
    # With these columns, no place of the grid is empty.
    columns = 3 if panels % 3 == 0 else 2
    return draw(figures, axes, columns=columns, size=(4.4, 3.8), title=margins.plant, hz=hz)


def loop_figures(margins: Margins) -> list[Figure]:
    """Return the Bode, Nichols and Nyquist diagrams, then the sensitivity and step of a model."""
    require_drawable(margins, Margins, "the Margins that gb.margins returns")
    omega, gain = _curves(margins)
    decibel = decibels_of(gain)
    phase = np.degrees(np.unwrap(np.angle(gain)))
    # Draws are in the same turn as the estimate. At the gain nearest to one, its phase is between
    # -360 and 0 degrees.
    phase -= 360 * np.round((phase - phase[0]).mean(axis=1, keepdims=True) / 360)
    phase -= 360 * math.ceil(phase[0, np.abs(decibel[0]).argmin()] / 360)
    # The points of a measured loop are drawn themselves, and the curve is between them.
    name = ESTIMATE if margins.loop else "between the points"
    limits = (None, None)
    if not margins.loop:
        # The curve sets the scale: a point without information has bars of any length.
        limits = [_within(curve[0], (-math.inf, math.inf), 0.15) for curve in (decibel, phase)]
    # The series of the four diagrams: gain, phase, Nichols, Nyquist.
    curves: list[list[Series]] = [
        [*_banded(margins, omega, decibel, name), rule()],
        [*_banded(margins, omega, phase, name), rule(-180.0)],
        _plane(phase, decibel, (-180.0, 0.0), name),
        [_circle(0.0, 1.0, GRAY, style=1), *_plane(gain.real, gain.imag, (-1.0, 0.0), name)],
    ]
    for marks in (_phase_marks(margins, omega, phase[0]), _gain_marks(margins)):
        for series, mark in zip(curves, marks, strict=True):
            series.extend(mark)
    curves[3] += _modulus_mark(margins)
    for k, measured in enumerate(margins.points):
        is_near = (measured.omega >= omega[0]) & (measured.omega <= omega[-1])
        if is_near.any():
            points = _points(measured.where(is_near), omega, phase[0], margins.level, 2 + k)
            for series, drawn in zip(curves, points, strict=True):
                series.append(drawn)

    captions = (BARS, CIRCLES) if margins.points else ("", "")
    bands = _band_name(margins)
    signal = f"Loop broken at {margins.signal}" if margins.signal else "Broken loop"
    # The part around the critical point matters. At low frequencies the loop is far away.
    nyquist = Panel("Imaginary part", curves[3], limits=(-2.0, 2.0))
    figures = [
        Figure(
            signal,
            "ω, rad/s",
            [
                Panel("Gain, dB", curves[0], limits=limits[0]),
                Panel("Phase, °", curves[1], limits=limits[1], steps=ANGLES),
            ],
            caption=captions[0],
            bands=bands,
            is_logarithmic=True,
        ),
        Figure(
            "Nichols diagram",
            "Phase, °",
            [Panel("Gain, dB", curves[2], limits=_within(decibel[0], DECIBELS))],
            caption=captions[0],
            limits=_within(phase[0], PHASES),
        ),
        Figure(
            "Nyquist diagram",
            "Real part",
            [nyquist],
            limits=(-2.5, 1.5),
            is_plane=True,
            caption=captions[1],
        ),
    ]
    if any(row.name == "settling time" for row in margins.margins):
        figures += _closed_loop(margins, omega, gain)
    return figures


def _points(
    data: FrequencyResponse, omega: Array, phase: Array, level: float, color: int
) -> list[Series]:
    """Return the points of a measured loop as a series for each of the four diagrams."""
    size = data.decibels
    angle = data.degrees
    # In the same turn as the curve.
    angle -= 360 * np.round(np.mean(angle - np.interp(data.omega, omega, phase)) / 360)
    sizes, angles = error_bars(data, np.array([size, angle]))
    looks: list[dict[str, Any]] = [
        {"x": data.omega, "y": size, **sizes},
        {"x": data.omega, "y": angle, **angles},
        {"x": angle, "y": size, **sizes},
        in_plane(data, None if math.isnan(level) else level),
    ]
    name = data.name or "measured"
    return [Series(name, "points", color=color, style=color, **look) for look in looks]


def _closed_loop(margins: Margins, omega: Array, gain: ComplexArray) -> list[Figure]:
    """Return the sensitivity and the step of the setpoint."""
    bands = _band_name(margins)
    sensitivity = [
        *_banded(margins, omega, -decibels_of(1 + gain), ESTIMATE),
        rule(),
        rule(-3.0, style=1),
    ]
    panel = Panel(f"|S| at {margins.signal}, dB", sensitivity)
    time, steps = step_responses(margins.require_loop(), margins.setpoint, margins.response)
    # The step responses last until the slowest pole has decayed, which may not show in them.
    is_shown = time <= 4 * margins["settling time"].value
    series = [*_banded(margins, time[is_shown], steps[:, is_shown], ESTIMATE), rule(1.0)]
    step = Panel(f"{margins.response} over its final value", series)
    return [
        Figure("Sensitivity", "ω, rad/s", [panel], bands=bands, is_logarithmic=True),
        Figure(f"Step of {margins.setpoint}", "Time, s", [step], bands=bands),
    ]


def _band_name(margins: Margins) -> str:
    """Return the name of the band in the legend; empty without intervals."""
    return "" if math.isnan(margins.level) else f"{100 * margins.level:g} % band"


def _curves(margins: Margins) -> tuple[Array, ComplexArray]:
    """Return the frequencies (n,) around the margins, and the loop (plants, n) there."""
    places = []
    for row in margins.margins:
        is_shown = row.unit == "deg" or (row.unit == "dB" and abs(row.value) < FARTHEST)
        if row.name.split()[0] in ("phase", "gain") and is_shown and math.isfinite(row.omega):
            places.append(row.omega)
    if margins.loop is None:
        gain, omega = measured_curves(margins.points[0])
    else:
        omega = loop_frequencies(margins.loop)
        gain = None
        if not places:
            # A loop without margins is shown around the gain nearest to one.
            size = np.abs(margins.loop.first.broken_at(margins.signal, omega)[0])
            places = [omega[np.abs(np.log(size)).argmin()]]
    if places:
        is_near = (omega >= min(places) / REACH) & (omega <= max(places) * REACH)
        omega = omega[is_near]
        gain = gain[:, is_near] if gain is not None else None
    if gain is None:
        gain = margins.require_loop().broken_at(margins.signal, omega)
    return omega, gain


def _banded(margins: Margins, x: Array, values: Array, name: str) -> list[Series]:
    """Return the curve of the estimate, and the band between quantiles of the draws.

    `values` (plants, n) have the estimate first.
    """
    curve = [Series(name, "line", x, values[0])]
    if len(values) == 1:
        return curve
    tail = (1 - margins.level) / 2
    return [
        band(_band_name(margins), x, *np.quantile(values[DRAWN], [tail, 1 - tail], axis=0)),
        *curve,
    ]


def _plane(x: Array, y: Array, critical: tuple[float, float], name: str) -> list[Series]:
    """Return the curve of the estimate over those of draws, and the critical point."""
    draws = range(len(x))[DRAWN][:DRAWN_CURVES] if name == ESTIMATE else ()
    return [
        *(Series("draws from the errors", "line", x[k], y[k], 5, is_hollow=True) for k in draws),
        Series(name, "line", x[0], y[0]),
        Series("critical point", "points", *np.array(critical)[:, None], color=INK, style=6),
    ]


def _circle(center: float, radius: float, color: int, style: int = 0, name: str = "") -> Series:
    """Return a circle around a point of the real axis."""
    circle = center + radius * TURN
    return Series(name, "line", circle.real, circle.imag, color, style)


def _within(values: Array, limits: tuple[float, float], share: float = 0.05) -> tuple[float, float]:
    """Return limits of an axis around the values, within the given limits.

    `share` is the room on either side, as a share of the range of the values.
    """
    low, high = float(values.min()), float(values.max())
    room = share * (high - low)
    return max(limits[0], low - room), min(limits[1], high + room)


def _phase_marks(margins: Margins, omega: Array, phase: Array) -> list[list[Series]]:
    """Return the phase margin with its interval as series for each of the four diagrams."""
    row = _marked(margins, "phase margin")
    if row is None or row.value >= 180:
        return [[], [], [], []]
    # The phase lies above -180 degrees, or below.
    sign = 1.0 if np.interp(row.omega, omega, phase) > -180 else -1.0
    tip = -180 + sign * row.value
    ends = np.sort(-180 + sign * np.array([row.low, row.high]))
    if not np.isfinite(ends).all():
        ends = np.full(2, tip)
    name = _label(row)
    at = row.omega
    arc = _on_circle(-180, tip)
    edge = _on_circle(ends[0], ends[1])
    return [
        [Series("", "points", np.array([at]), np.zeros(1), 1)],
        _mark(name, np.full(2, at), np.array([-180, tip]), ends, 1),
        _mark(name, np.array([-180, tip]), np.zeros(2), ends, 1, is_across=True),
        [
            Series(name, "line", arc.real, arc.imag, 1),
            # The interval is a part of the unit circle.
            Series("", "line", 1.02 * edge.real, 1.02 * edge.imag, 1),
            Series("", "line", 0.98 * edge.real, 0.98 * edge.imag, 1),
            Series("", "points", arc.real[-1:], arc.imag[-1:], 1),
        ],
    ]


def _on_circle(begin: float, end: float) -> ComplexArray:
    """Return points (n,) of the unit circle between two angles in degrees."""
    return np.exp(1j * np.radians(np.linspace(begin, end, 60))).astype(complex)


def _gain_marks(margins: Margins) -> list[list[Series]]:
    """Return the gain margin with its interval as series for each of the four diagrams."""
    row = _marked(margins, "gain margin")
    if row is None or row.value > FARTHEST:
        return [[], [], [], []]
    tip = -row.value
    ends = -np.array([row.high, row.low])
    if not np.isfinite(ends).all():
        ends = np.full(2, tip)
    name = _label(row)
    at = row.omega
    # The same on the real axis, from decibels to gains.
    place, low, high = (-(10 ** (decibels / 20)) for decibels in (tip, ends[1], ends[0]))
    bar = _mark(name, np.full(2, at), np.array([0, tip]), ends, 3)
    return [
        bar,
        [Series("", "points", np.array([at]), np.array([-180.0]), 3)],
        _mark(name, np.full(2, -180.0), np.array([0, tip]), ends, 3),
        [
            Series(name, "line", np.array([-1, place]), np.zeros(2), 3),
            Series("", "line", np.array([low, high]), np.full(2, 0.02), 3),
            Series("", "line", np.array([low, high]), np.full(2, -0.02), 3),
            Series("", "points", np.array([place]), np.zeros(1), 3),
        ],
    ]


def _modulus_mark(margins: Margins) -> list[Series]:
    """Return the circle around -1 that the loop does not enter, and those of its interval."""
    row = _marked(margins, "modulus margin")
    if row is None:
        return []
    circles = [_circle(-1.0, row.value, 4, name=_label(row))]
    circles += [_circle(-1.0, end, 4, style=2) for end in (row.low, row.high) if np.isfinite(end)]
    return circles


def _marked(margins: Margins, name: str) -> Margin | None:
    """Return a margin that occurs at a frequency; None for others."""
    for row in margins.margins:
        if row.name == name and math.isfinite(row.value) and math.isfinite(row.omega):
            return row
    return None


def _label(row: Margin) -> str:
    """Return a margin with its interval and unit."""
    return f"{row.name} {with_interval(row)} {row.unit}".strip()


def _mark(
    name: str, x: Array, y: Array, ends: Array, color: int, *, is_across: bool = False
) -> list[Series]:
    """Return a margin as a line to the curve, with an error bar at its end."""
    return [
        Series(name, "line", x, y.astype(float), color),
        Series(
            "",
            "points",
            x[1:].astype(float),
            y[1:].astype(float),
            color,
            low=ends[:1],
            high=ends[1:],
            is_across=is_across,
        ),
    ]
