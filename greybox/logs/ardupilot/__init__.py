"""What ArduPilot does to signals and tests, with its parameters from the log.

`signals` names the controls, sensors and setpoints of an axis, and the axes of System
Identification mode; `filters` has the filters of the gyro and of the rate controllers. `loop_rate`
says what a log of every second pass of the control loop costs, `motors` how finely a control
reaches the motors, and when these are at their limits; `truncated_angles` adds what the log cuts
off.
"""

from greybox.logs.ardupilot.filters import named_filters as named_filters
from greybox.logs.ardupilot.filters import passed_filters as passed_filters
from greybox.logs.ardupilot.signals import ATTITUDE_SETPOINTS as ATTITUDE_SETPOINTS
from greybox.logs.ardupilot.signals import AXES as AXES
from greybox.logs.ardupilot.signals import SYSTEMID_AXES as SYSTEMID_AXES
from greybox.logs.ardupilot.signals import SYSTEMID_DELAY as SYSTEMID_DELAY
