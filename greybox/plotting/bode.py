"""The Bode diagram: magnitude, phase and coherence."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.estimate.result import Fit
from greybox.plotting.response_series import (
    CROWD,
    ResponseSeries,
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
    finish,
    flat_axes,
    given_axes,
    label_horizontal,
    legend_below,
    legend_inside,
    new_figure,
)

PANELS = ("magnitude", "phase", "coherence")

_Phase = tuple[NDArray[np.float64], NDArray[np.float64]]  # sorted omega (n,) in rad/s, phase (n,) in degrees


def bode(
    *fits: Fit | FrequencyResponse, labels: Sequence[str] = (), axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s.

    Curves are unwrapped along omega and every measured phase is moved by multiples of 360° next to its curve, unless
    the curve is far off: then the data are unwrapped by themselves. For each input-output pair the first curve begins
    within (-180°, 180°] and the others are moved next to it as a whole. Where the data have a variance, error bars show
    one standard deviation of one component, sqrt(variance / 2), in magnitude (20 dB at most) and phase.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        All are drawn into one diagram; data that several fits share are drawn once. A measured response is drawn as
        points, one that was evaluated from a model (`Fit.response`, `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.
    axes : array-like of Axes, optional
        Two, for magnitude and phase; a third shows the coherence. Without it a new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and in the magnitude's panel of given axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (2,) or (3,)
        Magnitude, phase and, of a new figure where it is known, coherence. The last line of a notebook cell is
        ``gb.plotting.bode(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, or for a wrong number of labels or axes.
    """
    series = response_series(fits, labels)
    if axes is not None:
        drawn = flat_axes(axes)
        drawn = given_axes(drawn, PANELS[: 3 if drawn.size == 3 and has_coherence(series) else 2], "this Bode diagram")
    else:
        figure = new_figure(6.4, 7.0 if has_coherence(series) else 5.8)
        drawn = bode_axes(figure, series)

    draw_bode(drawn, series, title(fits))

    if axes is None:
        drawn[0].figure.align_ylabels(drawn)
        if legend:
            legend_below(drawn[0].figure, legend_entries(series))
    elif legend:
        legend_inside(drawn[0], legend_entries(series))
    return drawn


def has_coherence(series: Sequence[ResponseSeries]) -> bool:
    """Return whether there is a coherence to draw."""
    return any(one.response.coherence is not None for one in series)


def bode_axes(figure: Figure | SubFigure, series: Sequence[ResponseSeries]) -> AxesArray:
    """Make the axes in a figure or a part of one, with those of a coherence where it is known."""
    heights = (3, 3, 1.6) if has_coherence(series) else (3, 3)
    return figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)


def draw_bode(drawn: AxesArray, series: Sequence[ResponseSeries], text: str) -> None:
    """Draw the series into two or three panels, with this title."""
    for one, phase in zip(series, _phases(series), strict=True):
        _draw_series(drawn, one, phase)

    labels = (f"Magnitude of {ratio(series)}, dB", f"Phase of {ratio(series)}, °", "Coherence γ²")
    for ax, label in zip(drawn, labels, strict=False):
        finish(ax, label)
    drawn[0].set_title(text, fontsize=TITLE_SIZE)

    span = float(np.ptp(drawn[1].get_ylim()))
    step = next((step for step in (15, 30, 45, 90, 180, 360) if span <= 7 * step), 720 * np.ceil(span / 5040))
    drawn[1].yaxis.set_major_locator(MultipleLocator(step) if span > 60 else MaxNLocator(7, steps=[1, 2, 5, 10]))

    if len(drawn) > 2:
        drawn[2].set_ylim(0, 1.05)
    _frequency_axes(drawn)


def _draw_series(drawn: AxesArray, one: ResponseSeries, phase: NDArray[np.float64]) -> None:
    """Draw magnitude, `phase` (n,) in degrees, and what is known of coherence and variance."""
    response = one.response
    size = np.abs(response.response)
    decibel = 20 * np.log10(np.where(size > 0, size, np.nan))
    drawn[0].plot(response.omega, decibel, **one.look)
    drawn[1].plot(response.omega, phase, **one.look)

    if response.coherence is not None and len(drawn) > 2:
        drawn[2].plot(response.omega, response.coherence, **one.look)

    if response.variance is not None:
        relative = np.sqrt(response.variance / 2) / np.maximum(size, 1e-300)
        # At most 20 dB to either side: below, the logarithm has no end.
        down = -20 * np.log10(1 - np.minimum(relative, 0.9))
        up = 20 * np.log10(1 + np.minimum(relative, 9.0))
        few = len(response) < CROWD
        look = {"fmt": "none", "ecolor": one.color, "zorder": 2 if few else 1.2, "capsize": 2.0 if few else 0.0}
        look |= {"elinewidth": 1.0, "alpha": 0.7 if few else 0.3}
        drawn[0].errorbar(response.omega, decibel, [down, up], **look)
        drawn[1].errorbar(response.omega, phase, np.degrees(np.minimum(relative, np.pi)), **look)


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


def _phases(series: Sequence[ResponseSeries]) -> list[NDArray[np.float64]]:
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
    common = np.geomspace(low, max(low, min(alone[0][-1], beside[0][-1])), 100)  # dense spots of a grid count no more
    apart = np.mean(interpolated(common, *beside) - interpolated(common, *alone))
    return alone[0], alone[1] + 360 * np.round(apart / 360)


def _wrapped_to(guide: _Phase, response: FrequencyResponse) -> NDArray[np.float64]:
    """Return the phase (n,) in degrees, each within half a turn of the guide."""
    phase = np.degrees(np.angle(response.response))
    return phase + 360 * np.round((interpolated(response.omega, *guide) - phase) / 360)


def _is_guide(guide: _Phase, response: FrequencyResponse) -> bool:
    """Return whether most points lie within a quarter of a turn of the guide."""
    return bool(np.median(np.abs(_wrapped_to(guide, response) - interpolated(response.omega, *guide))) <= 90)


def _distance(one: ResponseSeries, curve: ResponseSeries) -> float:
    """Return how far points lie from a curve, relative and on average; 0 for the one that was fitted to them."""
    if one.checksum == curve.checksum:
        return 0.0
    reference = interpolated(one.response.omega, curve.response.omega, curve.response.response)
    return float(np.mean(np.abs(one.response.response - reference) / np.maximum(np.abs(reference), 1e-300)))
