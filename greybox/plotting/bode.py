"""The Bode diagram: magnitude, phase, coherence, and the errors of fits."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.response_band import ResponseBand
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.plotting.response_series import (
    BAND_ALPHA,
    CROWD,
    ErrorSeries,
    ResponseSeries,
    error_series,
    interpolated,
    legend_entries,
    ratio,
    response_series,
    title,
)
from greybox.plotting.style import (
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    align_and_explain,
    finish,
    flat_axes,
    given_axes,
    label_horizontal,
    new_figure,
    stacked,
)

DB_PER_NEPER = 20 / np.log(10)
HEIGHTS = {
    "magnitude": 3.0,
    "phase": 3.0,
    "coherence": 1.6,
    "magnitude error": 1.3,
    "phase error": 1.3,
}  # inches

_Phase = tuple[Array, Array]  # sorted omega (n,) in rad/s, phase (n,) in degrees


def bode(
    *fits: Fit | FrequencyResponse,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    legend: bool = True,
    level: float | None = 0.95,
) -> AxesArray:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s, and below the errors.

    Curves are unwrapped along omega and every measured phase is moved by multiples of 360° next to
    its curve, unless the curve is far off: then the data are unwrapped by themselves. For each
    input-output pair the first curve begins within (-180°, 180°] and the others are moved next to
    it as a whole. Where the data have a variance, error bars show one standard deviation of one
    component, sqrt(variance / 2), in magnitude (20 dB at most) and phase. Shaded is the confidence
    band of a fit (`Fit.response_band`), around zero in the panels of errors, which are measured
    less fitted values in dB and degrees.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        All are drawn into one diagram; data that several fits share are drawn once. A measured
        response is drawn as points, one that was evaluated from a model (`Fit.response`,
        `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.
    axes : array-like of Axes, optional
        For magnitude and phase; a third for the coherence, where it is known; two more for the
        errors of fits. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and in the magnitude's panel of
        given axes.
    level : float or None
        Of the bands; None draws none.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        Magnitude, phase and, of a new figure, coherence where it is known, and the errors of
        magnitude and phase where there is a fit. The last line of a notebook cell is
        ``gb.plotting.bode(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, or for a wrong number of labels or axes.
    """
    series = response_series(fits, labels, level)
    errors = error_series(fits, series)
    panels = bode_panels(series, errors)
    if axes is not None:
        drawn = flat_axes(axes)
        panels = _panels_for(panels, drawn.size)
        drawn = given_axes(drawn, panels, "this Bode diagram")
    else:
        figure = new_figure(6.4, bode_height(panels))
        drawn = bode_axes(figure, panels)

    draw_bode(drawn, panels, series, errors, title(fits))

    align_and_explain(drawn, legend_entries(series), given=axes is not None, legend=legend)
    return drawn


def bode_panels(series: Sequence[ResponseSeries], errors: Sequence[ErrorSeries]) -> list[str]:
    """Return the names of the panels, from top to bottom."""
    has_coherence = any(one.response.coherence is not None for one in series)
    return [
        "magnitude",
        "phase",
        *(["coherence"] if has_coherence else []),
        *(["magnitude error", "phase error"] if errors else []),
    ]


def _panels_for(panels: list[str], count: int) -> list[str]:
    """Return as many of the panels as there are axes, if that can be: the errors come in pairs."""
    known = [panel for panel in panels if "error" not in panel]
    choices = [panels, known, [*known[:2], *panels[len(known) :]], known[:2]]
    return next((choice for choice in choices if len(choice) == count), known[:2])


def bode_height(panels: Sequence[str]) -> float:
    """Return the height in inches that a figure of these panels needs."""
    return 0.8 + 0.85 * sum(HEIGHTS[name] for name in panels)


def bode_axes(figure: Figure | SubFigure, panels: Sequence[str]) -> AxesArray:
    """Make the axes in a figure or a part of one."""
    return stacked(figure, [HEIGHTS[name] for name in panels])


