"""From a log file to a `Record`.

Begin with `readers` (`read`: one format a file), then `prepare` (signals of several messages on one time base).
`segment_detection` finds the tests in a log, `sine_detection` sines and sweeps in one signal; `ardupilot` holds what
that flight controller does to signals and tests.
"""

from greybox.logs.prepare import horizontal_velocity as horizontal_velocity
from greybox.logs.prepare import negative as negative
from greybox.logs.prepare import prepare as prepare
from greybox.logs.readers import read as read
from greybox.logs.segment_detection import find_segments as find_segments
