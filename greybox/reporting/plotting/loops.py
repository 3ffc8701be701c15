"""Loops with confidence bands, as Bode, Nichols, Nyquist diagram and step."""

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

REACH = 5.0  # of the frequency axis, below and above the frequencies of the margins
FARTHEST = 30.0  # dB, of a gain margin that is marked
PHASES, DECIBELS = (-330.0, -30.0), (-40.0, 40.0)  # of the Nichols diagram
DRAWN_CURVES = 25  # in the Nichols and Nyquist diagrams, where a band has no direction
ESTIMATE = "estimate"
TURN = np.exp(1j * np.linspace(0, math.tau, 181))


@public
def loop(margins: Margins, axes: GivenAxes | None = None, *, hz: bool = False) -> AxesArray:
    """Draw the broken loop (magnitude, phase, Nichols, Nyquist), its sensitivity and a step.

    The phase and gain margins are marked with their intervals, and in the Nyquist diagram the
    modulus margin, a circle. Shaded are bands at the level of the margins; in the Nichols and
    Nyquist diagrams thin curves are draws from the distribution of the estimates. The frequencies
    are those around the margins.

    Parameters
    ----------
    margins : Margins
        Its `points` are drawn, too, with bars of one standard deviation; in the Nyquist diagram
        with circles, their regions at the level of the margins.
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
    # No place of the grid is left empty.
    columns = 3 if panels % 3 == 0 else 2
    return draw(figures, axes, columns=columns, size=(4.4, 3.8), title=margins.plant, hz=hz)


def loop_figures(margins: Margins) -> list[Figure]:
    """Return the Bode, Nichols and Nyquist diagrams, then sensitivity and step of a model."""
    require_drawable(margins, Margins, "the Margins that gb.margins returns")
    omega, gain = _curves(margins)
    decibel, phase = decibels_of(gain), np.degrees(np.unwrap(np.angle(gain)))
    phase -= 360 * np.round((phase - phase[0]).mean(axis=1, keepdims=True) / 360)
    # In the turn that has -180 degrees in its middle, at the gain nearest to one.
    phase -= 360 * math.ceil(phase[0, np.abs(decibel[0]).argmin()] / 360)
    # The points of a measured loop have regions of their own.
    name = ESTIMATE if margins.loop else "between the points"
    limits = (None, None)
    if not margins.loop:
        # A point without information must not set the scale.
        limits = [_within(curve[0], (-math.inf, math.inf), 0.15) for curve in (decibel, phase)]
    curves: list[list[Series]] = [
        [*_banded(margins, omega, decibel, name), rule()],
        [*_banded(margins, omega, phase, name), rule(-180.0)],
        _plane(phase, decibel, (-180.0, 0.0), name),
        [_circle(0.0, 1.0, GRAY, style=1), *_plane(gain.real, gain.imag, (-1.0, 0.0), name)],
    ]
    marks = _phase_marks(margins, omega, phase[0]), _gain_marks(margins)
    for k, series in enumerate(curves):
        for mark in marks:
            series.extend(mark[k])
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
    # Low frequencies are far away; what matters is around the critical point.
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
    """Return the points of a measured loop in each of the four diagrams."""
    size, angle = data.decibels, data.degrees
    # Both phases in the same turn.
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
    # The slowest pole may have no part in the step.
    is_shown = time <= 4 * margins["settling time"].value
    series = [*_banded(margins, time[is_shown], steps[:, is_shown], ESTIMATE), rule(1.0)]
    step = Panel(f"{margins.response} over its final value", series)
    return [
        Figure("Sensitivity", "ω, rad/s", [panel], bands=bands, is_logarithmic=True),
        Figure(f"Step of {margins.setpoint}", "Time, s", [step], bands=bands),
    ]


def _band_name(margins: Margins) -> str:
    """Return the entry of the band in the legend; empty without errors."""
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
            # A loop without margins: where its gain is nearest to one.
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
    """Return the curve of the estimate, and the band between quantiles of the draws."""
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
    circle = center + radius * TURN
    return Series(name, "line", circle.real, circle.imag, color, style)


def _within(values: Array, limits: tuple[float, float], share: float = 0.05) -> tuple[float, float]:
    """Return limits of an axis that show the values, but no more than these limits."""
    low, high = float(values.min()), float(values.max())
    room = share * (high - low)
    return max(limits[0], low - room), min(limits[1], high + room)


def _phase_marks(margins: Margins, omega: Array, phase: Array) -> list[list[Series]]:
    """Return the phase margin with its interval in each of the four diagrams."""
    row = _marked(margins, "phase margin")
    if row is None or row.value >= 180:
        return [[], [], [], []]
    # The margin is one of lag or of lead.
    sign = 1.0 if np.interp(row.omega, omega, phase) > -180 else -1.0
    tip, ends = -180 + sign * row.value, -180 + sign * np.array([row.low, row.high])
    ends = np.sort(ends) if np.isfinite(ends).all() else np.full(2, tip)
    name, at, zero = _label(row), row.omega, np.zeros(2)
    arc = _on_circle(-180, tip)
    edge = _on_circle(ends[0], ends[1])
    return [
        [Series("", "points", np.array([at]), np.zeros(1), 1)],
        _mark(name, np.full(2, at), np.array([-180, tip]), ends, 1),
        _mark(name, np.array([-180, tip]), zero, ends, 1, is_across=True),
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
    """Return the gain margin with its interval in each of the four diagrams."""
    row = _marked(margins, "gain margin")
    if row is None or row.value > FARTHEST:
        return [[], [], [], []]
    tip, ends = -row.value, -np.array([row.high, row.low])
    ends = ends if np.isfinite(ends).all() else np.full(2, tip)
    name, at = _label(row), row.omega
    place, low, high = (-(10 ** (value / 20)) for value in (tip, ends[1], ends[0]))
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
