"""When a sensor was sampled, where a log has this time beside that of the message.

A message is written a little later than its sensor is read. In a response that delay counts for the
vehicle. So samples have their own times. The messages of a controller keep theirs: the stamp of
the sample in them is that of the measurement to which the controller responds, and is earlier than
the output.

Sources: `timestamp_sample` in the message definitions of PX4, https://docs.px4.io/main/en/msg_docs/;
SampleUS of ACC and GYR in https://ardupilot.org/copter/docs/logmessages.html.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.logs.readers.controller_outputs import is_of_controller
from greybox.data.logs.readers.messages import Messages

# Columns of these times, in µs on the clock of the messages.
SAMPLED = ("timestamp_sample", "SampleUS")

# s, largest delay of a message. Estimators of PX4 use samples of up to half a second ago; a stamp
# that was never set is zero, and one of another clock is anywhere.
LONGEST = 1.0


def at_sample_times(groups: Iterable[Messages]) -> list[Messages]:
    """Return the messages, those of sensors at the times when these were sampled."""
    return [_at_sample_times(group) for group in groups]


def _at_sample_times(group: Messages) -> Messages:
    name = next((name for name in SAMPLED if name in group.columns), "")
    if not name or group.time is None or is_of_controller(group):
        return group
    sampled = group.columns[name] / 1e6
    delay = group.time - sampled
    are_times = np.all((delay >= 0) & (delay < LONGEST)) and _are_different(group, sampled)
    return replace(group, time=sampled) if are_times else group


def _are_different(group: Messages, times: Array) -> bool:
    """Return whether the times (n,) of each sender increase from message to message."""
    senders = {**group.columns, **group.texts}.get(group.instance, np.zeros(times.size))
    values = np.asarray(senders)
    return all(np.all(np.diff(times[values == value]) > 0) for value in np.unique(values))
