"""Figures of a fit: Nyquist diagram, Bode diagram, and the costs that the starts reached."""

import io
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend_handler import HandlerTuple
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from greybox.fit import Fit
from greybox.frequency_response import FrequencyResponse
from greybox.solve import Run

Style = Literal["-", "--", "-.", ":"]

# Okabe and Ito's colors, which readers with a color vision deficiency can tell apart; yellow is too pale for lines.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DARK, GRAYS = "#222222", ("#222222", "#777777", "#AAAAAA")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
STYLES: tuple[Style, ...] = ("-", "--", "-.", ":")
MARKER_SIZE = 5.5  # points
SAME_CURVE = 1e-2  # relative distance below which two curves of one fit are the same line on paper
MANY = 12  # points of one data set that are all annotated
LOG_SPAN = 30.0  # costs that span more than this are drawn on a log scale

_Phase = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Sorted omega (n,) in rad/s and unwrapped phase (n,) in degrees."""


def plot_nyquist(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Nyquist diagram: measured points, numbered by their frequency in rad/s, and the fitted curves.

    Parameters
    ----------
    *fits : Fit or FrequencyResponse
        All are drawn into one diagram; data that several fits share are drawn once. A measured response is drawn as
        points, one that was evaluated from a model (`Fit.response`, `frequency_response`) as a line.
    labels : sequence of str, optional
        One legend entry for each of `fits`, e.g. ``("published", "refitted")``.

    Returns
    -------
    matplotlib.figure.Figure
        Not known to pyplot: show it as the last line of a notebook cell or save it with ``savefig``.
    """
    content = _collect(fits, labels)
    figure = _page(6.4, 5.8)
    axes = _draw_nyquist(figure, content)
    _number_points(figure, axes, content.points)
    return figure


def plot_bode(*fits: Fit | FrequencyResponse, labels: Sequence[str] = ()) -> Figure:
    """Draw the Bode diagram: magnitude in dB and unwrapped phase in degrees over omega in rad/s.

    Curves are unwrapped along omega and every measured phase is moved by multiples of 360° next to its curve. Where
    the data have a variance, error bars show one standard deviation of one component, sqrt(variance / 2), in magnitude
    (downwards 20 dB at most) and phase. Where they have a coherence, a third diagram shows it.

    Parameters
    ----------
    *fits, labels
        As in `plot_nyquist`.

    Returns
    -------
    matplotlib.figure.Figure
        Its axes are magnitude, phase and, where known, coherence.
    """
    content = _collect(fits, labels)
    figure = _page(6.4, 7.0 if content.coherent else 5.8)
    _draw_bode(figure, content)
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
    content = _collect((fit,), ())
    figure = _page(12.4, 8.6)
    figure.suptitle(content.title, fontsize=13)
    left, right = figure.subfigures(1, 2, wspace=0.03, squeeze=False)[0]
    top, bottom = left.subfigures(2, 1, height_ratios=(3, 2), squeeze=False)[:, 0]
    axes = _draw_nyquist(top, content, "Nyquist diagram")
    _draw_bode(right, content, "Bode diagram")
    _draw_starts(bottom, fit)
    _number_points(figure, axes, content.points)
    return figure


