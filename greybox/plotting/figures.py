"""Figures of a fit: Nyquist diagram, Bode diagram, and the costs that the starts reached."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, MultipleLocator, NullFormatter
from numpy.typing import NDArray

from greybox.data.frequency_response import FrequencyResponse
from greybox.data.text_table import counted
from greybox.estimate.result import Fit
from greybox.plotting.nyquist import draw_nyquist, grid, number_points, panels
from greybox.plotting.style import COLORS, CROWD, MARKERS, Series, finish, legend, legend_below, page, plain, ratio
from greybox.plotting.time_history import WIDTH, draw_history, history_height

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too pale for lines.
DARK, GRAYS = "#222222", ("#222222", "#777777", "#AAAAAA")
STYLES = ("-", "--", "-.", ":")
SAME_CURVE = 1e-2  # relative distance below which two curves of one fit are the same line on paper
LOG_SPAN = 30.0  # costs that span more than this are drawn on a log scale

_Phase = tuple[NDArray[np.float64], NDArray[np.float64]]  # sorted omega (n,) in rad/s, phase (n,) in degrees


def plot_nyquist(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Nyquist diagram: measured points, numbered by their frequency in rad/s, and the fitted curves.

    Input-output pairs whose magnitudes differ by more than a factor of 5 have one panel each. A curve that leaves so
    far that the data would be a dot is cut off, and the title says so.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        All are drawn into one diagram; data that several fits share are drawn once. A measured response is drawn as
        points, one that was evaluated from a model (`Fit.response`, `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.

    The figure is not known to pyplot: show it as the last line of a notebook cell or save it with ``savefig``.
    """
    series = _collect(fits, labels)
    rows, columns = grid(len(panels(series)))
    figure = page(1.8 + 4.6 * columns, 1.2 + 4.6 * rows)
    number_points(figure, draw_nyquist(figure, series, _title(fits)), series)
    return figure