def draw_bode(
    drawn: AxesArray,
    panels: Sequence[str],
    series: Sequence[ResponseSeries],
    errors: Sequence[ErrorSeries],
    text: str,
) -> None:
    """Draw the series and the errors into these panels, with this title."""
    place = dict(zip(panels, drawn, strict=True))
    for one, phase in zip(series, phases(series), strict=True):
        _draw_series(place, one, phase)
    if "magnitude error" in place:
        _draw_errors(place["magnitude error"], place["phase error"], errors, series)

    labels = {
        "magnitude": f"Magnitude of {ratio(series)}, dB",
        "phase": f"Phase of {ratio(series)}, °",
        "coherence": "Coherence γ²",
        "magnitude error": "Error, dB",
        "phase error": "Error, °",
    }
    for name, ax in place.items():
        finish(ax, labels[name])
    drawn[0].set_title(text, fontsize=TITLE_SIZE)

    span = float(np.ptp(drawn[1].get_ylim()))
    step = next(
        (step for step in (15, 30, 45, 90, 180, 360) if span <= 7 * step),
        720 * np.ceil(span / 5040),
    )
    drawn[1].yaxis.set_major_locator(
        MultipleLocator(step) if span > 60 else MaxNLocator(7, steps=[1, 2, 5, 10])
    )

    if "coherence" in place:
        place["coherence"].set_ylim(0, 1.05)
    _frequency_axes(drawn)


def _draw_series(place: Mapping[str, Axes], one: ResponseSeries, phase: Array) -> None:
    """Draw magnitude, `phase` (n,) in degrees, and what is known of coherence, variance and band."""
    response = one.response
    size = np.abs(response.response)
    decibel = 20 * np.log10(np.where(size > 0, size, np.nan))
    place["magnitude"].plot(response.omega, decibel, **one.look)
    place["phase"].plot(response.omega, phase, **one.look)

    if response.coherence is not None and "coherence" in place:
        place["coherence"].plot(response.omega, response.coherence, **one.look)

    if response.variance is not None:
        down, up, turn = error_bars(response)
        look = _bar_look(response, one.color)
        place["magnitude"].errorbar(response.omega, decibel, [down, up], **look)
        place["phase"].errorbar(response.omega, phase, turn, **look)

    if one.band is not None:
        omega, low, high = band_limits(one.band)
        curve = (
            interpolated(omega, response.omega, decibel),
            interpolated(omega, response.omega, phase),
        )
        for ax, of, down, up in zip(
            (place["magnitude"], place["phase"]), curve, low, high, strict=True
        ):
            ax.fill_between(omega, of + down, of + up, **_band_look(one.color))


def _draw_errors(
    magnitude: Axes, phase: Axes, errors: Sequence[ErrorSeries], series: Sequence[ResponseSeries]
) -> None:
    """Draw measured less fitted values, and the bands of the fits around zero."""
    for one in series:
        if one.band is not None:
            omega, low, high = band_limits(one.band)
            for ax, down, up in zip((magnitude, phase), low, high, strict=True):
                ax.fill_between(omega, down, up, **_band_look(one.color))

    for error in errors:
        omega = error.data.omega
        with np.errstate(divide="ignore"):
            decibel = 20 * np.log10(np.abs(error.ratio))
        decibel = np.where(np.isfinite(decibel), decibel, np.nan)  # of a measured zero
        turn = np.degrees(np.angle(error.ratio))
        if error.data.variance is not None:
            down, up, half_turn = error_bars(error.data)
            look = _bar_look(error.data, error.look["color"])
            magnitude.errorbar(omega, decibel, [down, up], **look)
            phase.errorbar(omega, turn, half_turn, **look)
        magnitude.plot(omega, decibel, **error.look)
        phase.plot(omega, turn, **error.look)

    for ax in (magnitude, phase):
        ax.axhline(0, color="0.6", linewidth=0.8, zorder=1)
        ax.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))


def band_limits(
    band: ResponseBand,
) -> tuple[Array, Array, Array]:
    """Return rising frequencies (n,), and the limits (2, n) from the response on, in dB and degrees, along them."""
    order = np.argsort(band.omega)
    factors = np.array([[DB_PER_NEPER], [180 / np.pi]])
    low, high = (factors * (band.offset + half) for half in (-band.half_width, band.half_width))
    return band.omega[order], low[:, order], high[:, order]


def _band_look(color: str) -> dict[str, Any]:
    return {"color": color, "alpha": BAND_ALPHA, "linewidth": 0, "zorder": 1.1}