class _Figure(Figure):
    """A figure that a notebook shows although pyplot, which would teach it to, was never imported."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()


def _page(width: float, height: float) -> Figure:
    """Return an empty figure, inches, that leaves a margin of 0.08 inches."""
    return _Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08))


# What is drawn


@dataclass(frozen=True, eq=False)
class _Points:
    """One measured response and how it is drawn."""

    data: FrequencyResponse
    label: str
    color: str
    marker: str


@dataclass(frozen=True, eq=False)
class _Line:
    """One curve, how it is drawn, and which of the measured responses it belongs to (None: to none)."""

    curve: FrequencyResponse
    label: str
    color: str
    style: Style
    owner: int | None


@dataclass(frozen=True, eq=False)
class _Content:
    """Everything that a Nyquist or a Bode diagram shows."""

    points: list[_Points]
    lines: list[_Line]
    title: str

    @property
    def coherent(self) -> bool:
        """True when some data have a coherence."""
        return any(p.data.coherence is not None for p in self.points)

    @property
    def signals(self) -> tuple[str, str]:
        """Output and input, empty where they are not the same for all."""
        drawn = [*(line.curve for line in self.lines), *(p.data for p in self.points)]
        outputs, inputs = {r.output for r in drawn if r.output}, {r.input for r in drawn if r.input}
        return (_only(outputs), _only(inputs))

    @property
    def omega(self) -> tuple[float, float]:
        """The band, rad/s."""
        every = np.concatenate([r.omega for r in (*(p.data for p in self.points), *(k.curve for k in self.lines))])
        return float(every.min()), float(every.max())


def _collect(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> _Content:
    """Sort what is given into points and lines; data that come twice count once."""
    _check(items, labels)
    names = [_plain(label) for label in labels or _labels(items)]
    measured: dict[str, tuple[FrequencyResponse, str]] = {}
    for item, name in zip(items, names, strict=True):
        for data, label in _measured(item, name):
            measured.setdefault(data.checksum, (data, label))
    places = {checksum: k for k, checksum in enumerate(measured)}
    points = [_Points(data, label, *_marker(k, len(places))) for k, (data, label) in enumerate(measured.values())]
    curves = [_distinct(_curves(item)) for item in items]
    shared = any(
        len(found) == 1 < len(item.parts) for item, found in zip(items, curves, strict=True) if isinstance(item, Fit)
    )
    lines = [
        _Line(
            curve,
            names[i],
            _line_color(i, places.get(key), len(points), shared),
            STYLES[i % len(STYLES)],
            places.get(key),
        )
        for i, found in enumerate(curves)
        for key, curve in found
    ]
    return _Content(points, lines, _title(items))


def _check(items: Sequence[Fit | FrequencyResponse], labels: Sequence[str]) -> None:
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or FrequencyResponse.")
    for item in items:
        if not isinstance(item, Fit | FrequencyResponse):
            raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a FrequencyResponse.")
    if labels and len(labels) != len(items):
        raise ValueError(f"there are {len(labels)} labels for {len(items)} fits: give one for each.")


def _measured(item: Fit | FrequencyResponse, name: str) -> list[tuple[FrequencyResponse, str]]:
    """Return the measured responses of an item with their labels."""
    if isinstance(item, Fit):
        return [(part.data, _plain(part.name)) for part in item.parts]
    return [] if item.source == "model" else [(item, name)]


def _curves(item: Fit | FrequencyResponse) -> list[tuple[str, FrequencyResponse]]:
    """Return the curves of an item, each with the checksum of the data that it was fitted to."""
    if isinstance(item, Fit):
        return [(part.data.checksum, part.curve) for part in item.parts if part.curve is not None]
    return [("", _sorted(item))] if item.source == "model" else []


def _sorted(curve: FrequencyResponse) -> FrequencyResponse:
    order = np.argsort(curve.omega)
    return replace(curve, omega=curve.omega[order], response=curve.response[order])


def _distinct(curves: list[tuple[str, FrequencyResponse]]) -> list[tuple[str, FrequencyResponse]]:
    """Leave out the curves that lie on a longer one, as those of several rotors with one model do."""
    kept: list[tuple[str, FrequencyResponse]] = []
    for key, curve in sorted(curves, key=lambda item: -item[1].omega.max() / item[1].omega.min()):
        if not any(_lies_on(curve, other) for _, other in kept):
            kept.append((key, curve))
    return [item for item in curves if item in kept]


def _lies_on(curve: FrequencyResponse, other: FrequencyResponse) -> bool:
    low, high = other.omega.min() * (1 - 1e-9), other.omega.max() * (1 + 1e-9)
    if curve.omega.min() < low or curve.omega.max() > high:
        return False
    there = _interpolated(curve.omega, other.omega, other.response)
    return bool(np.all(np.abs(curve.response - there) <= SAME_CURVE * np.abs(there)))


def _interpolated(omega: NDArray, known: NDArray, values: NDArray) -> NDArray:
    """Interpolate `values` (n,) at the sorted `known` (n,) over the logarithm of the frequency, to `omega` (m,)."""
    return np.interp(np.log(omega), np.log(known), values)


def _marker(place: int, count: int) -> tuple[str, str]:
    return (DARK if count < 2 else COLORS[place % len(COLORS)]), MARKERS[place % len(MARKERS)]


def _line_color(item: int, place: int | None, count: int, shared: bool) -> str:
    """Color lines by item with one set of data; like their data with several, or gray where they serve several."""
    if count < 2:
        return COLORS[item % len(COLORS)]
    return GRAYS[item % len(GRAYS)] if shared or place is None else COLORS[place % len(COLORS)]


# Words


def _labels(items: Sequence[Fit | FrequencyResponse]) -> list[str]:
    """Name the items by the first of model, problem and criterion that tells them apart."""
    readings: tuple[Callable[[Fit], str], ...] = (
        lambda fit: _joined(part.label for part in fit.parts),
        lambda fit: fit.name,
        lambda fit: _joined(part.criterion for part in fit.parts),
    )
    for reading in readings:
        names = [f"fit of {reading(item)}" if isinstance(item, Fit) else item.name or "data" for item in items]
        if len(set(names)) == len(names):
            return names
    return [f"{'fit' if isinstance(item, Fit) else item.name or 'data'} {k}" for k, item in enumerate(items, 1)]


def _title(items: Sequence[Fit | FrequencyResponse]) -> str:
    """Return the names of the fits, else of the data, and which fits have no answer."""
    fits = [item for item in items if isinstance(item, Fit)]
    names = [fit.name if fit.converged else f"{fit.name}: no start converged" for fit in fits]
    names = names or [item.name for item in items if item.name]
    return _shortened(_plain(_joined(names)), 64)


def _joined(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _only(names: set[str]) -> str:
    return next(iter(names)) if len(names) == 1 else ""


def _plain(text: str) -> str:
    """Return `text` as matplotlib is to show it: no mathematics, and no underscore that hides it from a legend."""
    return text.lstrip("_").replace("$", r"\$")


def _shortened(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[: limit - 1].rstrip() + "…"


def _ratio(signals: tuple[str, str]) -> str:
    """Return output/input in symbols, e.g. θ/u."""
    output, input = signals
    return f"{_symbol(output)}/{_symbol(input)}" if output and input else "P(jω)"


def _symbol(name: str) -> str:
    """Return a signal's name with Greek letters and an index: theta is θ, u_phi is u with index φ."""
    base, _, index = name.partition("_")
    if index.isalnum() and base.isalnum():
        return rf"{_greek(base)}$_{{\mathregular{{{_greek(index)}}}}}$"
    return _greek(_plain(name))


