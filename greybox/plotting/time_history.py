"""Figures of time histories: measured, fitted or predicted, what is left, and the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from greybox.data.record import GAP, Record
from greybox.estimate.result import Fit, FittedRecord
from greybox.plotting.style import COLORS, finish, legend_below, page, plain, symbol
from greybox.simulation.prediction import Prediction
from greybox.simulation.windows import seconds

Array = NDArray[np.float64]
MEASURED, INPUT = "#AAAAAA", "#222222"
MOST = 4000  # points of a line: more cannot be told apart on paper
DOTS = 400  # measured samples up to which each is a dot
STARTS = 60  # windows up to which the beginning of each is marked
WIDTH = 9.5  # inches


@dataclass(frozen=True, eq=False)
class _History:
    """One item as it is drawn: values (n,) by output, half-widths of a 95 % band where there is one."""

    label: str
    data: Record
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    values: dict[str, Array]
    half: dict[str, Array]
    pieces: list[NDArray[np.integer]]
    begins: NDArray[np.integer]


def plot_history(*items: Fit | Prediction, record: int = 0, labels: Sequence[str] = ()) -> Figure:
    """Draw measured and fitted outputs over time, below each what is left, and the inputs at the bottom.

    Parameters
    ----------
    *items : Fit or Prediction
        Several are laid over one another; they must have the same data. Predictions begin anew in every window, at a
        dot; their band (95 %) holds the errors of parameters and initial state, not the noise of the sensors.
    record : int
        Which record of a fit to several.
    labels : sequence of str, optional
        One for each item.

    The figure is not known to pyplot: show it as the last line of a notebook cell or save it with ``savefig``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, a fit without a record, or items of different data.
    """
    histories = _histories(items, record, labels)
    figure = page(WIDTH, history_height(items, record))
    draw_history(figure, items, record, labels)
    names = dict.fromkeys(h.data.name for h in histories if h.data.name)
    figure.axes[0].set_title(plain(", ".join(names) or "time history"), fontsize=12)
    return figure


def history_height(items: Sequence[Fit | Prediction], record: int = 0) -> float:
    """Return the height in inches that a figure of these needs."""
    histories = _histories(items, record, ())
    return 1.4 + 2.6 * len(_outputs(histories)) + 1.1 * len(_inputs(histories))


def draw_history(
    figure: Figure | SubFigure, items: Sequence[Fit | Prediction], record: int = 0, labels: Sequence[str] = ()
) -> None:
    """Draw them into a figure or a part of one."""
    histories = _histories(items, record, labels)
    outputs, inputs = _outputs(histories), _inputs(histories)
    ratios = [*(ratio for _ in outputs for ratio in (1.9, 0.8)), *(0.9 for _ in inputs)]
    axes = list(np.atleast_1d(figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)))
    for k, name in enumerate(outputs):
        _draw_output(axes[2 * k], axes[2 * k + 1], histories, name)
    for axis, name in zip(axes[2 * len(outputs) :], inputs, strict=True):
        data = next(h.data for h in histories if name in h.data.signals)
        axis.plot(*_broken(data.time, data[name] * _scale(data, name), _pieces(data)), color=INPUT, linewidth=1.0)
        finish(axis, "", _label(data, name))
    axes[-1].set_xlabel("Time, s", fontsize=11)
    figure.align_ylabels(axes)
    legend_below(figure, _keys(histories))


def _histories(items: Sequence[Fit | Prediction], record: int, labels: Sequence[str]) -> list[_History]:
    wrong = [item for item in items if not isinstance(item, Fit | Prediction)]
    if wrong:
        raise TypeError(f"cannot draw {wrong[0]!r:.80}: give a Fit or a Prediction.")
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or Prediction.")
    if labels and len(labels) != len(items):
        raise ValueError(f"there are {len(labels)} labels for {len(items)} items: give one for each.")
    found = [_of_fit(item, record) if isinstance(item, Fit) else _of_prediction(item) for item in items]
    for history in found[1:]:
        if not np.array_equal(history.data.time, found[0].data.time):
            raise ValueError(
                f"{history.label} and {found[0].label} belong to different records "
                f"({history.data.name or 'one'}, {found[0].data.name or 'the other'}): draw each alone."
            )
    said = list(labels) or [h.label for h in found]
    if len(set(said)) < len(said):
        said = [f"{label} {k}" for k, label in enumerate(said, 1)]
    return [replace(h, label=label) for label, h in zip(said, found, strict=True)]


def _of_fit(fit: Fit, record: int) -> _History:
    count = len(fit.records)
    if not count:
        raise ValueError(f"the fit {fit.name!r} has no record: draw its responses with gb.plot or gb.plotting.bode.")
    if not -count <= record < count:
        raise ValueError(f"record {record} is not there: the fit has {count}, counted from 0.")
    part: FittedRecord = fit.records[record]
    values = {name: part.simulated[name] for name in part.outputs}
    pieces, begins = _pieces(part.data), np.zeros(0, dtype=int)
    inputs = tuple(name for name in part.data.signals if name not in part.outputs)
    return _History(f"fit of {part.label}", part.data, part.outputs, inputs, values, {}, pieces, begins)


def _of_prediction(prediction: Prediction) -> _History:
    from scipy.special import ndtri  # noqa: PLC0415  (takes a tenth of a second to import)

    along = prediction.record
    values = {name: along[name] for name in prediction.outputs}
    half = {name: float(ndtri(0.975)) * along[f"{name}_error"] for name in prediction.outputs}
    label = f"{prediction.label}, {seconds(prediction.horizon)} s ahead"
    rows, outputs = prediction.rows, prediction.outputs
    return _History(label, prediction.data, outputs, prediction.inputs, values, half, list(rows), rows[:, 0])


def _pieces(data: Record) -> list[NDArray[np.integer]]:
    """Return the rows between the gaps."""
    cuts = np.flatnonzero(np.diff(data.time) > GAP * data.step) + 1 if len(data) > 1 else []
    return list(np.split(np.arange(len(data)), cuts))


def _outputs(histories: Sequence[_History]) -> list[str]:
    return list(dict.fromkeys(name for h in histories for name in h.outputs))


def _inputs(histories: Sequence[_History]) -> list[str]:
    """Return the inputs of all."""
    return list(dict.fromkeys(name for h in histories for name in h.inputs))


def _draw_output(axis: Axes, below: Axes, histories: Sequence[_History], name: str) -> None:
    data = next(h.data for h in histories if name in h.outputs)
    scale, there = _scale(data, name), np.isfinite(data[name])
    if there.sum() <= DOTS:
        axis.plot(data.time[there], scale * data[name][there], ".", color=MEASURED, markersize=4.5, zorder=1.5)
    else:
        axis.plot(*_broken(data.time, scale * data[name], _pieces(data)), color=MEASURED, linewidth=2.4, zorder=1.5)
    for k, history in enumerate(histories):
        if name in history.outputs:
            _draw_line(axis, below, history, name, COLORS[k % len(COLORS)], scale)
    below.axhline(0, color="0.6", linewidth=0.8)
    finish(axis, "", _label(data, name))
    finish(below, "", "residual")


def _draw_line(axis: Axes, below: Axes, history: _History, name: str, color: str, scale: float) -> None:
    time, values = history.data.time, scale * history.values[name]
    look = {"color": color, "linewidth": 1.1}
    axis.plot(*_broken(time, values, history.pieces), zorder=2.5, **look)
    below.plot(*_broken(time, scale * history.data[name] - values, history.pieces), **{**look, "linewidth": 0.8})
    if name in history.half:
        half = scale * history.half[name]
        t, low = _broken(time, values - half, history.pieces, thin=False)
        _, high = _broken(time, values + half, history.pieces, thin=False)
        _, width = _broken(time, half, history.pieces, thin=False)
        look = {"color": color, "alpha": 0.2, "linewidth": 0, "zorder": 2}
        axis.fill_between(t, low, high, **look)
        below.fill_between(t, -width, width, **look)
    if 0 < history.begins.size <= STARTS:
        axis.plot(time[history.begins], values[history.begins], ".", color=color, markersize=4, zorder=3)


def _broken(
    time: Array, values: Array, pieces: Sequence[NDArray[np.integer]], thin: bool = True
) -> tuple[Array, Array]:
    """Return the pieces one after the other with a NaN between; of long ones the extremes of what a pixel covers."""
    times, found = [], []
    size = -(-sum(map(len, pieces)) // (MOST // 2)) if thin else 1
    for rows in pieces:
        kept = _extremes(values[rows], size) if size > 2 else slice(None)
        times += [time[rows][kept], [np.nan]]
        found += [values[rows][kept], [np.nan]]
    return np.concatenate(times), np.concatenate(found)


def _extremes(values: Array, size: int) -> NDArray[np.integer]:
    if values.size < size:
        return np.arange(values.size)
    blocks = np.arange(0, values.size - size + 1, size)
    rows = values[blocks[:, None] + np.arange(size)]
    lowest = blocks + np.nan_to_num(rows, nan=np.inf).argmin(axis=1)
    highest = blocks + np.nan_to_num(rows, nan=-np.inf).argmax(axis=1)
    return np.unique(np.concatenate([lowest, highest, [0, values.size - 1]]))


def _scale(data: Record, name: str) -> float:
    """Return the factor to what a person reads: degrees for radians."""
    return 180 / np.pi if data.units.get(name, "") in ("rad", "rad/s") else 1.0


def _label(data: Record, name: str) -> str:
    unit = data.units.get(name, "")
    shown = {"rad": "°", "rad/s": "°/s"}.get(unit, unit)
    return f"{symbol(name)}, {plain(shown)}" if shown else symbol(name)


def _keys(histories: Sequence[_History]) -> dict[str, tuple[Line2D, ...]]:
    """Return the legend: what was measured, every item, and the bands."""
    keys = {"measured": (Line2D([], [], color=MEASURED, linewidth=2.4),)}
    for k, history in enumerate(histories):
        keys[plain(history.label)] = (Line2D([], [], color=COLORS[k % len(COLORS)], linewidth=1.4),)
    if any(history.half for history in histories):
        keys["95 % band without noise"] = (Patch(color="0.6", alpha=0.4, linewidth=0),)  # type: ignore[assignment]
    return keys
