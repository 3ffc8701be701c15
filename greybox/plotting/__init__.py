"""Figures; each function takes axes and returns them.

Begin with `figures`, which draws frequency responses and starts; `nyquist` holds the Nyquist diagram, `time_history`
draws records, `flight_log` logs and their tests. `style` holds colors, fonts and legends.
"""

from greybox.plotting.figures import plot as plot
from greybox.plotting.figures import plot_bode as bode
from greybox.plotting.figures import plot_nyquist as nyquist
from greybox.plotting.figures import plot_starts as starts
from greybox.plotting.flight_log import plot_recording as recording
from greybox.plotting.flight_log import plot_traces as traces
from greybox.plotting.time_history import plot_history as time_history