def _greek(name: str) -> str:
    kind = "SMALL" if name.islower() else "CAPITAL"
    if not (name.islower() or name.istitle()):
        return name
    try:
        return unicodedata.lookup(f"GREEK {kind} LETTER {name.upper()}")
    except KeyError:
        return name


# Nyquist diagram


def _draw_nyquist(figure: Figure | SubFigure, content: _Content, title: str = "") -> Axes:
    axes = figure.subplots()
    axes.axhline(0, color="0.6", linewidth=0.8, zorder=1)
    axes.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    for line in content.lines:
        _draw_line(axes, line, line.curve.alpha, line.curve.beta)
    for points in content.points:
        _draw_points(axes, points, points.data.alpha, points.data.beta)
    axes.margins(0.12)
    axes.set_aspect("equal", adjustable="datalim")
    ratio = _ratio(content.signals)
    _finish(axes, f"Real part of {ratio}", f"Imaginary part of {ratio}")
    axes.set_title(title or content.title, fontsize=12)
    _legend(figure, content)
    return axes


def _draw_line(axes: Axes, line: _Line, x: NDArray, y: NDArray) -> None:
    marker = "" if len(x) > 1 else "+"
    axes.plot(x, y, line.style, marker=marker, color=line.color, label=line.label, linewidth=1.8, zorder=2)


def _draw_points(axes: Axes, points: _Points, x: NDArray, y: NDArray) -> None:
    edge = {"markeredgecolor": "white", "markeredgewidth": 0.5}
    look = {"marker": points.marker, "markersize": MARKER_SIZE, "color": points.color, **edge}
    axes.plot(x, y, linestyle="none", label=points.label, zorder=3, **look)


