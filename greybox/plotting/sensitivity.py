"""The data that inform on each parameter."""

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.text_table import in_greek
from greybox.plotting.figure import GRAY, Figure, Panel, Series
from greybox.plotting.matplotlib_figure import AxesArray, GivenAxes, draw


def sensitivity(
    fit: Fit, part: int = 0, *, axes: GivenAxes | None = None, legend: bool = True
) -> AxesArray:
    """Draw the information of each frequency, or each time of a record, on each free parameter.

    In percent of the information in all data of the fit: in color with the other parameters
    estimated too, one color for each output; in gray with the others known, all outputs together.
    Where gray is high and color is low, another parameter has the same effect. `Fit.sensitivity`
    has the numbers.

    Parameters
    ----------
    fit : Fit
    part : int
        Number of the part of the fit.
    axes : array-like of Axes, optional
        One for each free parameter. By default a new figure is made.
    legend : bool
        Draw a legend, below a new figure or in the first of the given axes.

    Returns
    -------
    numpy.ndarray of Axes, shape (p,)
        In a notebook, ``gb.plotting.sensitivity(fit)[0].figure`` shows the figure.

    Raises
    ------
    TypeError, ValueError
        For a fit without an estimate or standard errors, or a wrong number of axes.
    """
    if not isinstance(fit, Fit):
        raise TypeError(f"cannot draw {fit!r:.80}: give a Fit.")
    return draw(information_figure(fit, part), axes, legend=legend, width=7.0)


def information_figure(fit: Fit, part: int) -> Figure:
    """Return the information of each point of one part on every free parameter.

    Raises
    ------
    ValueError
        If the fit has no estimate or no standard errors.
    """
    information = fit.sensitivity(part)
    at = information.at
    panels = []
    for k, name in enumerate(information.names):
        alone = 100 * information.alone[k].sum(axis=0)
        series = [Series("others known", "line", at, alone, GRAY, width=1.2)]
        for color, output in enumerate(information.outputs):
            shares = 100 * information.shares[k, color]
            label = f"{in_greek(output)}, others estimated"
            series.append(Series(label, "line", at, shares, color, width=1.4))
        most = max(float(np.nanmax(line.y, initial=0.0)) for line in series)
        is_unknown = np.isnan(information.shares[k]).all()
        title = "not determined" if is_unknown else ""
        limits = (0.0, 1.1 * most or 1.0)
        panels.append(Panel(f"{in_greek(name)}, %", series, 0.46, limits=limits, title=title))

    is_frequency = information.unit == "rad/s"
    name = fit.parts[part].data.name or fit.parts[part].name
    return Figure(
        f"Information on each parameter{f', {name}' if name else ''}",
        {"rad/s": "ω, rad/s", "s": "Time, s", "row": "Row"}[information.unit],
        panels,
        subject=fit.parts[part].name,
        caption="Share of the information in all data of the fit, by point or by part of the record.",
        is_logarithmic=is_frequency and bool(at[-1] > 5 * at[0]),
        is_wide=not is_frequency,
    )
