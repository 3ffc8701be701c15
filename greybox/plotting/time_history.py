"""Time histories: measured, fitted or predicted outputs, their residuals, and the inputs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from greybox.data.record import GAP, Record
from greybox.estimate.result import Fit
from greybox.files.arrays import Array, IntArray
from greybox.plotting.figure import GRAY, INK, Figure, Panel, Series, band, rule
from greybox.plotting.long_lines import COLUMNS, drawn_line, pieces
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.plotting.signals import chosen, distinct_labels, shown_unit, signal_label
from greybox.simulation.prediction import Prediction

DOTS = 400  # measured samples up to which each is a dot: more would touch


@dataclass(frozen=True, eq=False)
class History:
    """The signals of a fit or a prediction that a figure shows.

    Attributes
    ----------
    label : str
    data : Record
    outputs, inputs : tuple of str
    values : mapping of output to (n,) array
    half_width : mapping of output to (n,) array
        Half the width of the 95 % band; empty without one.
    pieces : list of index arrays
        Samples that one line joins.
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

    Rows without a time are dots over their numbers.

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
    return draw([history_figure(items, record, labels)], axes, legend=legend, size=(9.5, 1.9))


def history_figure(
    items: Sequence[Fit | Prediction],
    record: int = 0,
    labels: Sequence[str] = (),
    columns: int = COLUMNS,
) -> Figure:
    """Return the history of one record; long lines keep the extremes of so many columns."""
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
    outputs = dict.fromkeys(name for history in drawn for name in history.outputs)
    inputs = dict.fromkeys(name for history in drawn for name in history.inputs)
    panels = []
    for output in outputs:
        panels += _output_panels(dict(zip(names, drawn, strict=True)), output, columns)
    for name in inputs:
        data = next(history.data for history in drawn if name in history.data.signals)
        values = shown_unit(data.units.get(name, ""))[0] * data[name]
        series = _line("", data, values, _gapless(data), columns, INK)
        panels.append(Panel(signal_label(data, name), [series], height=0.5))

    data = drawn[0].data
    records = ", ".join(dict.fromkeys(history.data.name for history in drawn if history.data.name))
    return Figure(
        f"Time history, {records}" if records else "Time history",
        "Time, s" if data.has_time else "Row",
        panels,
        subject=records or "time history",
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
        size = -(-count // columns)
        sentences.append(f"Of {count} samples, the smallest and largest of each {size} are drawn.")

    return " ".join(sentences)


def _output_panels(drawn: Mapping[str, History], name: str, columns: int) -> list[Panel]:
    """Return the panels of an output and of its residuals; `drawn` has histories by label."""
    data = next(history.data for history in drawn.values() if name in history.outputs)
    factor, unit = shown_unit(data.units.get(name, ""))
    measured = factor * data[name]
    is_finite = np.isfinite(measured)
    # Dots show which samples there are; many of them look like a line, and take longer to draw.
    if is_finite.sum() <= DOTS:
        dots = _along(data)[is_finite], measured[is_finite]
        outputs = [Series("measured", "points", *dots, GRAY)]
    else:
        outputs = [_line("measured", data, measured, _gapless(data), columns, GRAY, width=2.4)]

    residuals = [rule()]
    for color, (label, history) in enumerate(drawn.items()):
        if name not in history.outputs:
            continue
        values = factor * history.values[name]
        residual = factor * history.data[name] - values
        if name in history.half_width:
            half = factor * history.half_width[name]
            outputs.append(_band(label, history, values, half, color))
            residuals.append(_band(label, history, 0 * half, half, color))
        line = (history.pieces, columns, color)
        outputs.append(_line(label, history.data, values, *line, width=1.1))
        residuals.append(_line(label, history.data, residual, *line, width=0.8))

    return [
        Panel(signal_label(data, name), outputs),
        Panel(f"Residual, {unit}" if unit else "Residual", residuals, height=0.5),
    ]


def _history(item: Fit | Prediction, record: int) -> History:
    if isinstance(item, Prediction):
        predicted = item.record
        return History(
            label=item.title,
            data=item.data,
            outputs=item.outputs,
            inputs=item.inputs,
            values={name: predicted[name] for name in item.outputs},
            half_width={name: 1.96 * predicted[f"{name}_error"] for name in item.outputs},
            pieces=list(item.rows),
        )
    if not isinstance(item, Fit):
        raise TypeError(f"cannot draw {item!r:.80}: give a Fit or a Prediction.")
    if not item.records:
        raise ValueError(
            f"the fit {item.name!r} has no record: draw its responses with gb.plot or "
            "gb.plotting.bode."
        )

    part = chosen(item.records, record, "record")
    return History(
        label=f"fit of {part.label}",
        data=part.data,
        outputs=part.outputs,
        inputs=tuple(name for name in part.data.signals if name not in part.outputs),
        values={name: part.simulated[name] for name in part.outputs},
        half_width={},
        pieces=_gapless(part.data),
    )


def _gapless(data: Record) -> list[IntArray]:
    """Return the rows between the gaps; rows without a time are not joined."""
    # A line between two rows would suggest that something happened between them.
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


def _band(label: str, history: History, middle: Array, half: Array, color: int) -> Series:
    time = _along(history.data)
    if not history.data.has_time:  # a bar for each row
        ends = np.column_stack([middle - half, middle + half, np.full(len(half), np.nan)])
        return Series("", "line", np.repeat(time, 3), ends.ravel(), color, width=0.8)

    # Bands follow from sensitivities and are smooth: 400 points draw them.
    every = -(-len(history.data) // 400)
    rows = [piece[::every] for piece in history.pieces]
    x, low = drawn_line(time, middle - half, rows)
    _, high = drawn_line(time, middle + half, rows)
    return band(label, x, low, high, color)