def _finish(axes: Axes, xlabel: str, ylabel: str) -> None:
    axes.set_xlabel(xlabel, fontsize=11)
    axes.set_ylabel(ylabel, fontsize=11)
    axes.tick_params(labelsize=10)
    axes.grid(True, color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _legend(figure: Figure | SubFigure, content: _Content) -> None:
    """Draw one legend below everything, where it cannot cover data: all data, then one line per fit."""
    entries: dict[str, tuple[Line2D, ...]] = {}
    for p in content.points:
        key = Line2D([], [], linestyle="none", marker=p.marker, markersize=MARKER_SIZE + 0.5, color=p.color)
        entries[p.label] = (*entries.get(p.label, ()), key)
    for k in {(k.label, k.color, k.style): k for k in content.lines}.values():
        key = Line2D([], [], linestyle=k.style, linewidth=1.8, color=k.color)
        entries[k.label] = (*entries.get(k.label, ()), key)
    _legend_below(figure, entries)


def _legend_below(figure: Figure | SubFigure, entries: Mapping[str, tuple[Line2D, ...]]) -> None:
    """Draw a legend with, for every label, keys that stand side by side."""
    width = figure.bbox.width / figure.dpi  # inches
    columns = max(1, min(len(entries), int(width * 11 / (max(map(len, entries)) + 6))))
    figure.legend(
        handles=[*entries.values()],
        labels=[*entries],
        handler_map={tuple: HandlerTuple(ndivide=None, pad=0.4)},
        handlelength=max(2.0, 1.2 * max(map(len, entries.values()))),
        loc="outside lower center",
        ncols=columns,
        fontsize=10,
        frameon=False,
    )


# The frequencies beside the points of a Nyquist diagram


def _number_points(figure: Figure, axes: Axes, points: Sequence[_Points]) -> None:
    """Write the frequencies beside the points, wherever there is room for one."""
    figure.draw_without_rendering()  # lays the axes out, so that places on the page are known
    room = _Room(axes, points)
    for one in points:
        x, y = one.data.alpha, one.data.beta
        by_omega = np.argsort(one.data.omega)
        spots = axes.transData.transform(np.column_stack([x, y])[by_omega])
        lowest = one.data.omega.min()
        for k in _spread(len(by_omega)):
            omega = one.data.omega[by_omega[k]]
            text = f"{omega:.3g}" + (" rad/s" if omega == lowest and one is points[0] else "")
            room.write(text, (float(x[by_omega[k]]), float(y[by_omega[k]])), spots[k], _outward(spots, k))


def _spread(n: int) -> list[int]:
    """Choose at most `MANY` of `n` points, the ends first."""
    chosen = np.unique(np.linspace(0, n - 1, min(n, MANY)).round().astype(int)).tolist()
    return [*chosen[:1], *chosen[:0:-1]]


def _outward(spots: NDArray[np.float64], k: int) -> NDArray[np.float64]:
    """Return the unit vector (2,) from the neighbors of point `k` of `spots` (n, 2) to the point itself."""
    away = spots[k] - spots[max(0, k - 1) : k + 2].mean(axis=0)
    length = float(np.hypot(*away))
    return away / length if length > 0 else np.array([0.0, 1.0])


class _Room:
    """The page around the points: knows what is taken, and writes where nothing is."""

    GAP = 6.0  # points, from the middle of a marker to the text
    NEAR = 45.0  # points, within which a number is not repeated
    ANGLES = np.radians(np.arange(0, 360, 30))

    def __init__(self, axes: Axes, points: Sequence[_Points]) -> None:
        self._axes = axes
        self._pixels = axes.figure.dpi / 72
        self._boxes: list[Bbox] = []
        self._written: list[tuple[str, NDArray]] = []
        self._spots = np.vstack(
            [axes.transData.transform(np.column_stack([p.data.alpha, p.data.beta])) for p in points]
        )
        drawn = [line for line in axes.get_lines() if line.get_linestyle() != "None"]
        paths = [line.get_path().transformed(line.get_transform()) for line in drawn]
        self._zeros, self._curves = paths[:2], paths[2:]

    def write(self, text: str, xy: tuple[float, float], spot: NDArray, outward: NDArray) -> None:
        """Write `text` beside the data point `xy`, at `spot` (2,) on the page, best in the direction `outward` (2,)."""
        if any(
            text == other and np.hypot(*(spot - there)) < self.NEAR * self._pixels for other, there in self._written
        ):
            return
        look = {"fontsize": 8.5, "color": "0.25", "path_effects": [withStroke(linewidth=2, foreground="white")]}
        note = self._axes.annotate(text, xy, (0, 0), textcoords="offset points", ha="center", va="center", **look)
        size = np.array(note.get_window_extent().size)
        offset = self._find(spot, size, outward)
        if offset is None:
            note.remove()
            return
        note.set_position(tuple(offset / self._pixels))
        self._written.append((text, spot))
        self._boxes.append(_box(spot + offset, size))

    def _find(self, spot: NDArray, size: NDArray, outward: NDArray) -> NDArray | None:
        """Return a free place for a text of `size` (2,), on one of the axes through zero only if there is no other."""
        for obstacles in (self._curves + self._zeros, self._curves):
            for offset in self._offsets(size, outward):
                box = _box(spot + offset, size)
                if self._is_free(box) and not any(
                    path.intersects_bbox(box.padded(self._pixels), False) for path in obstacles
                ):
                    return offset
        return None

    def _offsets(self, size: NDArray, outward: NDArray) -> list[NDArray]:
        """Return places around a point, in pixels from it to the middle of the text, the outward ones first."""
        directions = np.column_stack([np.cos(self.ANGLES), np.sin(self.ANGLES)])
        directions = directions[np.argsort(-directions @ outward, kind="stable")]
        gap = self.GAP * self._pixels
        return [d * (gap + np.min(size / 2 / np.maximum(np.abs(d), 1e-9))) for d in directions]

    def _is_free(self, box: Bbox) -> bool:
        wide = box.padded(self._pixels * MARKER_SIZE / 2)
        inside = np.all((self._spots > wide.min) & (self._spots < wide.max), axis=1)
        frame = self._axes.bbox
        within = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
        taken = any(box.padded(self._pixels).overlaps(other) for other in self._boxes)
        return bool(within and not taken and not inside.any())


def _box(middle: NDArray, size: NDArray) -> Bbox:
    return Bbox(np.array([middle - size / 2, middle + size / 2]))


# Bode diagram


def _draw_bode(figure: Figure | SubFigure, content: _Content, title: str = "") -> None:
    ratios = (3, 3, 1.6) if content.coherent else (3, 3)
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    for line in content.lines:
        _draw_line(axes[0], line, line.curve.omega, _decibel(line.curve.response))
        _draw_line(axes[1], line, *_moved(_phase(line.curve), _guide(content)))
    for points in content.points:
        _draw_bode_points(axes, points, _guide(content, points))
    ratio = _ratio(content.signals)
    _finish(axes[0], "", f"Magnitude of {ratio}, dB")
    _finish(axes[1], "", f"Phase of {ratio}, °")
    span = float(np.ptp(axes[1].get_ylim()))
    axes[1].yaxis.set_major_locator(MaxNLocator(7, steps=[1, 1.5, 3, 4.5, 9, 10] if span > 60 else [1, 2, 5, 10]))
    if content.coherent:
        _finish(axes[2], "", "Coherence γ²")
        axes[2].set_ylim(0, 1.05)
    axes[-1].set_xlabel("ω, rad/s", fontsize=11)
    _frequency_axis(axes[-1], content.omega)
    axes[0].set_title(title or content.title, fontsize=12)
    figure.align_ylabels(axes)
    _legend(figure, content)


def _draw_bode_points(axes: Sequence[Axes], points: _Points, guide: _Phase) -> None:
    """Draw the measured magnitudes, phases beside `guide`, and coherences."""
    data = points.data
    decibel, phase = _decibel(data.response), _beside(data, guide)
    if data.variance is not None:
        down, up, turn = _deviations(data)
        look = {"fmt": "none", "ecolor": points.color, "elinewidth": 1.0, "capsize": 2.0, "alpha": 0.7}
        axes[0].errorbar(data.omega, decibel, [down, up], **look)
        axes[1].errorbar(data.omega, phase, turn, **look)
    _draw_points(axes[0], points, data.omega, decibel)
    _draw_points(axes[1], points, data.omega, phase)
    if data.coherence is not None:
        _draw_points(axes[2], points, data.omega, data.coherence)


def _decibel(response: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return 20 lg |response|, (n,); NaN for zeros."""
    size = np.abs(response)
    return 20 * np.log10(np.where(size > 0, size, np.nan))


def _deviations(data: FrequencyResponse) -> tuple[NDArray, NDArray, NDArray]:
    """Return one standard deviation of one component as dB down, dB up and degrees, each (n,)."""
    assert data.variance is not None
    relative = np.sqrt(data.variance / 2) / np.maximum(np.abs(data.response), 1e-300)
    down = -20 * np.log10(1 - np.minimum(relative, 0.9))
    return down, 20 * np.log10(1 + np.minimum(relative, 1e6)), np.degrees(np.minimum(relative, np.pi))


def _guide(content: _Content, points: _Points | None = None) -> _Phase:
    """Return the phase beside which `points` are drawn: of their curve, else of any, else of the data themselves."""
    first = content.lines[0].curve if content.lines else content.points[0].data
    if points is None:
        return _phase(first)
    place = content.points.index(points)
    own = [line.curve for line in content.lines if line.owner == place]
    return _moved(_phase((own or [first if content.lines else points.data])[0]), _guide(content))


def _phase(response: FrequencyResponse) -> _Phase:
    """Return the sorted omega (n,) and the phase (n,) in degrees, unwrapped along it."""
    order = np.argsort(response.omega)
    return response.omega[order], np.degrees(np.unwrap(np.angle(response.response[order])))


def _moved(phase: _Phase, guide: _Phase) -> _Phase:
    """Move a whole unwrapped phase by the multiple of 360° that brings it nearest to `guide`."""
    omega, degrees = phase
    turns = np.mean(_interpolated(omega, *guide) - degrees) / 360
    return omega, degrees + 360 * np.round(turns)


def _beside(data: FrequencyResponse, guide: _Phase) -> NDArray[np.float64]:
    """Return the measured phases (n,) in degrees, each moved by the multiple of 360° that is nearest to `guide`."""
    degrees = np.degrees(np.angle(data.response))
    return degrees + 360 * np.round((_interpolated(data.omega, *guide) - degrees) / 360)


def _frequency_axis(axes: Axes, band: tuple[float, float]) -> None:
    """Make the horizontal axis logarithmic, with 1, 2 and 5 of every decade written out where there is room."""
    low, high = band
    axes.set_xscale("log")
    axes.set_xlim(low / 1.15, high * 1.15)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high / low < 1e3 else (1,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda omega, _: f"{omega:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


# Starts


def _draw_starts(figure: Figure | SubFigure, fit: Fit) -> None:
    axes = figure.subplots()
    done = sorted((run for run in fit.runs if run.converged), key=lambda run: run.cost)
    drawn = [*_draw_minima(axes, fit, done), *_draw_failed(axes, len(done), len(fit.runs) - len(done))]
    _cost_axis(axes, np.array([run.cost for run in done]))
    _finish(axes, "Runs, sorted by cost", "Cost")
    axes.set_xlim(0, len(fit.runs) + 1)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    axes.set_title(_agreement(fit), fontsize=12)
    _legend_below(figure, {str(artist.get_label()): (artist,) for artist in drawn})


def _draw_minima(axes: Axes, fit: Fit, runs: Sequence[Run]) -> list[Line2D]:
    """Draw the converged `runs`, in their order, one artist for each minimum; all beyond the colors are gray."""
    places = {run.index: k for k, run in enumerate(runs, 1)}
    costs = {run.index: run.cost for run in runs}
    named, others = fit.minima[: len(COLORS)], fit.minima[len(COLORS) :]
    groups = [(minimum.runs, f"cost {minimum.cost:.5g}: {_runs(len(minimum.runs))}") for minimum in named]
    if others:
        members = tuple(index for minimum in others for index in minimum.runs)
        groups.append((members, f"{len(others)} more minima: {_runs(len(members))}"))
    handles = []
    for k, (members, label) in enumerate(groups):
        look = {"color": (*COLORS, GRAYS[1])[k], "marker": (*MARKERS[: len(COLORS)], ".")[k], "markersize": 4.5}
        x, y = [places[index] for index in members], [costs[index] for index in members]
        handles += axes.plot(x, y, linestyle="none", label=label, zorder=3, **look)
    return handles


def _draw_failed(axes: Axes, before: int, count: int) -> list[Line2D]:
    """Draw `count` crosses to the right of the `before` converged runs, at a height that is no cost."""
    if not count:
        return []
    x = np.arange(before + 1, before + count + 1)
    axes.axvspan(before + 0.5, before + count + 0.5, color="0.95", zorder=0)
    look = {"color": DARK, "marker": "x", "markersize": 5, "transform": axes.get_xaxis_transform()}
    return axes.plot(x, np.full(count, 0.93), linestyle="none", label=f"failed: {_runs(count)}", zorder=3, **look)


def _runs(count: int) -> str:
    return f"{count} {'run' if count == 1 else 'runs'}"


def _cost_axis(axes: Axes, costs: NDArray[np.float64]) -> None:
    """Scale the axis to the sorted `costs` (n,) of converged runs, so that rounding does not fill it."""
    if not costs.size:
        axes.set_yticks([])
    elif costs[0] > 0 and costs[-1] > LOG_SPAN * costs[0]:
        axes.set_yscale("log")
    else:
        room = 0.1 * max(costs[-1] - costs[0], abs(costs[0]), 1e-12)
        axes.set_ylim(costs[0] - room, costs[-1] + 2 * room)


def _agreement(fit: Fit) -> str:
    if not fit.converged:
        return f"none of {len(fit.runs)} starts converged"
    return f"{fit.agreeing} of {len(fit.runs)} starts agree on the best minimum"
