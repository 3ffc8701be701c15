"""Time histories: measured, fitted or predicted outputs, their residuals, and the inputs."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.assessment.result import Fit
from greybox.assessment.simulation.prediction import Prediction
from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import unique
from greybox.data.files.public import public
from greybox.data.record import Record
from greybox.reporting.plotting.figure import (
    GRAY,
    INK,
    Figure,
    Panel,
    Series,
    band,
    require_drawable,
    rule,
)
from greybox.reporting.plotting.long_lines import COLUMNS, drawn_line
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.signals import (
    chosen,
    distinct_labels,
    shown_unit,
    signal_label,
    with_unit,
)

BANDS = (
    "Bands: 95 % confidence from the errors of parameters and initial state, without sensor noise."
)


@frozen
class History:
    """The signals of a fit or a prediction that a figure shows.

    Attributes
    ----------
    label : str
    data, modeled : Record
        `modeled` has ``y_error`` beside an output ``y`` of known standard error.
    outputs, inputs : tuple of str
    pieces : list of index arrays
        Samples that one line joins.
    """

    label: str
    data: Record
    modeled: Record
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    pieces: list[IntArray]


@public
def time_history(
    *items: Fit | Prediction,
    record: int = 0,
    labels: Sequence[str] = (),
    axes: GivenAxes | None = None,
) -> AxesArray:
    """Draw measured and fitted outputs over time, below each its residuals, and the inputs.

    Data without a time are drawn as dots over the number of the row.

    Parameters
    ----------
    *items : Fit or Prediction
        They must have the same data. Predictions start again in every window. The 95 % band
        covers the errors of parameters and initial state, without sensor noise.
    record : int
        Number of the record in a fit to several.
    labels : sequence of str, optional
        One for each item.
    axes : array-like of Axes, optional
        Two for each output, for its values and its residuals, and one for each input. By default
        a new figure is made.

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
    return draw([history_figure(items, record, labels)], axes, size=(9.5, 1.9))


def history_figure(
    items: Sequence[Fit | Prediction],
    record: int = 0,
    labels: Sequence[str] = (),
    columns: int = COLUMNS,
) -> Figure:
    """Return the history of one record; long lines keep the extremes of this many columns."""
    drawn = [_history(item, record) for item in items]
    names = distinct_labels([history.label for history in drawn], labels)
    for history in drawn[1:]:
        if not np.array_equal(history.data.time, drawn[0].data.time):
            raise ValueError(
                f"{history.label} and {drawn[0].label} belong to different records "
                f"({history.data.name or 'one'}, {drawn[0].data.name or 'the other'}): "
                "draw each alone."
            )

    # Models may have different outputs and inputs: every signal has one panel for all of them.
    outputs = unique(name for history in drawn for name in history.outputs)
    inputs = unique(name for history in drawn for name in history.inputs)
    panels = []
    for output in outputs:
        panels += _output_panels(dict(zip(names, drawn, strict=True)), output, columns)
    for name in inputs:
        data = next(history.data for history in drawn if name in history.data.signals)
        values = shown_unit(data.units, name)[0] * data[name]
        series = _drawn("", data, values, _lines(data, [name]), columns, INK)
        panels.append(Panel(signal_label(data, name), series, height=0.5))

    data = drawn[0].data
    records = ", ".join(unique(history.data.name for history in drawn if history.data.name))
    return Figure(
        f"Time history, {records}" if records else "Time history",
        "Time, s" if data.has_time else "Row",
        panels,
        subject=records or "time history",
        caption=BANDS if any(s.low is not None for panel in panels for s in panel.series) else "",
        bands="95 % band without noise",
        is_wide=True,
    )


def _output_panels(drawn: Mapping[str, History], name: str, columns: int) -> list[Panel]:
    """Return the panels of an output and of its residuals; `drawn` has histories by label."""
    history = next(history for history in drawn.values() if name in history.outputs)
    data = history.data
    factor, unit = shown_unit(data.units, name)
    measured = factor * data[name]
    is_finite = np.isfinite(measured)
    lines = _lines(data, history.inputs)
    outputs = _drawn("measured", data, measured, lines, columns, GRAY)
    # Dots show which samples there are; many of them look like a line, and take longer to draw.
    if is_finite.sum() <= 400:  # dots of more samples would touch
        dots = _along(data)[is_finite], measured[is_finite]
        outputs = [Series("measured", "points", *dots, GRAY)]

    residuals = [rule()]
    for color, (label, history) in enumerate(drawn.items()):
        if name not in history.outputs:
            continue
        values = factor * history.modeled[name]
        residual = factor * history.data[name] - values
        error = history.modeled.signals.get(f"{name}_error")
        half = None if error is None else 1.96 * factor * error
        line = (history.pieces, columns, color)
        outputs += _drawn(label, history.data, values, *line, half=half, middle=values)
        residuals += _drawn(label, history.data, residual, *line, half=half)

    return [
        Panel(signal_label(data, name), outputs),
        Panel(with_unit("Residual", unit), residuals, height=0.5),
    ]


def _history(item: Fit | Prediction, record: int) -> History:
    if isinstance(item, Prediction):
        return History(
            item.title,
            item.data,
            item.record,
            item.outputs,
            item.inputs,
            [rows[rows >= 0] for rows in item.rows],
        )
    require_drawable(item, Fit, "a Fit or a Prediction")
    part = chosen(item.records, record, "record")
    label = f"fit of {part.label}"
    return History(
        label,
        part.data,
        part.simulated,
        part.outputs,
        part.input_names,
        _lines(part.data, part.input_names),
    )


def _lines(data: Record, inputs: Sequence[str]) -> list[IntArray]:
    """Return the rows between which lines are drawn: those through which a model runs on."""
    return data.stretches(inputs) if data.has_time else data.independent_pieces


def _along(data: Record) -> Array:
    """Return the times, or the numbers of the rows from one."""
    return data.time if data.has_time else data.time + 1


def _drawn(
    name: str,
    data: Record,
    values: Array,
    rows: Sequence[IntArray],
    columns: int,
    color: int,
    *,
    half: Array | None = None,
    middle: Array | float = 0.0,
) -> list[Series]:
    """Return values (n,) as a line along the time, over the band `half` (n,) around `middle`.

    Without a time every row is a dot, with a bar.
    """
    if not data.has_time:
        ends = (None, None) if half is None else (values - half, values + half)
        return [Series(name, "points", _along(data), values, color, 0, *ends)]
    x, y = drawn_line(data.time, values, rows, columns=columns)
    lines = [Series(name, "line", x, y, color)]
    if half is not None:
        # Bands follow from sensitivities and are smooth: 400 points draw them.
        stride = math.ceil(len(data) / 400)
        pieces = [piece[::stride] for piece in rows]
        x, low = drawn_line(data.time, middle - half, pieces)
        _, high = drawn_line(data.time, middle + half, pieces)
        lines.insert(0, band(name, x, low, high, color))
    return lines
