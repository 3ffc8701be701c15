"""The residuals of a fitted record: where they are large, and what they are correlated with."""

import math
from collections.abc import Mapping

import numpy as np

from greybox.assessment.fitted_part import FittedRecord
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.greek_letters import in_greek
from greybox.data.files.numbers_in_text import p_text
from greybox.data.files.public import public
from greybox.reporting.plotting.figure import GRAY, Figure, Panel, Series, require_drawable, rule
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw
from greybox.reporting.plotting.signals import chosen, shown_unit, with_unit
from greybox.statistics.correlation_statistics import CorrelationTest, whiteness

PARTS = 10  # of the range of a signal, and of a record


@public
def residuals(
    fit: Fit, record: int = 0, *, axes: GivenAxes | None = None, hz: bool = False
) -> AxesArray:
    """Draw the residuals of every output of a fitted record.

    Their means over time, inputs and the fitted output, their coherence with inputs, and their
    autocorrelation. What the model lacks shows in a part of the record, as a shape over a signal,
    or as coherence at some frequencies. Correlations are over the lag in samples, with the band
    that contains 99 % of them if there is no correlation, and the p-value of all together.
    Constant inputs are omitted. Rows without a time have no coherence and no correlations.

    Parameters
    ----------
    fit : Fit
    record : int
        Number of the record in a fit to several.
    axes : array-like of Axes, optional
        One for each panel, output by output. By default a new figure is made.
    hz : bool
        Frequencies in Hz.

    Returns
    -------
    numpy.ndarray of Axes, shape (n,)
        In a notebook, ``gb.plotting.residuals(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For a fit without an estimate or without this record, or a wrong number of axes.
    """
    require_drawable(fit, Fit, "a Fit")
    part = chosen(fit.records, record, "record")
    fit.require_estimate()

    # One row for each output, so that its panels stand side by side.
    figures = residual_figures(part)
    return draw(
        [*figures, *shape_figures(fit)],
        axes,
        columns=len(figures) // len(part.outputs),
        size=(3.1, 2.4),
        title=part.data.name or fit.name,
        legend=False,
        hz=hz,
    )


def residual_figures(part: FittedRecord) -> list[Figure]:
    """Return the residuals of every output over signals, frequency and, in time, their lag."""
    figures = []
    record = f", {part.data.name}" if part.data.name else ""
    for output in part.outputs:
        # A constant input cannot have caused anything.
        causes = sorted(part.input_names)
        inputs = {name: part.data[name] for name in causes if np.ptp(part.data[name])}
        signals = {"time, s": part.data.time} if part.data.has_time else {}
        signals |= {**inputs, f"fitted {output}": part.simulated[output]}
        figures += [_means(part, output, *signal) for signal in signals.items()]
        # Without a time, neighboring rows have no order, and a lag means nothing.
        if part.data.has_time:
            figures += [_coherence(part, output, inputs)] if inputs else []
            pieces = [part.residual(output)[rows] for rows in part.data.independent_pieces]
            test = whiteness(pieces, fitted=part.innovation_parameters(output))
            figures.append(
                Figure(
                    f"Residuals of {in_greek(output)}{record}",
                    "Lag, samples",
                    [_correlations(output, test)],
                    caption="Band: 99 % of the correlations of white residuals, each by itself.",
                    is_whole=True,
                )
            )

    return figures


def shape_figures(fit: Fit) -> list[Figure]:
    """Return what the model lacks, over the signal that shows it, and the best term."""
    shape = fit.misfit and fit.misfit.shape
    if not shape:
        return []
    # States of which nothing is measured have no unit.
    factor, unit = shown_unit(fit.records[0].data.units, shape.signal)
    x, values, errors = np.array([shape.at, shape.values, shape.errors])
    x *= factor
    points = Series(
        "of any form", "points", x, values, low=values - 2 * errors, high=values + 2 * errors
    )
    line = Series(shape.text, "line", x, np.array(shape.by_term), 1)
    panel = Panel("What is missing", [rule(), line, points], title=shape.text)
    name = in_greek(shape.signal)
    return [
        Figure(
            f"What the model lacks over {name}",
            with_unit(name, unit),
            [panel],
            caption=f"Line: {shape.text}. Points: an effect of any form, with two standard errors. "
            "Both leave out what the parameters explain.",
        )
    ]


def _means(part: FittedRecord, output: str, name: str, values: Array) -> Figure:
    """Return the means of the residuals in parts of the range of a signal."""
    factor, unit = shown_unit(part.data.units, output)
    e = factor * part.residual(output)
    present = np.flatnonzero(np.isfinite(e + values))
    # The same number of samples in every part.
    parts = np.array_split(present[np.argsort(values[present])], PARTS)
    parts = [rows for rows in parts if rows.size]
    x, mean, error = np.array(
        [(values[r].mean(), e[r].mean(), 2 * e[r].std() / math.sqrt(r.size)) for r in parts]
    ).T
    label = with_unit(f"Residual of {in_greek(output)}", unit)
    # A fitted output has the unit of the measured one.
    factor, unit = shown_unit(part.data.units, name.removeprefix("fitted "))
    series = [rule(), Series("", "points", factor * x, mean, low=mean - error, high=mean + error)]
    return Figure(
        f"{label} over {in_greek(name)}",
        with_unit(in_greek(name), unit),
        [Panel(label, series)],
        caption="Means, with two standard errors of white residuals.",
    )


def _coherence(part: FittedRecord, output: str, inputs: Mapping[str, Array]) -> Figure:
    from scipy.signal import coherence  # noqa: PLC0415  (takes a tenth of a second to import)

    piece = max(part.data.stretches(part.input_names), key=len)
    e = np.nan_to_num(part.residual(output)[piece])
    # Half overlapping segments count as so many.
    series = [rule(1 - 0.01 ** (1 / PARTS), "99 % by chance")]
    for color, (name, u) in enumerate(inputs.items()):
        f, values = coherence(
            np.nan_to_num(u[piece]), e, 1 / part.data.step, nperseg=2 * len(e) // PARTS
        )
        series.append(Series(in_greek(name), "line", math.tau * f[1:], values[1:], color))
    return Figure(
        f"Coherence of the residuals of {in_greek(output)} with inputs",
        "Frequency, rad/s",
        [Panel("Coherence", series, limits=(0.0, 1.0))],
        is_logarithmic=True,
    )


def _correlations(output: str, test: CorrelationTest) -> Panel:
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
    title = f"{in_greek(output)}, {p_text(test.p_value)}"
    return Panel("Autocorrelation", series, height=0.7, limits=(-most, most), title=title)
