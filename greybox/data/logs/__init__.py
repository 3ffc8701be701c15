"""From a log file to a `Record`.

Begin with `readers`, then `prepare`.

| file | contents |
| --- | --- |
| `readers` | one reader for each format of log files |
| `prepare` | signals of several messages on one time base, in SI units |
| `segment_detection` | tests in a log: System Identification mode, and sines |
| `sine_detection` | sines and sweeps in one signal |
| `manoeuvre_detection` | doublets, 2-1-1 and other inputs |
| `named_columns` | columns of a table under the names that the user gives them |
| `injected_tests` | tests that Betaflight and PX4 inject themselves |
| `flight_controllers` | signals of an axis and filters, for all flight controllers together |
| `ardupilot`, `px4`, `betaflight` | the same for each flight controller |
| `loop_rate` | errors of a log that has only some passes of the control loop |
| `axis_signals` | the signals of one axis |
| `known_filters` | filters with known parameters |
| `parameter_history` | changes of parameters in a log |
"""

from greybox.data.logs.manoeuvre_detection import find_manoeuvres as find_manoeuvres
from greybox.data.logs.prepare import horizontal_velocity as horizontal_velocity, prepare as prepare
from greybox.data.logs.readers import read as read
from greybox.data.logs.segment_detection import find_segments as find_segments
