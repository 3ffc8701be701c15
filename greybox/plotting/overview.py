"""One figure of a whole fit, composed of the other diagrams."""

from dataclasses import replace

from matplotlib.figure import Figure as MatplotlibFigure

from greybox.estimate.result import Fit
from greybox.plotting.bode import bode_figure
from greybox.plotting.figure import Figure
from greybox.plotting.matplotlib_figure import (
    draw_into,
    draw_panels,
    grid,
    height_of,
    legend_below,
    new_figure,
    plain,
)
from greybox.plotting.nyquist import nyquist_figures, rows_and_columns
from greybox.plotting.point_numbers import number_points
from greybox.plotting.responses import title
from greybox.plotting.spectrum import spectrum_figure
from greybox.plotting.starts import starts_figure
from greybox.plotting.time_history import history_figure

BODE_WIDTH = 6.2  # inches


def plot(fit: Fit) -> MatplotlibFigure:
    """Draw an overview of a fit.

    Nyquist and Bode diagram of responses, time histories of records, spectra of manoeuvres, and
    the starts.

    Returns
    -------
    Figure
        Not axes, as from the other functions, since it arranges several diagrams. pyplot does not
        know it: show it as the last line of a notebook cell, or save it with ``savefig``.
    """
    return _plot_records(fit) if fit.records or fit.spectra else _plot_responses(fit)


def _plot_records(fit: Fit) -> MatplotlibFigure:
    """Draw records, manoeuvres and starts below one another, and a Bode diagram to their right."""
    histories = [history_figure((fit,), k) for k in range(len(fit.records))]
    spectra = [spectrum_figure(fit, k) for k in range(len(fit.spectra))]
    if len(histories) == 1:
        histories = [replace(histories[0], subject="Time history")]
    diagrams = [*histories, *spectra, starts_figure(fit)]
    heights = [height_of(figure, 2.0) for figure in diagrams]
    widths = (9.5, BODE_WIDTH) if fit.responses else (9.5,)

    page = new_figure(sum(widths), sum(heights) + 0.4)
    page.suptitle(plain(title((fit,))), fontsize=13)
    columns = page.subfigures(1, len(widths), width_ratios=widths, squeeze=False)[0]
    rows = columns[0].subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for row, figure in zip(rows, diagrams, strict=True):
        draw_into(row, figure)
    for column in columns[1:]:
        draw_into(column, _bode(fit))
    return page


def _plot_responses(fit: Fit) -> MatplotlibFigure:
    figures = nyquist_figures((fit,))
    starts = starts_figure(fit)
    rows, columns = rows_and_columns(len(figures))
    widths = (2.8 + 3.4 * columns, BODE_WIDTH)
    heights = (1.8 + 3.4 * rows, height_of(starts, 1.9))

    page = new_figure(sum(widths), sum(heights))
    page.suptitle(plain(title((fit,))), fontsize=13)
    sides = page.subfigures(1, 2, wspace=0.03, width_ratios=widths, squeeze=False)[0]
    top, bottom = sides[0].subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]

    drawn = grid(top, len(figures), columns)
    for ax, figure in zip(drawn, figures, strict=True):
        draw_panels([ax], figure)
    top.suptitle("Nyquist diagram", fontsize=12)
    legend_below(top, figures)
    draw_into(sides[1], _bode(fit))
    draw_into(bottom, starts)
    number_points(drawn, figures)  # last, when the layout of the page is known
    return page


def _bode(fit: Fit) -> Figure:
    return replace(bode_figure((fit,)), subject="Bode diagram")
