"""One figure of a whole fit, composed of the other diagrams."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

from matplotlib.figure import Figure as MatplotlibFigure

from greybox.assessment.result import Fit
from greybox.data.files.public import public
from greybox.data.frequency_response import FrequencyResponse
from greybox.reporting.plotting.bode import bode_figures
from greybox.reporting.plotting.figure import Figure, require_drawable
from greybox.reporting.plotting.matplotlib_figure import draw_into, height_of, new_figure
from greybox.reporting.plotting.nyquist import columns_of, nyquist_figures
from greybox.reporting.plotting.responses import title
from greybox.reporting.plotting.spectrum import spectrum_figure
from greybox.reporting.plotting.starts import starts_figure
from greybox.reporting.plotting.time_history import history_figure


@public
def plot(fit: Fit, *, hz: bool = False) -> MatplotlibFigure:
    """Draw an overview of a fit.

    Nyquist and Bode diagram of responses, time histories of records, spectra of manoeuvres, and
    the starts.

    Parameters
    ----------
    fit : Fit
    hz : bool
        Frequencies in Hz instead of rad/s.

    Returns
    -------
    Figure
        Not axes, as from the other functions, since it arranges several diagrams. pyplot does not
        know it: show it as the last line of a notebook cell, or save it with ``savefig``.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> figure = gb.plot(gb.fit(pitch_hover.problem(), starts=20))  # figure.savefig("pitch.png")
    """
    require_drawable(fit, Fit, "a Fit")
    bode = bode_figures((fit,)) if fit.responses else []
    # Nobody could read one Bode diagram of many pairs, and one for each would fill the page.
    is_many = len(bode) > 1
    # The complex plane needs a square. With time histories there is no room for it.
    nyquist = [] if (fit.records or fit.spectra) and not is_many else nyquist_figures((fit,))
    blocks = [[history_figure((fit,), k)] for k in range(len(fit.records))]
    blocks += [[spectrum_figure(fit, k)] for k in range(len(fit.spectra))]
    blocks.append([starts_figure(fit)])

    columns = columns_of(len(nyquist))
    width = 2.8 + 3.4 * columns if nyquist else 9.5
    # The Bode diagram has two to five stacked panels, as high as all others together.
    widths = (width, 6.2) if len(bode) == 1 else (width,)  # inches
    heights = [height_of(block, 2.0) for block in blocks]
    if nyquist:
        blocks.insert(0, nyquist)
        heights.insert(0, height_of(nyquist, 4.1, columns))

    page = new_figure(sum(widths), sum(heights) + 0.4, title((fit,)))
    sides = page.subfigures(1, len(widths), width_ratios=widths, squeeze=False)[0]
    rows = sides[0].subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    if len(bode) == 1:
        rows = [*rows, sides[1]]
        blocks.append([replace(bode[0], subject="Bode diagram")])
    for row, block in zip(rows, blocks, strict=True):
        draw_into(row, block, columns, hz=hz)
    return page


def response_figures(
    fits: Sequence[Fit | FrequencyResponse], labels: Sequence[str] = ()
) -> list[Figure]:
    """Return Bode and Nyquist diagrams; those of one pair next to each other if there are many."""
    sides = zip_longest(bode_figures(fits, labels), nyquist_figures(fits, labels))
    return [figure for pair in sides for figure in pair if figure]
