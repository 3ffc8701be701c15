"""Time histories: measured, fitted or predicted outputs, their residuals, and the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from greybox.data.record import GAP, Record
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, IntArray
from greybox.plotting.long_lines import drawn_line, pieces
from greybox.plotting.style import (
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    align_and_explain,
    chosen,
    color_of,
    finish,
    given_axes,
    label_horizontal,
    new_figure,
    plain,
    shown_unit,
    signal_label,
    stacked,
)
from greybox.simulation.prediction import Prediction

MEASURED = "#AAAAAA"
INPUT = "#222222"
DOTS = 400  # measured samples up to which each is a dot: more would touch
MARKED_WINDOWS = 60  # windows up to which the beginning of each is marked: more would touch
WIDTH = 9.5  # inches


@dataclass(frozen=True, eq=False)
class History:
    """One item as it is drawn: values (n,) by output, half-widths of a 95 % band where there is one."""

    label: str
    data: Record
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    values: dict[str, Array]
    half_width: dict[str, Array]
    pieces: list[IntArray]
    window_starts: IntArray


def time_history(
    *items: Fit | Prediction,
    record: int = 0,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    legend: bool = True,
) -> AxesArray:
    """Draw measured and fitted outputs over time, below each its residuals, and the inputs at the bottom.

    Rows without a time are dots over their numbers.

    Parameters
    ----------
    *items : Fit or Prediction
        Several are laid over one another; they must have the same data. Predictions begin anew in
        every window, at a dot; the band (95 %) of fits and predictions holds the errors of
        parameters and initial state, not the noise of the sensors.
    record : int
        Which record of a fit to several.
    labels : sequence of str, optional
        One for each item.
    axes : array-like of Axes, optional
        Two for each output, for its values and its residuals, and one for each input. Without it a
        new figure is made.
    legend : bool
        False leaves the legend out. It stands below a new figure, and in the first panel of given
        axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (2 * outputs + inputs,)
        The last line of a notebook cell is ``gb.plotting.time_history(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, a fit without a record, items of different data, or a wrong number
        of labels or axes.
    """
    drawn = histories(items, record, labels)
    if axes is not None:
        places = given_axes(axes, _panels(drawn), "this time history")
    else:
        figure = new_figure(WIDTH, history_height(drawn))
        places = history_axes(figure, drawn)

    draw_history(places, drawn)
    names = dict.fromkeys(history.data.name for history in drawn if history.data.name)
    places[0].set_title(plain(", ".join(names) or "time history"), fontsize=TITLE_SIZE)

    align_and_explain(places, history_legend(drawn), given=axes is not None, legend=legend)
    return places


def histories(
    items: Sequence[Fit | Prediction], record: int, labels: Sequence[str] = ()
) -> list[History]:
    """Return what is drawn of each item.

    Raises
    ------
    TypeError, ValueError
        For what cannot be drawn, a fit without a record, or items of different data.
    """
    wrong = [item for item in items if not isinstance(item, Fit | Prediction)]
    if wrong:
        raise TypeError(f"cannot draw {wrong[0]!r:.80}: give a Fit or a Prediction.")
    if not items:
        raise ValueError("there is nothing to draw: give at least one Fit or Prediction.")
    if labels and len(labels) != len(items):
        raise ValueError(
            f"there are {len(labels)} labels for {len(items)} items: give one for each."
        )

    drawn = [
        _of_fit(item, record) if isinstance(item, Fit) else _of_prediction(item) for item in items
    ]
    for history in drawn[1:]:
        if not np.array_equal(history.data.time, drawn[0].data.time):
            raise ValueError(
                f"{history.label} and {drawn[0].label} belong to different records "
                f"({history.data.name or 'one'}, {drawn[0].data.name or 'the other'}): draw each alone."
            )

    names = list(labels) or [history.label for history in drawn]
    if len(set(names)) < len(names):
        names = [f"{name} {k}" for k, name in enumerate(names, 1)]
    return [replace(history, label=name) for name, history in zip(names, drawn, strict=True)]


def history_height(drawn: Sequence[History]) -> float:
    """Return the height in inches that a figure of these needs."""
    return 1.4 + 2.6 * len(_outputs(drawn)) + 1.1 * len(_inputs(drawn))


def history_axes(figure: Figure | SubFigure, drawn: Sequence[History]) -> AxesArray:
    """Make the axes in a figure or a part of one: output and residual for each output, then the inputs."""
    heights = [
        *(height for _ in _outputs(drawn) for height in (1.9, 0.8)),
        *(0.9 for _ in _inputs(drawn)),
    ]
    return stacked(figure, heights)


def draw_history(places: AxesArray, drawn: Sequence[History]) -> None:
    """Draw all items into their panels."""
    outputs = _outputs(drawn)
    for k, name in enumerate(outputs):
        _draw_output(places[2 * k], places[2 * k + 1], drawn, name)

    for ax, name in zip(places[2 * len(outputs) :], _inputs(drawn), strict=True):
        data = next(history.data for history in drawn if name in history.data.signals)
        values = data[name] * shown_scale(data, name)
        ax.plot(
            *drawn_line(along(data), values, gapless_rows(data)), color=INPUT, **_look(data, 1.0)
        )
        finish(ax, signal_label(name, data.units.get(name, "")))

    label_horizontal(places, "Time, s" if drawn[0].data.has_time else "Row")


def history_legend(drawn: Sequence[History]) -> dict[str, tuple[Artist, ...]]:
    """Return the legend: what was measured, every item, and the bands."""
    keys: dict[str, tuple[Artist, ...]] = {
        "measured": (Line2D([], [], color=MEASURED, linewidth=2.4),)
    }
    for k, history in enumerate(drawn):
        keys[plain(history.label)] = (Line2D([], [], color=color_of(k), linewidth=1.4),)
    if any(history.half_width for history in drawn):
        keys["95 % band without noise"] = (Patch(color="0.6", alpha=0.4, linewidth=0),)
    return keys


def _of_fit(fit: Fit, record: int) -> History:
    if not fit.records:
        raise ValueError(
            f"the fit {fit.name!r} has no record: draw its responses with gb.plot or gb.plotting.bode."
        )
    part = chosen(fit.records, record, "record")
    return History(
        label=f"fit of {part.label}",
        data=part.data,
        outputs=part.outputs,
        inputs=tuple(name for name in part.data.signals if name not in part.outputs),
        values={name: part.simulated[name] for name in part.outputs},
        half_width=_half_width(fit, part),
        pieces=gapless_rows(part.data),
        window_starts=np.zeros(0, dtype=int),
    )


def _half_width(fit: Fit, part: FittedRecord) -> dict[str, Array]:
    """Return half of the widths (n,) of the bands; between compared samples on the straight line."""
    if part.error is None or fit.known is None:
        return {}
    band = fit.output_band(part=fit.parts.index(part))
    rows = np.arange(len(part.data))
    found = {}
    for name, (low, high) in band.items():
        half = (high - low) / 2
        known = np.isfinite(half)
        if known.any():
            found[name] = np.interp(rows, rows[known], half[known], left=np.nan, right=np.nan)
    return found


def _of_prediction(prediction: Prediction) -> History:
    from scipy.special import ndtri  # noqa: PLC0415  (takes a tenth of a second to import)

    predicted = prediction.record
    return History(
        label=prediction.title,
        data=prediction.data,
        outputs=prediction.outputs,
        inputs=prediction.inputs,
        values={name: predicted[name] for name in prediction.outputs},
        half_width={
            name: float(ndtri(0.975)) * predicted[f"{name}_error"] for name in prediction.outputs
        },
        pieces=list(prediction.rows),
        window_starts=prediction.rows[:, 0],
    )


def gapless_rows(data: Record) -> list[IntArray]:
    """Return the rows between the gaps; rows without a time are not joined."""
    if not data.has_time:
        return [np.array([row]) for row in range(len(data))]
    return pieces(data.time, GAP * data.step)


def along(data: Record) -> Array:
    """Return the times, or the numbers of the rows from one."""
    return data.time if data.has_time else data.time + 1


def _look(data: Record, width: float) -> dict[str, Any]:
    """Return how values are drawn: a line of this width along the time, a dot for each row."""
    if data.has_time:
        return {"linewidth": width}
    return {"linestyle": "none", "marker": ".", "markersize": 3 + width}


def _outputs(drawn: Sequence[History]) -> list[str]:
    return list(dict.fromkeys(name for history in drawn for name in history.outputs))


def _inputs(drawn: Sequence[History]) -> list[str]:
    """Return the inputs of all."""
    return list(dict.fromkeys(name for history in drawn for name in history.inputs))


def _panels(drawn: Sequence[History]) -> list[str]:
    """Return the names of the panels, from top to bottom."""
    outputs = [panel for name in _outputs(drawn) for panel in (name, f"residual of {name}")]
    return [*outputs, *_inputs(drawn)]


def _draw_output(ax: Axes, residual_ax: Axes, drawn: Sequence[History], name: str) -> None:
    data = next(history.data for history in drawn if name in history.outputs)
    scale = shown_scale(data, name)
    measured = np.isfinite(data[name])

    if measured.sum() <= DOTS or not data.has_time:
        ax.plot(
            along(data)[measured],
            scale * data[name][measured],
            ".",
            color=MEASURED,
            markersize=4.5,
            zorder=1.5,
        )
    else:
        line = drawn_line(data.time, scale * data[name], gapless_rows(data))
        ax.plot(*line, color=MEASURED, linewidth=2.4, zorder=1.5)

    for k, history in enumerate(drawn):
        if name in history.outputs:
            _draw_item(ax, residual_ax, history, name, color_of(k), scale)

    residual_ax.axhline(0, color="0.6", linewidth=0.8)
    finish(ax, signal_label(name, data.units.get(name, "")))
    finish(residual_ax, "residual")


def _draw_item(
    ax: Axes, residual_ax: Axes, history: History, name: str, color: str, scale: float
) -> None:
    time = along(history.data)
    values = scale * history.values[name]
    residual = scale * history.data[name] - values
    ax.plot(
        *drawn_line(time, values, history.pieces),
        color=color,
        **_look(history.data, 1.1),
        zorder=2.5,
    )
    residual_ax.plot(
        *drawn_line(time, residual, history.pieces), color=color, **_look(history.data, 0.8)
    )

    if name in history.half_width:
        half = scale * history.half_width[name]
        if not history.data.has_time:
            ax.errorbar(time, values, half, fmt="none", ecolor=color, alpha=0.4, zorder=2)
            residual_ax.errorbar(
                time, np.zeros_like(half), half, fmt="none", ecolor=color, alpha=0.4, zorder=2
            )
            return
        t, low = drawn_line(time, values - half, history.pieces, thin=False)
        _, high = drawn_line(time, values + half, history.pieces, thin=False)
        _, width = drawn_line(time, half, history.pieces, thin=False)
        look = {"color": color, "alpha": 0.2, "linewidth": 0, "zorder": 2}
        ax.fill_between(t, low, high, **look)
        residual_ax.fill_between(t, -width, width, **look)

    if 0 < history.window_starts.size <= MARKED_WINDOWS:
        ax.plot(
            time[history.window_starts],
            values[history.window_starts],
            ".",
            color=color,
            markersize=4,
            zorder=3,
        )


def shown_scale(data: Record, name: str) -> float:
    """Return the factor to the unit in which a signal is drawn."""
    return shown_unit(data.units.get(name, ""))[0]
