"""One figure of a whole fit, composed of the other diagrams."""

from matplotlib.figure import Figure, SubFigure

from greybox.estimate.result import Fit
from greybox.plotting.bode import bode_axes, bode_panels, draw_bode
from greybox.plotting.nyquist import (
    add_title,
    draw_nyquist,
    grid,
    number_points,
    panel_axes,
    panels,
)
from greybox.plotting.response_series import (
    ResponseSeries,
    error_series,
    legend_entries,
    response_series,
    title,
)
from greybox.plotting.spectrum import (
    as_drawn,
    draw_spectrum,
    spectrum_axes,
    spectrum_height,
    spectrum_legend,
)
from greybox.plotting.starts import draw_starts
from greybox.plotting.style import TITLE_SIZE, legend_below, new_figure, plain
from greybox.plotting.time_history import (
    WIDTH,
    draw_history,
    histories,
    history_axes,
    history_height,
    history_legend,
)

BODE_WIDTH = 6.2  # inches
STARTS_HEIGHT = 3.4  # inches
LEVEL = 0.95  # of the bands, as in the diagrams alone


def plot(fit: Fit) -> Figure:
    """Draw an overview of a fit: of responses the Nyquist diagram, the Bode diagram and the starts.

    Of records their time histories and the starts, of manoeuvres their spectra and the starts;
    where the data are several of these, side by side.

    Returns
    -------
    Figure
        Not axes, as from the other functions, since it arranges several diagrams. It is not known
        to pyplot: show it as the last line of a notebook cell, or save it with ``savefig``.
    """
    return _plot_records(fit) if fit.records or fit.spectra else _plot_responses(fit)


def _plot_records(fit: Fit) -> Figure:
    """Draw records and manoeuvres and the starts below one another, and Bode diagrams to their right."""
    drawn = [histories((fit,), k) for k in range(len(fit.records))]
    spectra = [as_drawn(fit, k) for k in range(len(fit.spectra))]
    heights = [*map(history_height, drawn), *map(spectrum_height, spectra), STARTS_HEIGHT]
    widths = (WIDTH, BODE_WIDTH) if fit.responses else (WIDTH,)
    figure = new_figure(sum(widths), sum(heights) + 0.4)
    figure.suptitle(title((fit,)), fontsize=13)

    columns = figure.subfigures(1, len(widths), width_ratios=widths, squeeze=False)[0]
    rows = columns[0].subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for row, spectrum in zip(rows[len(drawn) :], spectra, strict=False):
        axes = spectrum_axes(row, spectrum)
        draw_spectrum(axes, spectrum)
        row.align_ylabels(axes)
        legend_below(row, spectrum_legend(spectrum))
    for row, part, history in zip(rows, fit.records, drawn, strict=False):
        axes = history_axes(row, history)
        draw_history(axes, history)
        row.align_ylabels(axes)
        legend_below(row, history_legend(history))
        axes[0].set_title(plain(part.name) if len(fit.records) > 1 else "", fontsize=TITLE_SIZE)
    legend_below(rows[-1], draw_starts(rows[-1].subplots(), fit))

    for column in columns[1:]:
        _add_bode(column, fit, response_series((fit,), (), LEVEL))
    return figure


def _plot_responses(fit: Fit) -> Figure:
    series = response_series((fit,), (), LEVEL)
    groups = panels(series)
    rows, columns = grid(len(groups))
    width = 2.8 + 3.4 * columns  # of the Nyquist diagram, inches
    height = 1.8 + 3.4 * rows

    figure = new_figure(width + BODE_WIDTH, height + STARTS_HEIGHT)
    figure.suptitle(title((fit,)), fontsize=13)
    left, right = figure.subfigures(
        1, 2, wspace=0.03, width_ratios=(width, BODE_WIDTH), squeeze=False
    )[0]
    top, bottom = left.subfigures(2, 1, height_ratios=(height, STARTS_HEIGHT), squeeze=False)[:, 0]

    drawn = panel_axes(top, len(groups))
    draw_nyquist(drawn, groups, LEVEL)
    add_title(top, drawn, "Nyquist diagram")
    legend_below(top, legend_entries(series))

    _add_bode(right, fit, series)
    legend_below(bottom, draw_starts(bottom.subplots(), fit))
    number_points(drawn, groups)  # last, when all places on the page are known
    return figure


def _add_bode(part: SubFigure, fit: Fit, series: list[ResponseSeries]) -> None:
    errors = error_series((fit,), series)
    names = bode_panels(series, errors)
    axes = bode_axes(part, names)
    draw_bode(axes, names, series, errors, "Bode diagram")
    part.align_ylabels(axes)
    legend_below(part, legend_entries(series))
