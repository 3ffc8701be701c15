"""Signals of an axis, and filters that a log names, for all flight controllers together."""

from greybox.data.logs.ardupilot import filters as of_ardupilot
from greybox.data.logs.ardupilot.signals import AXES as ARDUPILOT_AXES
from greybox.data.logs.axis_signals import AxisSignals
from greybox.data.logs.betaflight import AXES as BETAFLIGHT_AXES
from greybox.data.logs.known_filters import KnownFilter, KnownFilters
from greybox.data.logs.px4 import AXES as PX4_AXES, FILTERED, named_filters as px4_filters
from greybox.data.record import Recording

CONTROLLERS = (ARDUPILOT_AXES, PX4_AXES, BETAFLIGHT_AXES)
AXES = {
    axis: AxisSignals(
        *(
            sum((getattr(axes[axis], kind) for axes in CONTROLLERS), ())
            for kind in AxisSignals.__match_args__
        )
    )
    for axis in ARDUPILOT_AXES
}


def axis_of(signal: str) -> str:
    """Return the axis of a control or setpoint, "roll", "pitch" or "yaw", or nothing."""
    return next(
        (
            axis
            for axis, signals in AXES.items()
            if signal in (*signals.controls, *signals.setpoints, *signals.terms)
        ),
        "",
    )


def passed_filters(recording: Recording, signal: str) -> tuple[KnownFilter, ...]:
    """Return the filters that a signal passed before it was logged, in their order."""
    message, _, field = signal.rpartition(".")
    # All instances of a message, IMU[0] and IMU[1], have the same fields.
    message = message.partition("[")[0]
    if message not in FILTERED and field not in of_ardupilot.GYRO_RATES.get(message, ()):
        return ()
    filters = named_filters(recording)
    return (*filters.get("gyro-notch", ()), *filters.get("gyro-filter", ()))


def named_filters(recording: Recording, axis: str = "") -> KnownFilters:
    """Return the filters whose parameters the log has by name, such as ``gyro-filter``."""
    return px4_filters(recording) | of_ardupilot.named_filters(recording, axis)
