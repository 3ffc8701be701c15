"""Time histories: measured, fitted or predicted outputs, their residuals, and the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from greybox.data.record import GAP, Record
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, IntArray
from greybox.plotting.figure import GRAY, INK, Figure, Panel, Series, band, rule
from greybox.plotting.long_lines import COLUMNS, drawn_line, pieces
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.plotting.signals import chosen, shown_unit, signal_label
from greybox.simulation.prediction import Prediction

DOTS = 400  # measured samples up to which each is a dot: more would touch
HISTORY = {"width": 9.5, "inches": 1.9}  # size of a new figure


@dataclass(frozen=True, eq=False)
class History:
    """What is drawn of a fit or a prediction.

    Attributes
    ----------
    label : str
    data : Record
    outputs, inputs : tuple of str
    values : mapping of output to (n,) array
    half_width : mapping of output to (n,) array
        Of the 95 % band, where there is one.
    pieces : list of index arrays
        IntArray that one line joins.
    """

    label: str
    data: Record
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    values: dict[str, Array]
    half_width: dict[str, Array]
    pieces: list[IntArray]


def time_history(
    *items: Fit | Prediction,
    record: int = 0,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
    legend: bool = True,
) -> AxesArray:
    """Draw measured and fitted outputs over time, below each its residuals, and the inputs.

    IntArray without a time are dots over their numbers.

    Parameters
    ----------
    *items : Fit or Prediction
        They must have the same data. Predictions start again in every window. The band
        (95 %) covers the errors of parameters and initial state, without sensor noise.
    record : int
        Number of the record in a fit to several.
    labels : sequence of str, optional
        One for each item.
    axes : array-like of Axes, optional
        Two for each output, for its values and its residuals, and one for each input. By default
        a new figure is made.
    legend : bool
        Draw a legend, below a new figure or in the first of the given axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (2 * outputs + inputs,)
        In a notebook, ``gb.plotting.time_history(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For items that cannot be drawn, a fit without a record, items of different data, or a wrong
        number of labels or axes.
    """
    return draw(history_figure(items, record, labels), axes, legend=legend, **HISTORY)


def history_figure(
    items: Sequence[Fit | Prediction],
    record: int = 0,
    labels: Sequence[str] = (),
    columns: int = COLUMNS,
) -> Figure:
    """Return the history of one record; long lines keep the extremes of so many columns."""
    drawn = _histories(items, record, labels)
    outputs = dict.fromkeys(name for history in drawn for name in history.outputs)
    inputs = dict.fromkeys(name for history in drawn for name in history.inputs)
    panels = [panel for name in outputs for panel in _output_panels(drawn, name, columns)]
    for name in inputs:
        data = next(history.data for history in drawn if name in history.data.signals)
        series = _line("", data, data[name], _gapless(data), columns, INK)
        panels.append(Panel(signal_label(data, name), [_shown(series, data, name)], height=0.5))

    data = drawn[0].data
    names = ", ".join(dict.fromkeys(history.data.name for history in drawn if history.data.name))
    return Figure(
        f"Time history, {names}" if names else "Time history",
        "Time, s" if data.has_time else "Row",
        panels,
        subject=names or "time history",
        caption=_caption(drawn, columns),
        bands="95 % band without noise",
        is_wide=True,
    )


def _caption(drawn: Sequence[History], columns: int) -> str:
    sentences = []
    if any(history.half_width for history in drawn):
        sentences.append(
            "Bands: 95 % confidence from the errors of parameters and initial state, without "
            "sensor noise."
        )
    count = len(drawn[0].data)
    if count > 2 * columns:
        sentences.append(
            f"Of {count} samples, the smallest and largest of each {-(-count // columns)} are drawn."
        )
    return " ".join(sentences)


def _output_panels(drawn: Sequence[History], name: str, columns: int) -> list[Panel]:
    data = next(history.data for history in drawn if name in history.outputs)
    measured = _line("measured", data, data[name], _gapless(data), columns, GRAY, width=2.4)
    is_finite = np.isfinite(data[name])
    if is_finite.sum() <= DOTS:
        time = _along(data)[is_finite]
        measured = Series("measured", "points", time, data[name][is_finite], GRAY)
    outputs = [measured]
    residuals = [rule()]
    for color, history in enumerate(drawn):
        if name not in history.outputs:
            continue
        values = history.values[name]
        residual = history.data[name] - values
        if name in history.half_width:
            half = history.half_width[name]
            outputs.append(_band(history, values, half, color))
            residuals.append(_band(history, 0 * half, half, color))
        line = (history.pieces, columns, color)
        outputs.append(_line(history.label, history.data, values, *line, width=1.1))
        residuals.append(_line(history.label, history.data, residual, *line, width=0.8))

    unit = shown_unit(data.units.get(name, ""))[1]
    label = f"Residual, {unit}" if unit else "Residual"
    return [
        Panel(signal_label(data, name), [_shown(series, data, name) for series in outputs]),
        Panel(label, [_shown(series, data, name) for series in residuals], height=0.5),
    ]


def _histories(
    items: Sequence[Fit | Prediction], record: int, labels: Sequence[str]
) -> list[History]:
    for item in items:
        if not isinstance(item, Fit | Prediction):
            raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a Prediction.")
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
                f"({history.data.name or 'one'}, {drawn[0].data.name or 'the other'}): "
                "draw each alone."
            )

    names = list(labels) or [history.label for history in drawn]
    if len(set(names)) < len(names):
        names = [f"{name} {k}" for k, name in enumerate(names, 1)]
    return [replace(history, label=name) for name, history in zip(names, drawn, strict=True)]


def _of_fit(fit: Fit, record: int) -> History:
    if not fit.records:
        raise ValueError(
            f"the fit {fit.name!r} has no record: draw its responses with gb.plot or "
            "gb.plotting.bode."
        )
    part = chosen(fit.records, record, "record")
    return History(
        label=f"fit of {part.label}",
        data=part.data,
        outputs=part.outputs,
        inputs=tuple(name for name in part.data.signals if name not in part.outputs),
        values={name: part.simulated[name] for name in part.outputs},
        half_width=_half_width(fit, part),
        pieces=_gapless(part.data),
    )


def _half_width(fit: Fit, part: FittedRecord) -> dict[str, Array]:
    """Return half of the widths (n,) of the bands, interpolated between compared samples."""
    if part.error is None or fit.known is None:
        return {}
    rows = np.arange(len(part.data))
    half_width = {}
    for name, (low, high) in fit.output_band(part=fit.parts.index(part)).items():
        half = (high - low) / 2
        is_known = np.isfinite(half)
        if is_known.any():
            half_width[name] = np.interp(rows, rows[is_known], half[is_known], np.nan, np.nan)
    return half_width


def _of_prediction(prediction: Prediction) -> History:
    from scipy.special import ndtri  # noqa: PLC0415  (takes a tenth of a second to import)

    predicted = prediction.record
    quantile = float(ndtri(0.975))
    return History(
        label=prediction.title,
        data=prediction.data,
        outputs=prediction.outputs,
        inputs=prediction.inputs,
        values={name: predicted[name] for name in prediction.outputs},
        half_width={name: quantile * predicted[f"{name}_error"] for name in prediction.outputs},
        pieces=list(prediction.rows),
    )


def _gapless(data: Record) -> list[IntArray]:
    """Return the rows between the gaps; rows without a time are not joined."""
    if not data.has_time:
        return [np.array([row]) for row in range(len(data))]
    return pieces(data.time, GAP * data.step)


def _along(data: Record) -> Array:
    """Return the times, or the numbers of the rows from one."""
    return data.time if data.has_time else data.time + 1


def _line(
    name: str,
    data: Record,
    values: Array,
    rows: Sequence[IntArray],
    columns: int,
    color: int,
    width: float = 1.0,
) -> Series:
    """Return values (n,) as a line along the time, or as a dot for each row without a time."""
    if not data.has_time:
        return Series(name, "points", _along(data), values, color)
    x, y = drawn_line(data.time, values, rows, columns=columns)
    return Series(name, "line", x, y, color, width=width)


def _band(history: History, middle: Array, half: Array, color: int) -> Series:
    time = _along(history.data)
    if not history.data.has_time:  # a bar for each row
        ends = np.column_stack([middle - half, middle + half, np.full(len(half), np.nan)])
        return Series("", "line", np.repeat(time, 3), ends.ravel(), color, width=0.8)
    every = -(-len(history.data) // 400)  # bands are smooth
    rows = [piece[::every] for piece in history.pieces]
    x, low = drawn_line(time, middle - half, rows, thin=False)
    _, high = drawn_line(time, middle + half, rows, thin=False)
    return band(history.label, x, low, high, color)


def _shown(series: Series, data: Record, name: str) -> Series:
    """Convert a series to the unit in which the signal is drawn."""
    factor, _ = shown_unit(data.units.get(name, ""))
    return replace(
        series,
        y=factor * series.y,
        low=None if series.low is None else factor * series.low,
        high=None if series.high is None else factor * series.high,
    )
