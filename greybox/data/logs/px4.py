"""PX4: the signals of an axis, and the filters of the gyro.

Sources: the topics at https://docs.px4.io/main/en/msg_docs/; IMU_GYRO_CUTOFF, IMU_GYRO_NF0_FRQ,
IMU_GYRO_NF0_BW and IMU_DGYRO_CUTOFF at
https://docs.px4.io/main/en/advanced_config/parameter_reference; LowPassFilter2p.hpp and
NotchFilter.hpp of the firmware, for what they mean.
"""

from greybox.data.logs.axis_signals import AxisSignals
from greybox.data.logs.known_filters import KnownFilters, LowPass, Notch
from greybox.data.record import Recording

FILTERED = ("vehicle_angular_velocity",)  # topics behind the filters of the gyro

# Torque setpoints are from version 1.13 on, actuator controls before. Angles are those that the
# reader computes from quaternions.
AXES = {
    axis: AxisSignals(
        controls=(f"vehicle_torque_setpoint.xyz[{k}]", f"actuator_controls_0.control[{k}]"),
        angles=(f"vehicle_attitude.{axis}",),
        rates=(f"vehicle_angular_velocity.xyz[{k}]", f"vehicle_attitude.{axis}speed"),
        setpoints=(
            f"vehicle_attitude_setpoint.{axis}",
            f"vehicle_attitude_setpoint.{axis}_body",
            f"vehicle_rates_setpoint.{axis}",
        ),
        terms=(f"rate_ctrl_status.{axis}speed_integ",),
        sticks=(f"manual_control_setpoint.{axis}", f"manual_control_setpoint.{'yxr'[k]}"),
    )
    for k, axis in enumerate(("roll", "pitch", "yaw"))
}


def named_filters(recording: Recording) -> KnownFilters:
    """Return the filters of the gyro whose parameters are known, by name."""
    parameters = recording.parameters
    low_passes = {"gyro-filter": "IMU_GYRO_CUTOFF", "d-term-filter": "IMU_DGYRO_CUTOFF"}
    filters: KnownFilters = {
        name: (LowPass(parameters[key]),)
        for name, key in low_passes.items()
        if parameters.get(key, 0) > 0
    }
    # Two static notches, each with a center and a width.
    pairs = [
        (parameters.get(f"IMU_GYRO_NF{k}_FRQ", 0), parameters.get(f"IMU_GYRO_NF{k}_BW", 0))
        for k in (0, 1)
    ]
    # A notch of PX4 leaves nothing at its center: 200 dB.
    notches = tuple(
        Notch(center, center / width, 200.0) for center, width in pairs if center > 0 < width
    )

    return filters | ({"gyro-notch": notches} if notches else {})