def plot_bode(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s.

    Curves are unwrapped along omega and every measured phase is moved by multiples of 360° next to its curve, unless
    the curve is far off: then the data are unwrapped by themselves. For each input-output pair the first curve begins
    within (-180°, 180°] and the others are moved next to it as a whole. Where the data have a variance, error bars show
    one standard deviation of one component, sqrt(variance / 2), in magnitude (20 dB at most) and phase. Where they have
    a coherence, a third diagram shows it.

    The arguments are those of `plot_nyquist`. The figure's axes are magnitude, phase and, where known, coherence.
    """
    series = _collect(fits, labels)
    figure = page(6.4, 7.0 if any(one.response.coherence is not None for one in series) else 5.8)
    _draw_bode(figure, series, _title(fits))
    return figure


def plot_starts(fit: Fit) -> Figure:
    """Draw the final cost of every run, sorted and colored by the minimum reached.

    Failed runs are crosses at the right; their cost means nothing and is not shown. The scale is logarithmic where the
    costs span decades.
    """
    figure = page(6.4, 4.0)
    _draw_starts(figure, fit)
    return figure


def plot(fit: Fit) -> Figure:
    """Draw the Nyquist diagram, the starts and the Bode diagram of a fit into one figure.

    Where its data are records, their time histories and the starts; where they are both, the responses beside them.
    """
    return _plot_records(fit) if fit.records else _plot_responses(fit)


def _plot_records(fit: Fit) -> Figure:
    """Draw the time history of every record and the starts below one another, and Bode diagrams to their right."""
    heights = [history_height((fit,), k) for k in range(len(fit.records))]
    wide = 6.2 if fit.responses else 0.0
    figure = page(WIDTH + wide, sum(heights) + 3.4 + 0.4)
    figure.suptitle(_title((fit,)), fontsize=13)
    left, *right = figure.subfigures(1, 2 if wide else 1, width_ratios=(WIDTH, wide) if wide else (1,), squeeze=False)[
        0
    ]
    rows = left.subfigures(len(heights) + 1, 1, height_ratios=(*heights, 3.4), squeeze=False)[:, 0]
    for k, part in enumerate(fit.records):
        draw_history(rows[k], (fit,), k)
        rows[k].axes[0].set_title(plain(part.name) if len(fit.records) > 1 else "", fontsize=12)
    _draw_starts(rows[-1], fit)
    for part in right:
        _draw_bode(part, _collect((fit,), ()), "Bode diagram")
    return figure


def _plot_responses(fit: Fit) -> Figure:
    series = _collect((fit,), ())
    rows, columns = grid(len(panels(series)))
    width, height = 2.8 + 3.4 * columns, 1.8 + 3.4 * rows  # of the Nyquist diagram, inches
    figure = page(width + 6.2, height + 3.4)
    figure.suptitle(_title((fit,)), fontsize=13)
    left, right = figure.subfigures(1, 2, wspace=0.03, width_ratios=(width, 6.2), squeeze=False)[0]
    top, bottom = left.subfigures(2, 1, height_ratios=(height, 3.4), squeeze=False)[:, 0]
    drawn = draw_nyquist(top, series, "Nyquist diagram")
    _draw_bode(right, series, "Bode diagram")
    _draw_starts(bottom, fit)
    number_points(figure, drawn, series)
    return figure


def _collect(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> list[Series]:
    """Sort what is given into curves and then points; data that come twice count once."""
    _check(items, labels)
    names = [plain(label) for label in labels or _labels(items)]
    measured = {r.checksum: (r, label) for k, name in zip(items, names, strict=True) for r, label in _data(k, name)}
    places = [*measured]
    colors = COLORS if len(places) > 1 else (DARK,)
    curves = [_distinct(_curves(item)) for item in items]
    shared = any(
        isinstance(k, Fit) and 0 < len(found) < len(k.responses) for k, found in zip(items, curves, strict=True)
    )
    pairs = _pairs(items)
    series = []
    for i, found in enumerate(curves):
        for checksum, curve in found:
            palette, k = (COLORS if len(places) < 2 else GRAYS), i
            if len(places) > 1 and checksum in places and not shared:  # like its data
                palette, k = COLORS, places.index(checksum)
            color = palette[k % len(palette)]
            series.append(Series(curve, names[i], color, STYLES[i % len(STYLES)], checksum, _pair(curve, pairs)))
    for k, (checksum, (data, label)) in enumerate(measured.items()):
        look = colors[k % len(colors)], MARKERS[k % len(MARKERS)]
        series.append(Series(data, label, *look, checksum, pairs.get(checksum) or _pair(data, pairs)))
    return series


def _pairs(items: Sequence[Fit | FrequencyResponse]) -> dict[str, tuple[str, str]]:
    """Return the names of input and output by checksum; the names that data leave out are those of their curve."""
    known = {}
    for part in [part for item in items if isinstance(item, Fit) for part in item.responses]:
        stated = part.curve or part.data
        known[part.data.checksum] = (stated.input, stated.output)
    for item in [item for item in items if isinstance(item, FrequencyResponse)]:
        known.setdefault(item.checksum, (item.input, item.output))
    return {checksum: pair for checksum, pair in known.items() if all(pair)}


def _pair(response: FrequencyResponse, known: Mapping[str, tuple[str, str]]) -> tuple[str, str]:
    """Return the names of input and output; where one is left out, those of the only known pair that fits."""
    stated = response.input, response.output
    fitting = {pair for pair in known.values() if all(a in ("", b) for a, b in zip(stated, pair, strict=True))}
    return fitting.pop() if len(fitting) == 1 else stated


def _check(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> None:
    wrong = [item for item in items if not isinstance(item, Fit | FrequencyResponse)]
    if wrong:
        raise TypeError(f"cannot draw {wrong[0]!r:.80}: give a Fit or a FrequencyResponse.")
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or FrequencyResponse.")
    if all(isinstance(item, Fit) and not item.responses for item in items):
        raise ValueError("there is no frequency response to draw: gb.plotting.time_history draws fitted records.")
    if labels and len(labels) != len(items):
        raise ValueError(f"there are {len(labels)} labels for {len(items)} fits: give one for each.")


def _data(item: Fit | FrequencyResponse, name: str) -> list[tuple[FrequencyResponse, str]]:
    """Return the measured responses of an item with their labels."""
    if isinstance(item, Fit):
        return [(part.data, plain(part.name)) for part in item.responses]
    return [] if item.source == "model" else [(item, name)]


def _curves(item: Fit | FrequencyResponse) -> list[tuple[str, FrequencyResponse]]:
    """Return the curves of an item, along omega, each with the checksum of the data that it was fitted to."""
    if isinstance(item, Fit):
        return [(part.data.checksum, _sorted(part.curve)) for part in item.responses if part.curve is not None]
    return [("", _sorted(item))] if item.source == "model" else []


def _sorted(curve: FrequencyResponse) -> FrequencyResponse:
    """Return a curve in the order of its frequencies."""
    order = np.argsort(curve.omega)
    return replace(curve, omega=curve.omega[order], response=curve.response[order])


def _distinct(curves: list[tuple[str, FrequencyResponse]]) -> list[tuple[str, FrequencyResponse]]:
    """Leave out the curves that lie on a longer one, as those of several rotors with one model do."""
    kept: list[tuple[str, FrequencyResponse]] = []
    for checksum, curve in sorted(curves, key=lambda item: -item[1].omega.max() / item[1].omega.min()):
        if not any(_lies_on(curve, other) for _, other in kept):
            kept.append((checksum, curve))
    return kept


def _lies_on(curve: FrequencyResponse, other: FrequencyResponse) -> bool:
    if (curve.input, curve.output) != (other.input, other.output):
        return False
    inside = (curve.omega >= 0.999 * other.omega.min()) & (curve.omega <= 1.001 * other.omega.max())
    there = _interpolated(curve.omega, other.omega, other.response)
    return bool(np.all(inside & (np.abs(curve.response - there) <= SAME_CURVE * np.abs(there))))


def _interpolated(omega: NDArray, known: NDArray, values: NDArray) -> NDArray:
    """Interpolate `values` (n,) at the sorted `known` (n,) over the logarithm of the frequency, to `omega` (m,)."""
    return np.interp(np.log(omega), np.log(known), values)


def _labels(items: Sequence[Fit | FrequencyResponse]) -> list[str]:
    """Name the items by the model or, if that does not tell them apart, by the problem; else number them."""
    models = [_joined(part.label for part in k.parts) if isinstance(k, Fit) else k.name for k in items]
    for names in (models, [item.name for item in items]):
        said = [f"fit of {n}" if isinstance(k, Fit) else n or "data" for k, n in zip(items, names, strict=True)]
        if len(set(said)) == len(said):
            return said
    return [f"{'fit' if isinstance(item, Fit) else item.name or 'data'} {k}" for k, item in enumerate(items, 1)]


def _title(items: Sequence[Fit | FrequencyResponse]) -> str:
    """Return the names of the fits, else of the data, and which fits have no answer; 64 characters at most."""
    fits = [item for item in items if isinstance(item, Fit)]
    names = [fit.name if fit.converged else f"{fit.name}: no start converged" for fit in fits]
    text = _joined(names or [item.name for item in items if item.name])
    return plain(text if len(text) <= 64 else text[:63].rstrip() + "…")


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _draw_bode(figure: Figure | SubFigure, series: Sequence[Series], title: str) -> None:
    coherent = any(one.response.coherence is not None for one in series)
    ratios = (3, 3, 1.6) if coherent else (3, 3)
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for one, phase in zip(series, _phases(series), strict=True):
        _draw_bode_series(axes, one, phase)
    labels = (f"Magnitude of {ratio(series)}, dB", f"Phase of {ratio(series)}, °", "Coherence γ²")
    for ax, label in zip(axes, labels, strict=False):
        finish(ax, "", label)
    span = float(np.ptp(axes[1].get_ylim()))
    step = next((step for step in (15, 30, 45, 90, 180, 360) if span <= 7 * step), 720 * np.ceil(span / 5040))
    axes[1].yaxis.set_major_locator(MultipleLocator(step) if span > 60 else MaxNLocator(7, steps=[1, 2, 5, 10]))
    if coherent:
        axes[2].set_ylim(0, 1.05)
    _frequency_axis(axes[-1], np.concatenate([one.response.omega for one in series]))
    axes[0].set_title(title, fontsize=12)
    figure.align_ylabels(axes)
    legend(figure, series)


def _draw_bode_series(axes: Sequence[Axes], one: Series, phase: NDArray[np.float64]) -> None:
    """Draw magnitude, `phase` (n,) in degrees, and what is known of coherence and variance."""
    response, size = one.response, np.abs(one.response.response)
    decibel = 20 * np.log10(np.where(size > 0, size, np.nan))
    axes[0].plot(response.omega, decibel, **one.look)
    axes[1].plot(response.omega, phase, **one.look)
    if response.coherence is not None:
        axes[2].plot(response.omega, response.coherence, **one.look)
    if response.variance is not None:
        relative = np.sqrt(response.variance / 2) / np.maximum(size, 1e-300)
        down, up = -20 * np.log10(1 - np.minimum(relative, 0.9)), 20 * np.log10(1 + np.minimum(relative, 9.0))
        few = len(response) < CROWD
        look = {"fmt": "none", "ecolor": one.color, "zorder": 2 if few else 1.2, "capsize": 2.0 if few else 0.0}
        look |= {"elinewidth": 1.0, "alpha": 0.7 if few else 0.3}
        axes[0].errorbar(response.omega, decibel, [down, up], **look)
        axes[1].errorbar(response.omega, phase, np.degrees(np.minimum(relative, np.pi)), **look)


def _phases(series: Sequence[Series]) -> list[NDArray[np.float64]]:
    """Return the phase (n,) of each series in degrees, within each input-output pair next to each other."""
    first: dict[tuple[str, str], _Phase] = {}
    guides: dict[Series, _Phase] = {}
    for one in series:  # curves come first
        own = _unwrapped(one.response)
        near = [curve for curve in guides if curve.pair == one.pair and not curve.measured]
        if one.measured and near:
            beside = guides[min(near, key=lambda curve: _distance(one, curve))]
            guides[one] = beside if _is_guide(beside, one.response) else _moved(own, beside)
        else:
            guides[one] = _moved(own, first.setdefault(one.pair, own))
    return [_wrapped_to(guides[one], one.response) for one in series]


def _unwrapped(response: FrequencyResponse) -> _Phase:
    """Return the sorted omega (n,) and the phase (n,) in degrees, unwrapped along it from within (-180°, 180°]."""
    order = np.argsort(response.omega)
    phase = np.degrees(np.unwrap(np.angle(response.response[order])))
    return response.omega[order], phase + 360 * (phase[0] <= -180)


def _moved(own: _Phase, beside: _Phase) -> _Phase:
    """Move a phase as a whole by multiples of 360° next to another, over the frequencies that both have."""
    low = max(own[0][0], beside[0][0])
    common = np.geomspace(low, max(low, min(own[0][-1], beside[0][-1])), 100)  # dense spots of a grid count no more
    return own[0], own[1] + 360 * np.round(np.mean(_interpolated(common, *beside) - _interpolated(common, *own)) / 360)


def _wrapped_to(guide: _Phase, response: FrequencyResponse) -> NDArray[np.float64]:
    """Return the phase (n,) in degrees, each within half a turn of the guide."""
    phase = np.degrees(np.angle(response.response))
    return phase + 360 * np.round((_interpolated(response.omega, *guide) - phase) / 360)


def _is_guide(guide: _Phase, response: FrequencyResponse) -> bool:
    """Return whether most points lie within a quarter of a turn of the guide."""
    return bool(np.median(np.abs(_wrapped_to(guide, response) - _interpolated(response.omega, *guide))) <= 90)


def _distance(one: Series, curve: Series) -> float:
    """Return how far points lie from a curve, relative and on average; 0 for the one that was fitted to them."""
    if one.checksum == curve.checksum:
        return 0.0
    there = _interpolated(one.response.omega, curve.response.omega, curve.response.response)
    return float(np.mean(np.abs(one.response.response - there) / np.maximum(np.abs(there), 1e-300)))


def _frequency_axis(axes: Axes, omega: NDArray[np.float64]) -> None:
    """Make the horizontal axis logarithmic, with 1, 2 and 5 of every decade written out where there is room."""
    low, high = omega.min(), omega.max()
    axes.set(xlabel="ω, rad/s", xscale="log", xlim=(low / 1.15, high * 1.15))
    few = MaxNLocator(6, steps=[1, 2, 2.5, 5, 10])
    axes.xaxis.set_major_locator(few if high / low < 5 else LogLocator(subs=(1, 2, 5) if high / low < 1e3 else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _draw_starts(figure: Figure | SubFigure, fit: Fit) -> None:
    axes = figure.subplots()
    costs = sorted((run.cost, run.index) for run in fit.runs if run.converged)
    _draw_minima(axes, fit, costs)
    _draw_failed(axes, len(costs), len(fit.runs) - len(costs))
    _scale_costs(axes, [cost for cost, _ in costs])
    finish(axes, "Runs, sorted by cost", "Cost")
    axes.set_xlim(0, len(fit.runs) + 1)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    starts = counted(len(fit.runs), "start")
    said = f"{fit.agreeing} of {starts} {'agrees' if fit.agreeing == 1 else 'agree'} on the best minimum"
    axes.set_title(said if fit.converged else f"none of {starts} converged", fontsize=12)
    legend_below(figure, {str(line.get_label()): (line,) for line in axes.get_lines()})


def _draw_minima(axes: Axes, fit: Fit, costs: Sequence[tuple[float, int]]) -> None:
    """Draw the sorted `costs` and indices of runs, one color a minimum; all beyond the colors are gray."""
    places = {index: (k, cost) for k, (cost, index) in enumerate(costs, 1)}
    named, others = fit.minima[: len(COLORS)], fit.minima[len(COLORS) :]
    groups = [(f"minimum {k}: {len(m.runs)} × cost {m.cost:.5g}", m.runs) for k, m in enumerate(named, 1)]
    rest = tuple(index for minimum in others for index in minimum.runs)
    runs, minima = "run" if len(rest) == 1 else "runs", "minimum" if len(others) == 1 else "minima"
    groups += [(f"{len(rest)} {runs} in {len(others)} further {minima}", rest)] if rest else []
    for (label, members), color, marker in zip(groups, (*COLORS, GRAYS[1]), MARKERS, strict=False):
        x, y = zip(*(places[index] for index in members), strict=True)
        axes.plot(x, y, color=color, marker=marker, markersize=4.5, linestyle="none", label=label)


def _draw_failed(axes: Axes, before: int, count: int) -> None:
    """Draw `count` crosses to the right of the `before` converged runs, at a height that is no cost."""
    if count:
        x, y = np.arange(before + 1, before + count + 1), np.full(count, 0.93)
        look = {"color": DARK, "marker": "x", "markersize": 5, "transform": axes.get_xaxis_transform()}
        axes.axvspan(before + 0.5, before + count + 0.5, color="0.95", zorder=0)
        axes.plot(x, y, linestyle="none", label=f"{count} × failed", **look)


def _scale_costs(axes: Axes, costs: Sequence[float]) -> None:
    """Scale the axis to the sorted costs, so that neither rounding nor a large range hides the minima."""
    if not costs:
        axes.set_yticks([])
    elif costs[0] > 0 and costs[-1] > LOG_SPAN * costs[0]:
        axes.set_yscale("log")
    else:
        room = 0.1 * max(costs[-1] - costs[0], abs(costs[0]), 1e-12)
        axes.set_ylim(costs[0] - room, costs[-1] + 2 * room)
