"""Open or closed loop: what a log shows of a controller.

In a loop u = C (r - y), y = P u + v, the direct estimate S_uy / S_uu tends to P where r dominates,
and to -1/C where the noise v does, whatever the coherence of u and y. The joint input-output
estimate S_ry / S_ru has no such bias, because r is independent of v.

Source: Tischler and Remple, Aircraft and Rotorcraft System Identification, 2nd ed., section 5.7;
Ljung (1999), System Identification, 2nd ed., section 13.4.
"""

from collections.abc import Sequence
from itertools import chain

from greybox.data.logs.flight_controllers import AXES, axis_of
from greybox.data.logs.segment_detection import SETPOINTS, present
from greybox.data.record import Recording

# Messages and columns that only a controller's log has, whatever the axis; of PX4 and of MAVLink.
CONTROLLER_MESSAGES = (
    "vehicle_attitude_setpoint",
    "vehicle_rates_setpoint",
    "ATTITUDE_TARGET",
    "PID_TUNING",
)


def loop_text(controller: str) -> str:
    """Return whether the loop was closed, and what in the log shows it."""
    if controller:
        return f"closed loop ({controller} is in the log)"
    return "open loop (the log shows no controller)"


def controller_in(recording: Recording, controls: Sequence[str], measured: Sequence[str]) -> str:
    """Return the signal or message that shows a controller of the axis; empty without one.

    A signal that is `measured` as an output is not a setpoint: a column r may be a setpoint or a
    yaw rate.
    """
    axes = [axis_of(control) for control in controls]
    for names in chain.from_iterable([AXES[axis]] if axis else AXES.values() for axis in axes):
        signals = [s for s in (*names.setpoints, *names.terms) if s not in measured]
        if logged := present(recording, signals):
            return logged[0]
    # In a table, a setpoint is a column; in a log of messages, r may be anything.
    columns = [name for name in present(recording, SETPOINTS) if "." not in name]
    shown = [*filter(recording.records.__contains__, CONTROLLER_MESSAGES), *columns]
    return next((name for name in shown if name not in measured), "")
