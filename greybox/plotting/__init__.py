"""Figures; each function takes axes and returns them.

`nyquist` and `figures` draw frequency responses and starts, `time_history` records, `flight_log` logs and their tests.
"""

from greybox.plotting.figures import plot as plot
from greybox.plotting.figures import plot_bode as bode
from greybox.plotting.figures import plot_nyquist as nyquist
from greybox.plotting.figures import plot_starts as starts
from greybox.plotting.flight_log import plot_recording as recording
from greybox.plotting.flight_log import plot_traces as traces
from greybox.plotting.time_history import plot_history as time_history
