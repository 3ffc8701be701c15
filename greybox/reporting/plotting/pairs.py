"""Parameter sets in pairs: histograms, scatters and correlations of draws or replicates."""

from collections.abc import Mapping

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.public import public
from greybox.reporting.plotting.figure import Figure, Panel, Series, band, require_drawable
from greybox.reporting.plotting.matplotlib_figure import AxesArray, GivenAxes, draw


@public
def pairs(columns: Mapping[str, Array], axes: GivenAxes | None = None) -> AxesArray:
    """Draw histograms of parameters, and each pair of them with its correlation.

    Parameters
    ----------
    columns : mapping of name to (n,) array
        ``gb.draws(fit).columns`` or ``gb.bootstrap(fit).columns``; constants are left out.
    axes : array-like of Axes, optional
        One for each pair, row by row. By default a new figure is made.

    Raises
    ------
    ValueError
        If all columns are constant.

    Returns
    -------
    numpy.ndarray of Axes, shape (k²,)
    """
    # A table of pandas is no Mapping.
    if not hasattr(columns, "items"):
        require_drawable(columns, Mapping, "the columns of gb.draws or gb.bootstrap")
    names = [name for name, column in columns.items() if np.ptp(column) > 0]
    if not names:
        raise ValueError("no column varies: give at least one parameter that was estimated.")
    figures = [_figure(columns, x, y) for y in names for x in names]
    return draw(figures, axes, columns=len(names), size=(2.4, 2.2))


def _figure(columns: Mapping[str, Array], x: str, y: str) -> Figure:
    if x == y:
        counts, edges = np.histogram(columns[x], "auto")
        steps = counts.repeat(2)
        series = band("", edges.repeat(2)[1:-1], 0.0 * steps, steps)
        return Figure("Histogram", x, [Panel("Number", [series])])
    correlation = np.corrcoef(columns[x], columns[y])[0, 1]
    panel = Panel(y, [Series("", "points", columns[x], columns[y])])
    return Figure("Pair", x, [panel], f"correlation {correlation:.2f}")
