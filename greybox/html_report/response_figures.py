"""Bode and Nyquist diagrams of fits, with their data."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array, IntArray
from greybox.html_report.figure import Figure, Panel, Series
from greybox.plotting.bode import band_limits, error_bars, phases
from greybox.plotting.nyquist import UNLIKE, panels
from greybox.plotting.response_series import (
    LINE_STYLES,
    ErrorSeries,
    ResponseSeries,
    error_series,
    interpolated,
    ratio,
    response_series,
)
from greybox.plotting.style import COLORS, GRAYS, MARKERS

LEVEL = 0.95  # of bands
BLACK, GRAY = -2, -1
ANGLES = (1, 2, 5, 15, 30, 45, 90, 180, 360, 720)  # degrees between ticks
POINTS = 400  # of a curve in a figure: twice what a panel shows in pixels of half its width


def response_figures(fits: Sequence[Fit], labels: Sequence[str] = ()) -> list[Figure]:
    """Return a Bode and one or more Nyquist diagrams of the responses of fits; none where there are no responses."""
    fits = [fit for fit in fits if fit.responses]
    if not fits:
        return []
    series = response_series(fits, labels, LEVEL if all(fit.converged for fit in fits) else None)
    thinned = [_thinned(one) for one in series]
    return [
        _bode(thinned, error_series(fits, series)),
        *(_nyquist(group) for group in panels(thinned)),
    ]


def _bode(series: Sequence[ResponseSeries], errors: Sequence[ErrorSeries]) -> Figure:
    magnitude, phase, coherence = _known(series)
    drawn = [
        Panel(f"Magnitude of {ratio(series)}, dB", magnitude),
        Panel(f"Phase of {ratio(series)}, °", phase, steps=ANGLES),
    ]
    if coherence:
        drawn.append(Panel("Coherence γ²", coherence, height=0.6, limits=(0.0, 1.05)))
    drawn += _error_panels(series, errors)
    told = []
    if any(one.band is not None for one in series):
        told.append(f"Shaded is the {100 * LEVEL:g} % confidence band of the fitted response.")
    if any(one.response.variance is not None for one in series):
        told.append("Bars are one standard deviation of the measurement.")
    if errors:
        told.append("Errors are measured less fitted values.")
    return Figure("Bode diagram", "ω, rad/s", drawn, " ".join(told) or None, is_logarithmic=True)


def _known(series: Sequence[ResponseSeries]) -> tuple[list[Series], list[Series], list[Series]]:
    """Return what is drawn of magnitude, phase and coherence; bands below all else."""
    magnitude: list[Series] = []
    phase: list[Series] = []
    coherence: list[Series] = []
    for one, degrees in zip(series, phases(series), strict=True):
        with np.errstate(divide="ignore"):
            decibel = 20 * np.log10(np.abs(one.response.response))
        down = up = turn = np.zeros(0)
        has_bars = one.response.variance is not None
        if has_bars:
            down, up, turn = error_bars(one.response)
        for found, values, ends in (
            (magnitude, decibel, (down, up)),
            (phase, degrees, (turn, turn)),
        ):
            bars = (values - ends[0], values + ends[1]) if has_bars else (None, None)
            found.append(_series(one, values, *bars))
        if one.response.coherence is not None:
            coherence.append(_series(one, one.response.coherence))
        if one.band is not None:
            omega, low, high = band_limits(one.band)
            for found, values, down, up in zip(
                (magnitude, phase), (decibel, degrees), low, high, strict=True
            ):
                curve = interpolated(omega, one.response.omega, values)
                found.insert(0, _band(one, omega, curve + down, curve + up))
    return magnitude, phase, coherence


def _error_panels(series: Sequence[ResponseSeries], errors: Sequence[ErrorSeries]) -> list[Panel]:
    """Return the panels of measured less fitted values, with the bands of the fits."""
    if not errors:
        return []
    zero = Series("", "rule", np.zeros(1), np.zeros(1), GRAY)
    magnitude, phase = [zero], [zero]
    for one in series:
        if one.band is not None:
            omega, low, high = band_limits(one.band)
            for found, down, up in zip((magnitude, phase), low, high, strict=True):
                found.append(_band(one, omega, down, up))
    for error in errors:
        with np.errstate(divide="ignore"):
            values = 20 * np.log10(np.abs(error.ratio)), np.degrees(np.angle(error.ratio))
        bars: list[tuple[Array | None, Array | None]] = [(None, None), (None, None)]
        if error.data.variance is not None:
            down, up, turn = error_bars(error.data)
            bars = [(values[0] - down, values[0] + up), (values[1] - turn, values[1] + turn)]
        color, marker = _color(error.look["color"]), MARKERS.index(error.look["marker"])
        name = error.look["label"].lstrip("_").replace(r"\$", "$")
        for found, y, (low, high) in zip((magnitude, phase), values, bars, strict=True):
            found.append(
                Series(name, "points", error.data.omega, y, color, marker, low=low, high=high)
            )
    return [Panel("Error, dB", magnitude, height=0.55), Panel("Error, °", phase, height=0.55)]


def _band(one: ResponseSeries, omega: Array, low: Array, high: Array) -> Series:
    name = f"{_name(one.label)}, {100 * LEVEL:g} %"
    kept = _spread(len(omega))
    return Series(
        name, "band", omega[kept], low[kept], _color(one.color), low=low[kept], high=high[kept]
    )


def _nyquist(series: Sequence[ResponseSeries]) -> Figure:
    drawn = []
    for one in series:
        response = one.response
        notes = [
            f"{real:.4g} {'−' if imaginary < 0 else '+'} {abs(imaginary):.4g} j at {omega:.4g} rad/s"
            for omega, real, imaginary in zip(
                response.omega, response.alpha, response.beta, strict=True
            )
        ]
        drawn.append(
            _series(one, response.beta, x=response.alpha, notes=notes if one.measured else ())
        )
    panel = Panel(f"Imaginary part of {ratio(series)}", drawn)
    limits, note = _limits(series)
    if limits is not None:
        panel = Panel(panel.label, drawn, limits=limits[1])
    title = f"Nyquist diagram{f', {ratio(series)}' if ratio(series) != 'P(jω)' else ''}"
    horizontal = None if limits is None else limits[0]
    return Figure(
        title, f"Real part of {ratio(series)}", [panel], note, is_plane=True, limits=horizontal
    )


def _limits(
    series: Sequence[ResponseSeries],
) -> tuple[tuple[tuple[float, float], tuple[float, float]] | None, str | None]:
    """Return the ends of both axes where curves would make the data a dot, and a sentence that says so."""
    measured = [one.response.response for one in series if one.measured]
    curves = [one.response.response for one in series if not one.measured]
    size = max((float(np.abs(values).max()) for values in measured), default=0.0)
    reach = max((float(np.abs(values).max()) for values in curves), default=0.0)
    if not 0 < UNLIKE * size < reach:
        return None, None
    spots = np.concatenate([np.zeros(1, dtype=complex), *measured])
    across, along = (
        (float(part.min()), float(part.max())) for part in (np.real(spots), np.imag(spots))
    )
    ends = tuple((low - size / 2, high + size / 2) for low, high in (across, along))
    return (ends[0], ends[1]), f"Curves reach a magnitude of {reach:.3g}, beyond this figure."


def _series(
    one: ResponseSeries,
    y: Array,
    low: Array | None = None,
    high: Array | None = None,
    *,
    x: Array | None = None,
    notes: Sequence[str] = (),
) -> Series:
    return Series(
        name=_name(one.label),
        kind="points" if one.measured else "line",
        x=one.response.omega if x is None else x,
        y=y,
        color=_color(one.color),
        style=MARKERS.index(one.style) if one.measured else LINE_STYLES.index(one.style),
        low=low,
        high=high,
        notes=notes,
    )


def _color(color: str) -> int:
    if color in COLORS:
        return COLORS.index(color)
    return GRAY if color in GRAYS[1:] else BLACK


def _name(label: str) -> str:
    """Return a label without what matplotlib needs in it."""
    return label.replace(r"\$", "$")


def _thinned(one: ResponseSeries) -> ResponseSeries:
    """Return a curve with no more points than can be seen."""
    if one.measured:
        return one
    kept = np.zeros(len(one.response), dtype=bool)
    kept[_spread(len(kept))] = True
    return replace(one, response=one.response.where(kept))


def _spread(count: int) -> IntArray:
    """Return at most so many of the rows as can be seen."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).round().astype(int))