def error_bars(
    data: FrequencyResponse,
) -> tuple[Array, Array, Array]:
    """Return one standard deviation of one component, (n,): down and up in dB, and in degrees."""
    assert data.variance is not None
    relative = np.sqrt(data.variance / 2) / np.maximum(np.abs(data.response), 1e-300)
    # At most 20 dB to either side: below, the logarithm has no end.
    down = -20 * np.log10(1 - np.minimum(relative, 0.9))
    up = 20 * np.log10(1 + np.minimum(relative, 9.0))
    return down, up, np.degrees(np.minimum(relative, np.pi))


def _bar_look(data: FrequencyResponse, color: str) -> dict[str, Any]:
    few = len(data) < CROWD
    look = {
        "fmt": "none",
        "ecolor": color,
        "zorder": 2 if few else 1.2,
        "capsize": 2.0 if few else 0.0,
    }
    return look | {"elinewidth": 1.0, "alpha": 0.7 if few else 0.3}


def _frequency_axes(drawn: AxesArray) -> None:
    """Make the horizontal axes logarithmic, with 1, 2 and 5 of every decade written out where there is room."""
    low = drawn[1].dataLim.minposx  # of all that is drawn, what a user drew before included
    high = drawn[1].dataLim.xmax
    for ax in drawn:
        ax.set(xscale="log", xlim=(low / 1.15, high * 1.15))
        subs = (1, 2, 5) if high / low < 1e3 else (1,)
        few = MaxNLocator(6, steps=[1, 2, 2.5, 5, 10])
        ax.xaxis.set_major_locator(few if high / low < 5 else LogLocator(subs=subs))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
    label_horizontal(drawn, "ω, rad/s")


def phases(series: Sequence[ResponseSeries]) -> list[Array]:
    """Return the phase (n,) of each series in degrees, within each input-output pair next to each other."""
    first: dict[tuple[str, str], _Phase] = {}
    guides: dict[ResponseSeries, _Phase] = {}
    for one in series:  # curves come first
        alone = _unwrapped(one.response)
        near = [curve for curve in guides if curve.pair == one.pair and not curve.measured]
        if one.measured and near:
            beside = guides[min(near, key=lambda curve: _distance(one, curve))]
            guides[one] = beside if _is_guide(beside, one.response) else _moved(alone, beside)
        else:
            guides[one] = _moved(alone, first.setdefault(one.pair, alone))
    return [_wrapped_to(guides[one], one.response) for one in series]


def _unwrapped(response: FrequencyResponse) -> _Phase:
    """Return the sorted omega (n,) and the phase (n,) in degrees, unwrapped along it from within (-180°, 180°]."""
    order = np.argsort(response.omega)
    phase = np.degrees(np.unwrap(np.angle(response.response[order])))
    return response.omega[order], phase + 360 * (phase[0] <= -180)


def _moved(alone: _Phase, beside: _Phase) -> _Phase:
    """Move a phase as a whole by multiples of 360° next to another, over the frequencies that both have."""
    low = max(alone[0][0], beside[0][0])
    common = np.geomspace(
        low, max(low, min(alone[0][-1], beside[0][-1])), 100
    )  # dense spots of a grid count no more
    apart = np.mean(interpolated(common, *beside) - interpolated(common, *alone))
    return alone[0], alone[1] + 360 * np.round(apart / 360)


def _wrapped_to(guide: _Phase, response: FrequencyResponse) -> Array:
    """Return the phase (n,) in degrees, each within half a turn of the guide."""
    phase = np.degrees(np.angle(response.response))
    return phase + 360 * np.round((interpolated(response.omega, *guide) - phase) / 360)


def _is_guide(guide: _Phase, response: FrequencyResponse) -> bool:
    """Return whether most points lie within a quarter of a turn of the guide."""
    return bool(
        np.median(np.abs(_wrapped_to(guide, response) - interpolated(response.omega, *guide))) <= 90
    )


def _distance(one: ResponseSeries, curve: ResponseSeries) -> float:
    """Return how far points lie from a curve, relative and on average; 0 for the one that was fitted to them."""
    if one.checksum == curve.checksum:
        return 0.0
    reference = interpolated(one.response.omega, curve.response.omega, curve.response.response)
    return float(
        np.mean(np.abs(one.response.response - reference) / np.maximum(np.abs(reference), 1e-300))
    )
