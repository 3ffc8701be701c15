"""Figures of a fit: Nyquist diagram, Bode diagram, and the costs that the starts reached."""

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from greybox.answer import Fit
from greybox.frequency_response import FrequencyResponse
from greybox.page import MARKER_SIZE, Room, plain, symbol

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DARK, GRAYS = "#222222", ("#222222", "#777777", "#AAAAAA")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
STYLES = ("-", "--", "-.", ":")
SAME_CURVE = 1e-2  # relative distance below which two curves of one fit are the same line on paper
MANY = 12  # points of one data set that are all annotated
LOG_SPAN = 30.0  # costs that span more than this are drawn on a log scale


def plot_nyquist(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Nyquist diagram: measured points, numbered by their frequency in rad/s, and the fitted curves.

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
    figure = _page(6.4, 5.8)
    axes = _draw_nyquist(figure, series, _title(fits))
    _number_points(figure, axes, series)
    return figure


def plot_bode(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s.

    Curves are unwrapped along omega and every measured phase is moved by multiples of 360° next to its curve. Where
    the data have a variance, error bars show one standard deviation of one component, sqrt(variance / 2), in magnitude
    (downwards 20 dB at most) and phase. Where they have a coherence, a third diagram shows it.

    The arguments are those of `plot_nyquist`. The figure's axes are magnitude, phase and, where known, coherence.
    """
    series = _collect(fits, labels)
    figure = _page(6.4, 7.0 if any(one.response.coherence is not None for one in series) else 5.8)
    _draw_bode(figure, series, _title(fits))
    return figure


def plot_starts(fit: Fit) -> Figure:
    """Draw the final cost of every run, sorted and colored by the minimum reached.

    Failed runs are crosses at the right; their cost means nothing and is not shown. The scale is logarithmic where the
    costs span decades.
    """
    figure = _page(6.4, 4.0)
    _draw_starts(figure, fit)
    return figure


def plot(fit: Fit) -> Figure:
    """Draw the Nyquist diagram, the starts and the Bode diagram of a fit into one figure."""
    series = _collect((fit,), ())
    figure = _page(12.4, 8.6)
    figure.suptitle(_title((fit,)), fontsize=13)
    left, right = figure.subfigures(1, 2, wspace=0.03, squeeze=False)[0]
    top, bottom = left.subfigures(2, 1, height_ratios=(3, 2), squeeze=False)[:, 0]
    axes = _draw_nyquist(top, series, "Nyquist diagram")
    _draw_bode(right, series, "Bode diagram")
    _draw_starts(bottom, fit)
    _number_points(figure, axes, series)
    return figure


class _Figure(Figure):
    """A figure that a notebook shows although pyplot, which would teach it to, was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def _page(width: float, height: float) -> Figure:
    return _Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08))


@dataclass(frozen=True, eq=False)
class _Series:
    """Measured points (of the style of a marker) or a curve (of the style of a line), and the data it belongs to."""

    response: FrequencyResponse
    label: str
    color: str
    style: str
    checksum: str

    @property
    def measured(self) -> bool:
        return self.style in MARKERS

    @property
    def look(self) -> dict[str, Any]:
        """What matplotlib wants to know."""
        look = {"color": self.color, "label": self.label}
        if self.measured:
            edge = {"markeredgecolor": "white", "markeredgewidth": 0.5, "markersize": MARKER_SIZE}
            return {**look, "linestyle": "none", "marker": self.style, "zorder": 3, **edge}
        return {**look, "linestyle": self.style, "marker": "" if len(self.response) > 1 else "+", "linewidth": 1.8}


