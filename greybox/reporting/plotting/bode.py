"""The Bode diagram: magnitude, phase, coherence, and the errors of fits."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse, decibels_of
from greybox.reporting.plotting.figure import ANGLES, Figure, Panel, Series, band, rule
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw, flat_axes
from greybox.reporting.plotting.responses import (
    DrawnResponse,
    by_pair,
    drawn_responses,
    interpolated,
    ratio,
    title,
)

BARS = "Bars: one standard deviation of the measurement."
DB_PER_NEPER = 20 / np.log(10)
# Input-output pairs in one diagram: as many as there are colors.
MOST_PAIRS = 6


@public
def bode(
    *fits: Fit | FrequencyResponse,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    level: float | None = 0.95,
    hz: bool = False,
) -> AxesArray:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s.

    Below them are the coherence, if it is known, and the errors of fits: measured less fitted
    values in dB and degrees. If there are more than six input-output pairs, each has a row of
    panels, unless `axes` are given.

    Phases of curves are unwrapped along omega. The first curve of each input-output pair begins
    within (-180°, 180°]. Measured phases are shifted by multiples of 360°, so that they lie next to
    their curve.

    Error bars show one standard deviation of one component of the data, sqrt(variance / 2), in
    magnitude (20 dB at most) and in phase. The confidence band of a fit (`Fit.response_band`) is
    shaded; in the panels of errors it lies around zero.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        Data that several fits share are drawn once. A measured response is drawn as points, a
        response of a model (`Fit.response`, `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.
    axes : array-like of Axes, optional
        Two or more: for magnitude and phase, then for the coherence, if it is known, and the errors
        of fits. By default a new figure is made.
    level : float or None
        Confidence level of the bands; None draws none.
    hz : bool
        Frequencies in Hz.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.bode(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For items that cannot be drawn, or a wrong number of labels or axes.
    """
    if axes is None:
        figures = bode_figures(fits, labels, level)
        if len(figures) == 1:
            return draw(figures, hz=hz)
        rows = [replace(figure, subject="") for figure in figures]
        return draw(rows, columns=len(rows[0].panels), title=title(fits), hz=hz)
    # The axes take the first panels: two axes are for magnitude and phase, whatever else could be
    # drawn.
    [figure] = bode_figures(fits, labels, level, sys.maxsize)
    panels = figure.panels[: flat_axes(axes).size]
    return draw([replace(figure, panels=panels)], axes, hz=hz)


def bode_figures(
    fits: Sequence[Fit | FrequencyResponse],
    labels: Sequence[str] = (),
    level: float | None = 0.95,
    most: int = MOST_PAIRS,
) -> list[Figure]:
    """Return the Bode diagram with the errors of fits.

    More than `most` input-output pairs have a diagram each.
    """
    responses = drawn_responses(fits, labels, level)
    groups = by_pair(responses)
    if len(groups) <= most:
        groups = [responses]
    return [_figure(fits, group, level) for group in groups]


def _figure(
    fits: Sequence[Fit | FrequencyResponse],
    responses: Sequence[DrawnResponse],
    level: float | None,
) -> Figure:
    """Return the diagram of some of the responses."""
    # Series of magnitude, and series of phase.
    curves: tuple[list[Series], list[Series]] = ([], [])
    for drawn, degrees in zip(responses, phases(responses), strict=True):
        omega = drawn.response.omega
        values = np.array([drawn.response.decibels, degrees])
        for k, ends in enumerate(error_bars(drawn.response, values)):
            # Bands come first, so that all curves and points are drawn above them.
            if drawn.band is not None:
                curves[k].insert(0, _band(drawn, k, values[k]))
            curves[k].append(drawn.series(omega, values[k], **ends))

    name = ratio(responses)
    # Margins are read at multiples of 45 and 90 degrees, where the axis of phase has its ticks.
    panels = [
        Panel(f"Magnitude of {name}, dB", curves[0]),
        Panel(f"Phase of {name}, °", curves[1], steps=ANGLES),
    ]
    coherence = [
        drawn.series(drawn.response.omega, drawn.response.coherence)
        for drawn in responses
        if drawn.response.coherence is not None
    ]
    if coherence:
        panels.append(Panel("Coherence γ²", coherence, height=0.6, limits=(0.0, 1.05)))
    panels += _error_panels(fits, responses)
    return Figure(
        "Bode diagram" if name == "P(jω)" else f"Bode diagram, {name}",
        "ω, rad/s",
        panels,
        subject=title(fits) or "Bode diagram",
        caption=" ".join(_caption(responses, panels, level)),
        bands="" if level is None else f"{100 * level:g} % band",
        is_logarithmic=True,
    )


