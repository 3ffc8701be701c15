"""From a log file to a `Record`.

Begin with `readers` (`read`: one format a file), then `prepare` (signals of several messages on one
time base). `segment_detection` finds the tests in a log, `sine_detection` sines and sweeps in one
signal, `manoeuvre_detection` doublets, 2-1-1 and other inputs. What flight controllers do to
signals and tests is in `ardupilot` and `px4`, and for both together in `flight_controllers`;
`axis_signals` and `known_filters` are the values that they give. `named_columns` says what the
columns of somebody's table are.
"""

from greybox.logs.manoeuvre_detection import find_manoeuvres as find_manoeuvres
from greybox.logs.prepare import horizontal_velocity as horizontal_velocity
from greybox.logs.prepare import negative as negative
from greybox.logs.prepare import prepare as prepare
from greybox.logs.readers import read as read
from greybox.logs.segment_detection import find_segments as find_segments