def _collect(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> list[_Series]:
    """Sort what is given into curves and then points; data that come twice count once."""
    _check(items, labels)
    names = [plain(label) for label in labels or _labels(items)]
    measured = {r.checksum: (r, label) for k, name in zip(items, names, strict=True) for r, label in _data(k, name)}
    places = [*measured]
    colors = COLORS if len(places) > 1 else (DARK,)
    curves = [_distinct(_curves(item)) for item in items]
    shared = any(isinstance(k, Fit) and 0 < len(found) < len(k.parts) for k, found in zip(items, curves, strict=True))
    series = []
    for i, found in enumerate(curves):
        for checksum, curve in found:
            palette, k = (COLORS if len(places) < 2 else GRAYS), i
            if len(places) > 1 and checksum in places and not shared:  # like its data
                palette, k = COLORS, places.index(checksum)
            color = palette[k % len(palette)]
            series.append(_Series(curve, names[i], color, STYLES[i % len(STYLES)], checksum))
    for k, (checksum, (data, label)) in enumerate(measured.items()):
        series.append(_Series(data, label, colors[k % len(colors)], MARKERS[k % len(MARKERS)], checksum))
    return series


def _check(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> None:
    wrong = [item for item in items if not isinstance(item, Fit | FrequencyResponse)]
    if wrong:
        raise TypeError(f"cannot draw {wrong[0]!r:.80}: give a Fit or a FrequencyResponse.")
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or FrequencyResponse.")
    if labels and len(labels) != len(items):
        raise ValueError(f"there are {len(labels)} labels for {len(items)} fits: give one for each.")


def _data(item: Fit | FrequencyResponse, name: str) -> list[tuple[FrequencyResponse, str]]:
    """Return the measured responses of an item with their labels."""
    if isinstance(item, Fit):
        return [(part.data, plain(part.name)) for part in item.parts]
    return [] if item.source == "model" else [(item, name)]


def _curves(item: Fit | FrequencyResponse) -> list[tuple[str, FrequencyResponse]]:
    """Return the curves of an item, along omega, each with the checksum of the data that it was fitted to."""
    if isinstance(item, Fit):
        return [(part.data.checksum, part.curve) for part in item.parts if part.curve is not None]
    order = np.argsort(item.omega)
    curve = replace(item, omega=item.omega[order], response=item.response[order])
    return [("", curve)] if item.source == "model" else []


def _distinct(curves: list[tuple[str, FrequencyResponse]]) -> list[tuple[str, FrequencyResponse]]:
    """Leave out the curves that lie on a longer one, as those of several rotors with one model do."""
    kept: list[tuple[str, FrequencyResponse]] = []
    for checksum, curve in sorted(curves, key=lambda item: -item[1].omega.max() / item[1].omega.min()):
        if not any(_lies_on(curve, other) for _, other in kept):
            kept.append((checksum, curve))
    return kept


def _lies_on(curve: FrequencyResponse, other: FrequencyResponse) -> bool:
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


def _ratio(series: Sequence[_Series]) -> str:
    """Return output/input in symbols, e.g. θ/u, or P(jω) where they are not the same for all."""
    outputs = {one.response.output for one in series} - {""}
    inputs = {one.response.input for one in series} - {""}
    return f"{symbol(*outputs)}/{symbol(*inputs)}" if len(outputs) == len(inputs) == 1 else "P(jω)"


def _draw_nyquist(figure: Figure | SubFigure, series: Sequence[_Series], title: str) -> Axes:
    axes = figure.subplots()
    axes.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    axes.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    for one in series:
        axes.plot(one.response.alpha, one.response.beta, **one.look)
    axes.margins(0.12)
    axes.set_aspect("equal", adjustable="datalim")
    _finish(axes, f"Real part of {_ratio(series)}", f"Imaginary part of {_ratio(series)}")
    axes.set_title(title, fontsize=12)
    _legend(figure, series)
    return axes


def _finish(axes: Axes, xlabel: str, ylabel: str) -> None:
    axes.set_xlabel(xlabel, fontsize=11)
    axes.set_ylabel(ylabel, fontsize=11)
    axes.tick_params(labelsize=10)
    axes.grid(True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(figure: Figure | SubFigure, series: Sequence[_Series]) -> None:
    """Draw a legend of all data, then of the curves, one entry per fit with all its colors."""
    entries: dict[str, dict[str, Line2D]] = {}
    for one in sorted(series, key=lambda one: not one.measured):
        entries.setdefault(one.label, {})[one.color + one.style] = Line2D([], [], **one.look)
    _legend_below(figure, {label: tuple(keys.values()) for label, keys in entries.items()})


def _legend_below(figure: Figure | SubFigure, entries: Mapping[str, tuple[Line2D, ...]]) -> None:
    """Draw a legend below everything, where it covers no data, with the keys of one label side by side."""
    figure.legend(
        handles=[*entries.values()],
        labels=[*entries],
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0.4)},
        handlelength=max(2.0, 1.2 * max(map(len, entries.values()))),
        loc="outside lower center",
        ncols=max(1, min(len(entries), int(figure.bbox.width / figure.dpi * 11 / (max(map(len, entries)) + 6)))),
        fontsize=10,
        frameon=False,
    )


def _number_points(figure: Figure, axes: Axes, series: Sequence[_Series]) -> None:
    """Write the frequencies beside the points of a Nyquist diagram, wherever there is room for one."""
    figure.draw_without_rendering()  # lays the axes out, so that places on the page are known
    measured = [one.response for one in series if one.measured]
    places = [axes.transData.transform(np.column_stack([data.alpha, data.beta])) for data in measured]
    room = Room(axes, [np.zeros((0, 2)), *places])
    for data, place in zip(measured, places, strict=True):
        order = np.argsort(data.omega)
        omega, spots = data.omega[order], place[order]
        chosen = np.unique(np.linspace(0, len(omega) - 1, min(len(omega), MANY)).round().astype(int)).tolist()
        for k in [*chosen[:1], *chosen[:0:-1]]:  # the ends first
            unit = " rad/s" if k == 0 and data is measured[0] else ""
            room.write(f"{omega[k]:.3g}{unit}", spots[k], spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0))


