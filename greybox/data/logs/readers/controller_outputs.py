"""Finds the signals that a controller holds, and those that are samples of continuous signals.

A flight controller sets its outputs and setpoints once in every pass of its loop, and they keep
their values until the next pass. A thinned log has only some passes: a value then lasted for one
pass, not until the next sample of the log. The period of the loop is a parameter of the vehicle.

Sources: the `LoggerMessage` comments in ArduPilot's LogStructure.h, Log.cpp and AP_SystemID.cpp;
SCHED_LOOP_RATE at https://ardupilot.org/copter/docs/parameters.html; the message definitions of
MAVLink, common.xml; the topics of PX4, https://docs.px4.io/main/en/msg_docs/, and IMU_GYRO_RATEMAX
among its parameters.
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

from greybox.data.clock import median_step
from greybox.data.files.named_values import Values
from greybox.data.intersample import CONTINUOUS, HELD
from greybox.data.logs.readers.messages import Messages

# Message and fields. For fields in neither table, it is unknown.
OUTPUTS = {
    "ATT|ANG": "Des(Roll|Pitch|Yaw)",
    "RATE": "[RPYA](Des|Out)|AOutSlew",
    "PID[RPYASNE]": "Tar|Err|P|I|D|D?FF",
    "RCO[U23]": r"C\d+",
    "MOTB": "LiftMax|ThLimit|ThrAvMx|ThrOut",
    "CTUN": "ABst|ThO|ThH",
    "AETR": ".*",
    "SIDD": "Targ|F",
    "PSC[NED]": "[DT][PVA][NED]",
    "SERVO_OUTPUT_RAW": r"servo\d+_raw",
    "ACTUATOR_CONTROL_TARGET": r"controls\[\d+\]",
    "ATTITUDE_TARGET": r"q\[\d\]|body_(roll|pitch|yaw)_rate|thrust",
    "NAV_CONTROLLER_OUTPUT": "nav_(roll|pitch)",
    "PID_TUNING": "desired|FF|P|I|D",
    "actuator_(outputs|motors|servos|controls.*)": r"(output|control)\[\d+\]",
    "vehicle_(attitude|rates|thrust|torque)_setpoint": r"(?!timestamp).*",
}
SAMPLES = {
    "ATT|ANG": "Roll|Pitch|Yaw",
    "RATE": "[RPYA]",
    "PID[RPYASNE]": "Act",
    "IMU|IMT|ACC|GYR": "(Gyr|Acc)[XYZ]",
    "SIDD": "[GA][xyz]",
    "PSC[NED]": "[PVA][NED]",
    "(XKF|NKF)1": "Roll|Pitch|Yaw|[VP][NED]",
    "AHR2": "Roll|Pitch|Yaw",
    "ATTITUDE": "(roll|pitch|yaw)(speed)?",
    "(RAW|SCALED|HIGHRES)_IMU2?": "[xyz](acc|gyro)",
    "LOCAL_POSITION_NED": "v?[xyz]",
    "PID_TUNING": "achieved",
    "vehicle_attitude": r"q\[\d\]|(roll|pitch|yaw)speed",
    "vehicle_angular_velocity": r"xyz\[\d\]",
    "vehicle_local_position": "v?[xyz]|heading",
    "sensor_combined": r"(gyro_rad|accelerometer_m_s2)\[\d\]",
}

# The controller adds these signals in every pass of its loop until the next message.
KEPT = {"autotune_attitude_control_status": r"rate_sp\[\d\]"}

# Hz; of ArduPilot, of PX4 (0 there: the sensor's own rate).
LOOP_RATES = (
    "SCHED_LOOP_RATE",
    "IMU_GYRO_RATEMAX",
)


def with_holds(groups: Iterable[Messages], parameters: Values) -> list[Messages]:
    """Return the messages with how long their values lasted, from the vehicle's parameters."""
    rates = [parameters[name] for name in LOOP_RATES if parameters.get(name, 0) > 0]
    period = 1 / rates[0] if rates else math.nan
    return [replace(group, hold=_holds(group, period)) for group in groups]


def is_of_controller(group: Messages) -> bool:
    """Return whether messages have outputs of a controller and no samples of a sensor."""
    return bool(_among(OUTPUTS, group)) and not _among(SAMPLES, group)


def _holds(group: Messages, period: float) -> Values:
    holds = dict.fromkeys(_among(SAMPLES, group), CONTINUOUS)
    holds |= dict.fromkeys(_among(KEPT, group), HELD)
    if math.isnan(period):
        # If the loop is unknown, a log is assumed to have every pass unless it is slower than the
        # lowest SCHED_LOOP_RATE, 50 Hz.
        if group.time is None or not median_step(group.time) <= 1 / 50:
            return holds
        period = HELD

    return holds | dict.fromkeys(_among(OUTPUTS, group), period)


def _among(table: Mapping[str, str], group: Messages) -> list[str]:
    """Return the columns that a table of fields by message has."""
    # All instances of a message, IMU[0] and IMU[1], have the same fields.
    message = group.name.partition("[")[0]
    fields = "|".join(names for key, names in table.items() if re.fullmatch(key, message))
    return [name for name in group.columns if re.fullmatch(fields, name)]