def _error_panels(
    fits: Sequence[Fit | FrequencyResponse], responses: Sequence[DrawnResponse]
) -> list[Panel]:
    """Return the panels of measured less fitted values, with the bands of the fits around zero.

    There are none if no fit has converged.
    """
    # Series of magnitude, and series of phase.
    points: tuple[list[Series], list[Series]] = ([], [])
    fitted = [item for item in fits if isinstance(item, Fit)]
    for number, fit in enumerate(fitted):
        for part in fit.responses if fit.converged else ():
            with np.errstate(all="ignore"):
                error = part.data.response / part.response
            same_data = [drawn for drawn in responses if drawn.checksum == part.data.checksum]
            measured = [drawn for drawn in same_data if drawn.is_measured]
            # Without them, the data belong to the diagram of another pair.
            if not measured:
                continue
            data = measured[0]
            # A curve that lies on another one is not drawn. The color is then that of any curve of
            # the fit.
            curves = [drawn for drawn in (*same_data, *responses) if drawn.fit is fit]
            if len(fitted) > 1 and curves:
                data = replace(data, color=curves[0].color)
            values = np.array([decibels_of(error), np.degrees(np.angle(error))])
            for k, ends in enumerate(error_bars(part.data, values)):
                series = data.series(part.data.omega, values[k], **ends)
                # Hollow points distinguish a second fit from the first if colors are equal.
                points[k].append(replace(series, is_hollow=number > 0))

    if not points[0]:
        return []
    panels = []
    for k, label in enumerate(("Error, dB", "Error, °")):
        bands = [_band(drawn, k) for drawn in responses if drawn.band is not None]
        # The points and their bars set the scale. Near a zero of the response a band is so wide
        # that the points would look like a line.
        values = []
        for series in points[k]:
            values += [y for y in (series.y, series.low, series.high) if y is not None]
        sizes = np.abs(np.hstack(values))
        most = 1.2 * max(sizes[np.isfinite(sizes)], default=0.0)
        limits = (-most, most) if most > 0 else None
        panels.append(Panel(label, [rule(), *bands, *points[k]], 0.5, limits=limits))
    return panels


def _caption(
    responses: Sequence[DrawnResponse], panels: Sequence[Panel], level: float | None
) -> Iterator[str]:
    """Yield the sentences below a diagram."""
    if level is not None and any(drawn.band is not None for drawn in responses):
        yield f"Shaded: {100 * level:g} % confidence band of the fitted response."
    if any(drawn.response.variance is not None for drawn in responses):
        yield BARS
    if panels[-1].label.startswith("Error"):
        yield "Errors are measured less fitted values."


def _band(drawn: DrawnResponse, k: int, curve: Array | None = None) -> Series:
    """Return the band of magnitude (k = 0) or phase around a `curve` (n,), by default zero."""
    around = drawn.band
    assert around is not None
    order = np.argsort(around.omega)
    omega = around.omega[order]
    unit = (DB_PER_NEPER, 180 / np.pi)[k]
    # Near a zero of the response, errors are larger than the response. The band is at most as wide
    # as error bars: 20 dB and half a turn to either side.
    most = (20.0, 180.0)[k]
    middle = unit * around.offset[k, order]
    half_width = np.minimum(unit * around.half_width[k, order], most)
    if curve is not None:
        middle += interpolated(omega, drawn.response.omega, curve)
    return band(drawn.label, omega, middle - half_width, middle + half_width, drawn.color)


def error_bars(data: FrequencyResponse, values: Array) -> list[dict[str, Any]]:
    """Return the ends of error bars, as arguments of `Series` for magnitude and for phase.

    `values` (2, n) are the magnitudes in dB and the phases in degrees.
    """
    if data.variance is None:
        return [{}, {}]
    relative = data.relative_error
    # At most 20 dB to either side: a bar down to a magnitude of zero would be infinite.
    down = decibels_of(1 + np.clip(-relative, -0.9, 9.0))
    up = decibels_of(1 + np.clip(relative, -0.9, 9.0))
    turn = np.degrees(np.minimum(relative, np.pi))
    return [
        {"low": values[0] + down, "high": values[0] + up},
        {"low": values[1] - turn, "high": values[1] + turn},
    ]


# --- phases


def phases(responses: Sequence[DrawnResponse]) -> Iterator[Array]:
    """Yield the phase (n,) of each response in degrees, so that those of one pair are close.

    Curves must come before measured responses. Measured points are not unwrapped along frequency,
    because one noisy point would shift all that follow. Each is shown within half a turn of its
    curve.
    """
    # Frequencies and phases of the first curve of a pair, and of the last curves by data and pair.
    first: dict[tuple[str, str], tuple[Array, Array]] = {}
    curves: dict[str | tuple[str, str], tuple[Array, Array]] = {}
    for drawn in responses:
        unwrapped = _unwrapped(drawn.response)
        phase = _moved(unwrapped, first.setdefault(drawn.pair, unwrapped))
        if drawn.is_measured:
            phase = curves.get(drawn.checksum) or curves.get(drawn.pair) or phase
        else:
            curves[drawn.checksum] = phase
            curves.setdefault(drawn.pair, phase)
        # Each value is moved to within half a turn of the curve.
        principal = np.degrees(np.angle(drawn.response.response))
        distance = interpolated(drawn.response.omega, *phase) - principal
        yield principal + 360 * np.round(distance / 360)


def _unwrapped(response: FrequencyResponse) -> tuple[Array, Array]:
    """Return the sorted omega (n,) and the phase (n,), unwrapped from within (-180°, 180°]."""
    response = response.by_frequency
    turn = 360 if response.degrees[0] <= -180 else 0
    return response.omega, response.degrees + turn


def _moved(phase: tuple[Array, Array], guide: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return a phase, moved by multiples of 360° next to a guide at their lowest common frequency.

    Both are frequencies (n,) and phases (n,) in degrees.
    """
    omega, degrees = phase
    lowest = max(omega[0], guide[0][0])
    distance = interpolated(lowest, *guide) - interpolated(lowest, *phase)
    return omega, degrees + 360 * np.round(distance / 360)
