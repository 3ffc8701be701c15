"""What ArduPilot does to signals and tests: System Identification mode, filters before the log, names of setpoints."""

import math
from dataclasses import dataclass

from greybox.data.record import Recording

# SID_AXIS from 1, https://ardupilot.org/copter/docs/parameters.html
SYSTEMID_AXES = (
    "input roll,input pitch,input yaw,recovery roll,recovery pitch,recovery yaw,rate roll,rate pitch,rate yaw,"
    "mixer roll,mixer pitch,mixer yaw,mixer thrust,measured lateral position,measured longitudinal position,"
    "measured lateral velocity,measured longitudinal velocity,input lateral velocity,input longitudinal velocity"
).split(",")

SYSTEMID_DELAY = 1.0  # s, SYSTEM_ID_DELAY: the waveform starts this long after the mode (ArduCopter/mode_systemid.cpp)

ATTITUDE_SETPOINTS = ("ATT.DesRoll", "ATT.DesPitch", "ATT.DesYaw")

# Fields that are logged behind the gyro's low-pass filter, INS_GYRO_FILTER.
GYRO_RATES = {
    "RATE": ("R", "P", "Y"),
    "IMU": ("GyrX", "GyrY", "GyrZ"),
    "PIDR": ("Act",),
    "PIDP": ("Act",),
    "PIDY": ("Act",),
}


@dataclass(frozen=True)
class AxisSignals:
    """The signals of one axis, the best first: control, angles, rates, setpoints, and terms of its controllers."""

    control: str
    angles: tuple[str, ...]
    rates: tuple[str, ...]
    setpoints: tuple[str, ...]
    terms: tuple[str, ...]
    names: tuple[str, str]  # of angle and rate in models


# Messages ATT, ANG, RATE and PID*, https://ardupilot.org/copter/docs/logmessages.html
AXES = {
    axis: AxisSignals(
        control=f"RATE.{short}Out",
        angles=(f"ATT.{word}", f"ANG.{word}"),
        rates=(f"RATE.{short}", f"PID{short}.Act", f"IMU.Gyr{gyro}"),
        setpoints=(f"ATT.Des{word}", f"ANG.Des{word}", f"RATE.{short}Des"),
        terms=(f"PID{short}.Tar", f"PID{short}.P"),
        names=names,
    )
    for axis, short, word, gyro, names in (
        ("roll", "R", "Roll", "X", ("phi", "p")),
        ("pitch", "P", "Pitch", "Y", ("theta", "q")),
        ("yaw", "Y", "Yaw", "Z", ("psi", "r")),
    )
}


def axis_of(signal: str) -> str:
    """Return the axis whose control or setpoint a signal is: "roll", "pitch" or "yaw"; empty for others."""
    return next((axis for axis, own in AXES.items() if signal in (own.control, *own.setpoints, *own.terms)), "")


@dataclass(frozen=True)
class SecondOrderLowPass:
    """A second-order low-pass filter that a signal has passed: cutoff in Hz, damping, and its sampling rate if digital.

    `greybox.models.filters` has the model of it.
    """

    cutoff: float
    damping: float = math.sqrt(0.5)
    rate: float | None = None


def gyro_filter(recording: Recording, signal: str) -> SecondOrderLowPass | None:
    """Return the filter that the gyro's rates have passed before they were logged, if `signal` is one and it is known.

    Parameters
    ----------
    recording : Recording
        With the parameters of the vehicle.
    signal : str
        ``"RATE.P"``, ``"IMU[0].GyrY"`` ...
    """
    cutoff = recording.metadata.get("parameters", {}).get("INS_GYRO_FILTER")
    message, _, field = signal.rpartition(".")
    if cutoff and field in GYRO_RATES.get(message.partition("[")[0], ()):
        return SecondOrderLowPass(float(cutoff))
    return None