def _draw_bode(figure: Figure | SubFigure, series: Sequence[_Series], title: str) -> None:
    coherent = any(one.response.coherence is not None for one in series)
    ratios = (3, 3, 1.6) if coherent else (3, 3)
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for one in series:
        _draw_bode_series(axes, one, _phase_beside(one, series))
    labels = (f"Magnitude of {_ratio(series)}, dB", f"Phase of {_ratio(series)}, °", "Coherence γ²")
    for ax, label in zip(axes, labels, strict=False):
        _finish(ax, "", label)
    wide = np.ptp(axes[1].get_ylim()) > 60
    axes[1].yaxis.set_major_locator(MaxNLocator(7, steps=[1, 1.5, 3, 4.5, 9, 10] if wide else [1, 2, 5, 10]))
    if coherent:
        axes[2].set_ylim(0, 1.05)
    _frequency_axis(axes[-1], np.concatenate([one.response.omega for one in series]))
    axes[0].set_title(title, fontsize=12)
    figure.align_ylabels(axes)
    _legend(figure, series)


def _draw_bode_series(axes: Sequence[Axes], one: _Series, phase: NDArray[np.float64]) -> None:
    """Draw magnitude, `phase` (n,) in degrees, and what is known of coherence and variance."""
    response, size = one.response, np.abs(one.response.response)
    decibel = 20 * np.log10(np.where(size > 0, size, np.nan))
    axes[0].plot(response.omega, decibel, **one.look)
    axes[1].plot(response.omega, phase, **one.look)
    if response.coherence is not None:
        axes[2].plot(response.omega, response.coherence, **one.look)
    if response.variance is not None:
        relative = np.sqrt(response.variance / 2) / np.maximum(size, 1e-300)
        down, up = -20 * np.log10(1 - np.minimum(relative, 0.9)), 20 * np.log10(1 + np.minimum(relative, 1e6))
        look = {"fmt": "none", "ecolor": one.color, "elinewidth": 1.0, "capsize": 2.0, "alpha": 0.7}
        axes[0].errorbar(response.omega, decibel, [down, up], **look)
        axes[1].errorbar(response.omega, phase, np.degrees(np.minimum(relative, np.pi)), **look)


def _phase_beside(one: _Series, series: Sequence[_Series]) -> NDArray[np.float64]:
    """Return the phase (n,) in degrees: a curve's unwrapped along omega, a point's next to the nearest curve."""
    curves = [k for k in series if not k.measured] or [one]
    omega, guide = _unwrapped(min(curves, key=lambda curve: _distance(one, curve)) if one.measured else one)
    first = _interpolated(omega, *_unwrapped(series[0]))
    guide = guide + 360 * np.round(np.mean(first - guide) / 360)  # as a whole, next to the first
    phase = np.degrees(np.angle(one.response.response))
    return phase + 360 * np.round((_interpolated(one.response.omega, omega, guide) - phase) / 360)


def _distance(one: _Series, curve: _Series) -> float:
    """Return how far points lie from a curve, relative and on average; 0 for the one that was fitted to them."""
    if one.checksum == curve.checksum:
        return 0.0
    order = np.argsort(curve.response.omega)
    there = _interpolated(one.response.omega, curve.response.omega[order], curve.response.response[order])
    return float(np.mean(np.abs(one.response.response - there) / np.maximum(np.abs(there), 1e-300)))


def _unwrapped(one: _Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the sorted omega (n,) and the phase (n,) in degrees, unwrapped along it."""
    order = np.argsort(one.response.omega)
    return one.response.omega[order], np.degrees(np.unwrap(np.angle(one.response.response[order])))


def _frequency_axis(axes: Axes, omega: NDArray[np.float64]) -> None:
    """Make the horizontal axis logarithmic, with 1, 2 and 5 of every decade written out where there is room."""
    low, high = omega.min(), omega.max()
    axes.set(xlabel="ω, rad/s", xscale="log", xlim=(low / 1.15, high * 1.15))
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < 1e3 else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _draw_starts(figure: Figure | SubFigure, fit: Fit) -> None:
    axes = figure.subplots()
    costs = sorted((run.cost, run.index) for run in fit.runs if run.converged)
    _draw_minima(axes, fit, costs)
    _draw_failed(axes, len(costs), len(fit.runs) - len(costs))
    _scale_costs(axes, [cost for cost, _ in costs])
    _finish(axes, "Runs, sorted by cost", "Cost")
    axes.set_xlim(0, len(fit.runs) + 1)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    said = f"{fit.agreeing} of {len(fit.runs)} starts agree on the best minimum"
    axes.set_title(said if fit.converged else f"none of {len(fit.runs)} starts converged", fontsize=12)
    _legend_below(figure, {str(line.get_label()): (line,) for line in axes.get_lines()})


def _draw_minima(axes: Axes, fit: Fit, costs: Sequence[tuple[float, int]]) -> None:
    """Draw the sorted `costs` and indices of runs, one color a minimum; all beyond the colors are gray."""
    places = {index: (k, cost) for k, (cost, index) in enumerate(costs, 1)}
    named, others = fit.minima[: len(COLORS)], fit.minima[len(COLORS) :]
    groups = [(f"minimum {k}: {len(m.runs)} × cost {m.cost:.5g}", m.runs) for k, m in enumerate(named, 1)]
    rest = tuple(index for minimum in others for index in minimum.runs)
    groups += [(f"{len(others)} more: {len(rest)} ×", rest)] if rest else []
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
