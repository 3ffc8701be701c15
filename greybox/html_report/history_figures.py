"""Time histories: measured, fitted and predicted outputs with their residuals, and the inputs."""

from collections.abc import Sequence

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array, IntArray
from greybox.files.text_table import in_greek
from greybox.html_report.figure import Figure, Panel, Series
from greybox.plotting.long_lines import drawn_line
from greybox.plotting.style import shown_unit
from greybox.plotting.time_history import DOTS, History, along, gapless_rows, histories, shown_scale
from greybox.simulation.prediction import Prediction

GRAY, BLACK = -1, -2


def history_figure(
    items: Sequence[Fit | Prediction], record: int, labels: Sequence[str], columns: int
) -> Figure:
    """Return the history of one record; of long lines, the extremes of what falls into one of so many columns."""
    drawn = histories(items, record, labels)
    data = drawn[0].data
    outputs = list(dict.fromkeys(name for history in drawn for name in history.outputs))
    inputs = list(dict.fromkeys(name for history in drawn for name in history.inputs))
    panels = [panel for name in outputs for panel in _output_panels(drawn, name, columns)]
    for name in inputs:
        held = next(history for history in drawn if name in history.data.signals)
        series = _curve(
            held,
            "",
            held.data[name] * shown_scale(held.data, name),
            BLACK,
            columns,
            gapless_rows(held.data),
        )
        panels.append(Panel(_label(held, name), [series], height=0.5))
    names = ", ".join(dict.fromkeys(history.data.name for history in drawn if history.data.name))
    title = f"Time history{f', {names}' if names else ''}"
    label = "Time, s" if data.has_time else "Row"
    return Figure(title, label, panels, _caption(drawn, columns), is_wide=True)


def _caption(drawn: Sequence[History], columns: int) -> str | None:
    said = []
    if any(history.half_width for history in drawn):
        said.append(
            "Bands hold 95 % of the errors of parameters and initial state, without the noise of the sensors."
        )
    if len(drawn[0].data) > 2 * columns:
        said.append(
            f"Of {len(drawn[0].data)} samples the smallest and largest of each {-(-len(drawn[0].data) // columns)} are "
            "drawn."
        )
    return " ".join(said) or None


def _output_panels(drawn: Sequence[History], name: str, columns: int) -> list[Panel]:
    holder = next(history for history in drawn if name in history.outputs)
    factor, unit = shown_unit(holder.data.units.get(name, ""))
    measured = factor * holder.data[name]
    if not holder.data.has_time or np.isfinite(measured).sum() <= DOTS:
        values = [Series("measured", "points", along(holder.data), measured, GRAY)]
    else:
        values = [_curve(holder, "measured", measured, GRAY, columns, gapless_rows(holder.data))]
    residuals = [Series("", "rule", np.zeros(1), np.zeros(1), GRAY)]
    for k, history in enumerate(drawn):
        if name not in history.outputs:
            continue
        fitted = factor * history.values[name]
        if name in history.half_width:
            half = factor * history.half_width[name]
            every = max(1, len(history.data) // (2 * columns))
            rows = [piece[::every] for piece in history.pieces]
            x, low = drawn_line(along(history.data), fitted - half, rows, thin=False)
            _, high = drawn_line(along(history.data), fitted + half, rows, thin=False)
            values.append(Series(f"{history.label}, 95 %", "band", x, low, k, low=low, high=high))
        values.append(_curve(history, history.label, fitted, k, columns, history.pieces))
        residuals.append(
            _curve(history, history.label, measured - fitted, k, columns, history.pieces)
        )
    residual = f"Residual{f', {unit}' if unit else ''}"
    return [Panel(_label(holder, name), values), Panel(residual, residuals, height=0.5)]


def _curve(
    history: History,
    label: str,
    values: Array,
    color: int,
    columns: int,
    pieces: Sequence[IntArray],
) -> Series:
    if not history.data.has_time:
        return Series(label, "points", along(history.data), values, color)
    x, y = drawn_line(along(history.data), values, pieces, columns=columns)
    return Series(label, "line", x, y, color)


def _label(history: History, name: str) -> str:
    shown = shown_unit(history.data.units.get(name, ""))[1]
    return f"{in_greek(name)}, {shown}" if shown else in_greek(name)
