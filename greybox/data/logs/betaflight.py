"""Betaflight: the signals of an axis, as the reader of its blackbox names them."""

from greybox.data.logs.axis_signals import AxisSignals

# The unfiltered gyro is not behind the filters of the flight controller.
AXES = {
    axis: AxisSignals(
        controls=(f"axisSum[{k}]",),
        angles=(),
        rates=(f"gyroUnfilt[{k}]", f"gyroADC[{k}]"),
        setpoints=(f"setpoint[{k}]",),
        terms=tuple(f"axis{term}[{k}]" for term in "PIDF"),
        sticks=(f"rcCommand[{k}]",),
    )
    for k, axis in enumerate(("roll", "pitch", "yaw"))
}
