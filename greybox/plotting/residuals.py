"""The residuals of a fitted record: their distribution, and what they are correlated with."""

import math

import numpy as np

from greybox.data.record import Record
from greybox.estimate.fitted_part import FittedRecord
from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import in_greek
from greybox.plotting.figure import GRAY, INK, Figure, Panel, Series, band, rule
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.plotting.signals import chosen, shown_unit
from greybox.statistics.metrics import CorrelationTest, cross_correlation, whiteness
from greybox.validation.comparison import p_text

MOST_INPUTS = 3  # with a panel for each output: the inputs with the clearest correlation


def residuals(fit: Fit, record: int = 0, *, axes: GivenAxes | None = None) -> AxesArray:
    """Draw the residuals of every output of a fitted record.

    A histogram with the normal distribution of the same mean and variance, the autocorrelation,
    and the correlation with inputs. Correlations are over the lag in samples, with the band that
    contains 99 % of them if there is no correlation, and the p-value of all together. For inputs,
    both signals were filtered by the filter that whitens the residuals; of more than three inputs
    those with the smallest p-values are drawn. Constant inputs are omitted. Rows without a time
    have no correlations.

    Parameters
    ----------
    fit : Fit
    record : int
        Number of the record in a fit to several.
    axes : array-like of Axes, optional
        One for each panel, output by output. By default a new figure is made.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.residuals(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For a fit without an estimate or without this record, or a wrong number of axes.
    """
    if not isinstance(fit, Fit):
        raise TypeError(f"cannot draw {fit!r:.80}: give a Fit.")
    part = chosen(fit.records, record, "record")
    if not fit.converged:
        raise ValueError(f"the fit {fit.name!r} has no estimate: {fit.status}.")

    # One row for each output, so that its panels stand side by side.
    figures = residual_figures(part)
    panels = sum(len(figure.panels) for figure in figures)
    return draw(
        figures,
        axes,
        columns=panels // len(part.outputs),
        size=(3.1, 2.4),
        title=part.data.name or fit.name,
        legend=False,
    )


def residual_figures(part: FittedRecord) -> list[Figure]:
    """Return the histogram of the residuals of every output and, in time, their correlations."""
    figures = []
    record = f", {part.data.name}" if part.data.name else ""
    for output in part.outputs:
        figures.append(_histogram(part, output, record))
        tests = _tests(part, output)
        if tests:
            p_values = (f"with {name or 'themselves'} {p_text(t.p_value)}" for name, t in tests)
            figures.append(
                Figure(
                    f"Residuals of {in_greek(output)}{record}",
                    "Lag, samples",
                    [_correlations(output, name, test) for name, test in tests],
                    caption="Band: 99 % of single correlations if there is none. Probability of "
                    f"these correlations by chance: {', '.join(p_values)}.",
                    is_whole=True,
                    limits=(0.0, len(tests[0][1].correlations) + 1.0),
                )
            )

    return figures


def _tests(part: FittedRecord, output: str) -> list[tuple[str, CorrelationTest]]:
    """Return the correlations with the residuals themselves, of the name "", and with inputs."""
    # Without a time, neighboring rows have no order, and a lag means nothing.
    if not part.data.has_time:
        return []
    pieces = _pieces(part.data, part.residual(output))
    inputs = {}
    for name in part.data.signals:
        values = part.data[name]
        # A constant input has no correlation with anything.
        if name not in part.outputs and np.unique(values[np.isfinite(values)]).size > 1:
            test = cross_correlation(pieces, _pieces(part.data, values))
            if not math.isnan(test.p_value):
                inputs[name] = test

    clearest = sorted(inputs, key=lambda name: inputs[name].p_value)[:MOST_INPUTS]
    itself = whiteness(pieces, fitted=part.innovation_parameters(output))
    return [("", itself), *((name, test) for name, test in inputs.items() if name in clearest)]


def _pieces(record: Record, values: Array) -> list[Array]:
    return [values[rows] for rows in record.independent_pieces]


def _histogram(part: FittedRecord, output: str, record: str) -> Figure:
    factor, unit = shown_unit(part.data.units.get(output, ""))
    e = factor * part.residual(output)
    e = e[np.isfinite(e)]
    # The square root of the count is the usual number of bins. With more than 40 their heights
    # would be mostly chance.
    bins = int(np.clip(np.sqrt(e.size), 5, 40))
    density, edges = np.histogram(e, bins, density=bool(e.size))
    steps = np.repeat(density, 2)
    series = [band("", np.repeat(edges, 2)[1:-1], 0 * steps, steps)]
    spread = float(e.std()) if e.size else 0.0
    if spread > 0:
        x = np.linspace(e.min(), e.max(), 200)
        normal = np.exp(-0.5 * ((x - e.mean()) / spread) ** 2) / (spread * math.sqrt(2 * math.pi))
        series.append(Series("normal distribution", "line", x, normal, INK))

    return Figure(
        f"Distribution of the residuals of {in_greek(output)}{record}",
        f"Residual of {in_greek(output)}{f', {unit}' if unit else ''}",
        [Panel("Density", series)],
    )


def _correlations(output: str, name: str, test: CorrelationTest) -> Panel:
    values = test.correlations
    lags = np.arange(1.0, len(values) + 1)
    bound = np.full(lags.size, test.bound)
    # The band is always visible, however small the correlations are.
    most = 1.25 * max(float(np.nanmax(np.abs(values), initial=0.0)), test.bound)
    series = [
        Series("99 % band", "band", lags, -bound, GRAY, low=-bound, high=bound),
        rule(),
        Series("", "points", lags, values, low=np.minimum(values, 0), high=np.maximum(values, 0)),
    ]
    label = f"Correlation with {in_greek(name)}" if name else "Autocorrelation"
    title = f"{in_greek(output)}, {p_text(test.p_value)}"
    return Panel(label, series, height=0.7, limits=(-most, most), title=title)
