"""Figures: frequency responses, time histories, starts, flight logs. Begin with `overview`, which draws a whole fit.

A function that draws one panel takes ``ax=None`` and returns the matplotlib Axes. One that draws
several takes ``axes=None``, an array-like of as many Axes as it has panels, and returns them as a
numpy array (n,) of Axes. Without axes it makes a figure of its own, which is ``ax.figure``; pyplot
does not know it: show it as the last line of a notebook cell (``gb.plotting.bode(fit)[0].figure``),
or save it with ``savefig``. With axes it draws into these alone and leaves the rest of their figure
as it is: the legend stands inside, and ``legend=False`` leaves it out. `plot` composes several
diagrams and returns the Figure.

`nyquist`, `bode` and `starts` are one diagram each, `profile` draws a panel for each profiled
quantity, `sensitivity` one for each parameter with what tells of it, `orders` the structures of an
order selection; `response_series` collects the points and curves of the first two,
`response_matrix` draws those of several inputs and outputs. `time_history` draws fitted and
predicted records, `residuals` what is left of fitted ones, `spectrum` the transforms of manoeuvres,
`flight_log` logs and their tests, `measured_test` what was measured from a log, `vibration` spectra
of its IMU; `long_lines` draws no more points than can be seen. `overview` composes them into one
figure, `style` holds colors, legends and the frame of a diagram.
"""

from greybox.plotting.bode import bode as bode
from greybox.plotting.flight_log import recording as recording
from greybox.plotting.flight_log import traces as traces
from greybox.plotting.measured_test import demodulated as demodulated
from greybox.plotting.measured_test import measurement as measurement
from greybox.plotting.measured_test import spectrogram as spectrogram
from greybox.plotting.nyquist import nyquist as nyquist
from greybox.plotting.orders import orders as orders
from greybox.plotting.overview import plot as plot
from greybox.plotting.profile import contour as contour
from greybox.plotting.profile import profiles as profiles
from greybox.plotting.residuals import residuals as residuals
from greybox.plotting.response_matrix import response_matrix as response_matrix
from greybox.plotting.sensitivity import sensitivity as sensitivity
from greybox.plotting.spectrum import spectrum as spectrum
from greybox.plotting.starts import starts as starts
from greybox.plotting.time_history import time_history as time_history
from greybox.plotting.vibration import vibration as vibration
