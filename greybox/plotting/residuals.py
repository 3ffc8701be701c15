"""The residuals of a fitted record: their distribution, and what they are correlated with."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from greybox.data.record import Record
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.plotting.style import (
    COLORS,
    DARK,
    TITLE_SIZE,
    AxesArray,
    GivenAxes,
    chosen,
    finish,
    given_axes,
    new_figure,
    plain,
    shown_unit,
    symbol,
)
from greybox.statistics.metrics import CorrelationTest, input_correlation, whiteness

BINS = 40  # of a histogram, at most: narrower ones show chance
MOST_INPUTS = 3  # that have a panel for each output: those that the residuals are most clearly correlated with


@dataclass(frozen=True, eq=False)
class ResidualPanel:
    """What one panel shows of the residuals of an output: their histogram, or correlations."""

    output: str
    name: str
    test: CorrelationTest | None = None


def residuals(fit: Fit, record: int = 0, *, axes: GivenAxes | None = None) -> AxesArray:
    """Draw the residuals of every output of a fitted record: histogram, autocorrelation, correlation with inputs.

    The histogram has the normal distribution of the same mean and variance. Correlations are over
    the lag in samples, with what 99 % of them stay within if there is none, and the p-value of all
    together. Those with an input are after both were filtered by what whitens the residuals, at
    lags by which the input comes before; of more than three inputs these are the three with the
    smallest p-values, and constant ones are left out. Rows without a time have no lags.

    Parameters
    ----------
    fit : Fit
    record : int
        Which record of a fit to several.
    axes : array-like of Axes, optional
        One for each panel, output by output. Without it a new figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        The last line of a notebook cell is ``gb.plotting.residuals(fit)[0].figure``.

    Raises
    ------
    TypeError, ValueError
        For a fit without an estimate or without this record, or for a wrong number of axes.
    """
    if not isinstance(fit, Fit):
        raise TypeError(f"cannot draw {fit!r:.80}: give a Fit.")
    if not fit.records:
        raise ValueError(
            f"the fit {fit.name!r} has no record: gb.plotting.bode shows the errors of its responses."
        )
    part = chosen(fit.records, record, "record")
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate: {fit.status}.")
    rows = [residual_panels(part, output) for output in part.outputs]

    if axes is not None:
        drawn = given_axes(
            axes,
            [f"{p.name} of {p.output}" for row in rows for p in row],
            "this figure of residuals",
        )
    else:
        columns = max(map(len, rows))
        figure = new_figure(3.1 * columns, 0.6 + 2.4 * len(rows))
        grid = figure.subplots(len(rows), columns, squeeze=False)
        for row, places in zip(rows, grid, strict=True):
            for spare in places[len(row) :]:
                spare.remove()
        drawn = np.array(
            [ax for row, places in zip(rows, grid, strict=True) for ax in places[: len(row)]]
        )
        figure.suptitle(plain(part.data.name or fit.name), fontsize=TITLE_SIZE)

    for ax, panel in zip(drawn, (panel for row in rows for panel in row), strict=True):
        if panel.test is None:
            _draw_histogram(ax, part, panel.output)
        else:
            _draw_correlations(ax, panel, panel.test)
    return drawn


def residual_panels(part: FittedRecord, output: str) -> list[ResidualPanel]:
    """Return what is shown of the residuals of an output."""
    found = [ResidualPanel(output, "histogram")]
    if not part.data.has_time:
        return found
    pieces = _pieces(part.data, part.residual(output))
    tested = whiteness(pieces, fitted=part.innovation_parameters(output))
    found.append(ResidualPanel(output, "autocorrelation", tested))
    inputs = {}
    for name in part.data.signals:
        values = part.data[name]
        if name not in part.outputs and np.unique(values[np.isfinite(values)]).size > 1:
            inputs[name] = input_correlation(pieces, _pieces(part.data, values))
    known = [name for name, test in inputs.items() if not math.isnan(test.p_value)]
    chosen = sorted(known, key=lambda name: inputs[name].p_value)[:MOST_INPUTS]
    return found + [ResidualPanel(output, name, inputs[name]) for name in known if name in chosen]


def _pieces(record: Record, values: Array) -> Sequence[Array]:
    return [values[rows] for rows in record.independent_pieces]


def _draw_histogram(ax: Axes, part: FittedRecord, output: str) -> None:
    scale, unit = shown_unit(part.data.units.get(output, ""))
    e = scale * part.residual(output)
    e = e[np.isfinite(e)]
    if e.size:
        bins = min(BINS, max(5, math.ceil(math.sqrt(e.size))))
        ax.hist(e, bins=bins, density=True, color=COLORS[0], alpha=0.35)
        spread = float(e.std())
        if spread > 0:
            x = np.linspace(e.min(), e.max(), 200)
            ax.plot(
                x,
                np.exp(-0.5 * ((x - e.mean()) / spread) ** 2) / (spread * math.sqrt(2 * math.pi)),
                color=DARK,
            )
    finish(ax, "Density")
    ax.set_yticks([])
    ax.xaxis.set_major_locator(MaxNLocator(4))
    ax.set_xlabel(f"Residual of {symbol(output)}{f', {plain(unit)}' if unit else ''}", fontsize=11)


def _draw_correlations(ax: Axes, panel: ResidualPanel, test: CorrelationTest) -> None:
    lags = np.arange(1, len(test.correlations) + 1)
    ax.axhspan(-test.bound, test.bound, color="0.5", alpha=0.2, linewidth=0)
    ax.axhline(0, color="0.6", linewidth=0.8)
    ax.vlines(lags, 0, test.correlations, color=COLORS[0], linewidth=1.6)
    ax.plot(lags, test.correlations, ".", color=COLORS[0], markersize=5)
    most = max(float(np.nanmax(np.abs(test.correlations), initial=0.0)), test.bound)
    ax.set_ylim(-1.25 * most, 1.25 * most)
    ax.set_xlim(0, lags[-1] + 1)
    finish(
        ax,
        "Autocorrelation"
        if panel.name == "autocorrelation"
        else f"Correlation with {symbol(panel.name)}",
    )
    ax.set_xlabel("Lag, samples", fontsize=11)
    text = "p < 0.0001" if test.p_value < 1e-4 else f"p = {test.p_value:.2g}"
    ax.set_title(f"{symbol(panel.output)}, {text}", fontsize=10)
