"""The Nyquist diagram: points and curves in the complex plane, a panel for signals of each size."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from greybox.assessment.response_band import radius, require_level
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Interval
from greybox.data.files.numbers_in_text import number
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.reporting.plotting.figure import Figure, Panel, outlined
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.responses import (
    DrawnResponse,
    by_pair,
    drawn_responses,
    ratio,
    title,
)

CIRCLES = "Circles: confidence regions of the measured points."


@public
def nyquist(
    *fits: Fit | FrequencyResponse,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    level: float | None = 0.95,
    hz: bool = False,
) -> AxesArray:
    """Draw the Nyquist diagram: measured points, numbered by frequency, and fitted curves.

    A circle around each point of known variance is the region of the true response at this level.
    Shaded around a fitted curve are the confidence ellipses of its points (`Fit.response_band`).

    Every input-output pair has a panel. A curve that extends so far that the data would be a dot is
    cut off; the title says so.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        Data that several fits share are drawn once. A measured response is drawn as points, a
        response of a model (`Fit.response`, `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.
    axes : Axes or array-like of Axes, optional
        One for each input-output pair. By default a new figure is made.
    level : float or None
        Confidence level of the regions; None draws none.
    hz : bool
        Numbers in Hz instead of rad/s.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        One for each panel. In a notebook, ``gb.plotting.nyquist(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For items that cannot be drawn, or a wrong number of labels or axes.
    """
    if level is not None:
        require_level(level)
    figures = nyquist_figures(fits, labels, level)
    columns = columns_of(len(figures))
    return draw(figures, axes, columns=columns, size=(5.2, 5.0), title=title(fits), hz=hz)


def nyquist_figures(
    fits: Sequence[Fit | FrequencyResponse],
    labels: Sequence[str] = (),
    level: float | None = 0.95,
) -> list[Figure]:
    """Return one figure for each input-output pair."""
    pairs = by_pair(drawn_responses(fits, labels, level))
    return [_figure(responses, level) for responses in pairs]


def columns_of(count: int) -> int:
    """Return the number of columns of a grid of `count` panels that is about as wide as high."""
    return int(np.ceil(np.sqrt(count)))


def _figure(responses: Sequence[DrawnResponse], level: float | None) -> Figure:
    limits = _limits(responses)
    series = [
        outlined(outlines[np.isfinite(outlines).all(axis=1)], drawn.color)
        for drawn in responses
        if drawn.band is not None
        for outlines in [drawn.band.ellipses()]
    ]
    for drawn in responses:
        response = drawn.response
        if drawn.is_measured:
            labels = [number(omega, 3) for omega in np.sort(response.omega)]
            series.append(drawn.series(**in_plane(response, level), labels=labels))
        else:
            series.append(drawn.series(response.alpha, response.beta))

    name = ratio(responses)
    note = "Curves that reach farther are cut off." if limits else ""
    circles = any(row.low is not None for row in series)
    panel = Panel(
        f"Imaginary part of {name}",
        series,
        limits=limits and limits[1],
        title=note,
    )
    return Figure(
        "Nyquist diagram" if name == "P(jω)" else f"Nyquist diagram, {name}",
        f"Real part of {name}",
        [panel],
        caption=f"{note} {CIRCLES}".strip() if circles else note,
        bands="" if level is None else f"{100 * level:g} % band",
        is_plane=True,
        limits=limits and limits[0],
    )


def in_plane(response: FrequencyResponse, level: float | None) -> dict[str, Any]:
    """Return places and notes of measured points, in the order of their frequencies.

    With a variance and a level, they have circles: the regions of the true response.
    """
    response = response.by_frequency
    x, y = response.alpha, response.beta
    values = zip(response.response, response.omega, strict=True)
    look = {
        "x": x,
        "y": y,
        "notes": [f"{value:.4g} at {omega:.4g} rad/s" for value, omega in values],
    }
    if level is not None and response.variance is not None:
        dof = [np.inf] if response.dof is None else response.dof
        sizes = np.array([radius(level, value) for value in dof])
        radii = sizes * response.relative_error * np.abs(response.response)
        look |= {"low": y - radii, "high": y + radii}
    return look


def _limits(responses: Sequence[DrawnResponse]) -> tuple[Interval, Interval] | None:
    """Return both limits where curves would make the data a dot."""
    measured = [drawn.response.response for drawn in responses if drawn.is_measured]
    # The origin is always visible: stability is read from where the curve passes it.
    points = np.concatenate([np.zeros(1, dtype=complex), *measured])
    size = float(np.abs(points).max())
    reach = max(np.abs(drawn.response.response).max() for drawn in responses)
    # Otherwise the data would vanish beside the curves.
    if not 0 < 5.0 * size < reach:
        return None
    corners = np.array(
        [[np.min(part), np.max(part)] for part in (np.real(points), np.imag(points))]
    )
    x, y = (corners + size / 2 * np.array([-1, 1])).tolist()
    return (x[0], x[1]), (y[0], y[1])
