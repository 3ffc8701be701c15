"""Every figure as a value, and its drawing by matplotlib.

Begin with `overview`, which draws a whole fit.

A function that draws one panel takes ``ax=None`` and returns the matplotlib Axes. One that draws
several takes ``axes=None``, an array-like of as many Axes as it has panels, and returns them as a
numpy array (n,) of Axes. Without axes it makes a figure of its own, which is ``ax.figure``. pyplot
does not know that figure: show it as the last line of a notebook cell
(``gb.plotting.bode(fit)[0].figure``), or save it with ``savefig``. With axes it draws into these
alone, with the legend inside. `plot` composes several diagrams and returns the Figure.

| file | contents |
| --- | --- |
| `figure` | a figure as a value: panels with series; every diagram below returns one |
| `matplotlib_figure` | draws such a value; the page of a report draws the same values |
| `bode`, `nyquist` | diagrams of frequency responses |
| `responses` | the curves and points in them: names, colors, bands |
| `starts` | the cost that each start reached, and where it ended |
| `time_history`, `residuals` | fitted and predicted records |
| `spectrum` | transforms of manoeuvres |
| `profile` | profiles of the likelihood |
| `pairs` | draws and replicates: histograms, scatters and correlations |
| `loops` | the loop of margins, with bands |
| `gains` | safe gains, and the loop with proposed gains beside today's |
| `study` | members of a study, or several fits: trends, estimates, costs, maps of structures |
| `flight_log` | logs and their tests |
| `signals` | units, symbols and labels |
| `long_lines` | draws no more points than can be seen |
| `overview` | one figure of a whole fit |
"""

from greybox.reporting.plotting.bode import bode as bode
from greybox.reporting.plotting.flight_log import recording as recording, traces as traces
from greybox.reporting.plotting.gains import gains as gains
from greybox.reporting.plotting.loops import loop as loop
from greybox.reporting.plotting.nyquist import nyquist as nyquist
from greybox.reporting.plotting.overview import plot as plot
from greybox.reporting.plotting.pairs import pairs as pairs
from greybox.reporting.plotting.profile import profiles as profiles
from greybox.reporting.plotting.residuals import residuals as residuals
from greybox.reporting.plotting.spectrum import spectrum as spectrum
from greybox.reporting.plotting.starts import starts as starts
from greybox.reporting.plotting.study import (
    estimates as estimates,
    structures as structures,
    trend as trend,
)
from greybox.reporting.plotting.time_history import time_history as time_history
