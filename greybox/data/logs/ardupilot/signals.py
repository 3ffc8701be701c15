"""How ArduPilot names the signals of an axis, and the axes of its System Identification mode."""

from greybox.data.logs.axis_signals import AxisSignals

# SID_AXIS from 1, https://ardupilot.org/copter/docs/parameters.html
SYSTEMID_AXES = (
    "input roll,input pitch,input yaw,recovery roll,recovery pitch,recovery yaw,rate roll,rate "
    "pitch,rate yaw,mixer roll,mixer pitch,mixer yaw,mixer thrust,measured lateral "
    "position,measured longitudinal position,measured lateral velocity,measured longitudinal "
    "velocity,input lateral velocity,input longitudinal velocity"
).split(",")

# s, SYSTEM_ID_DELAY: the waveform starts this long after the mode (ArduCopter/mode_systemid.cpp).
SYSTEMID_DELAY = 1.0

ATTITUDE_SETPOINTS = ("ATT.DesRoll", "ATT.DesPitch", "ATT.DesYaw")

# Messages ATT, ANG, RATE and PID*, https://ardupilot.org/copter/docs/logmessages.html
AXES = {
    axis: AxisSignals(
        controls=(f"RATE.{short}Out", f"AETR.{surface}"),  # of a copter, of a plane
        angles=(f"ATT.{word}", f"ANG.{word}"),
        rates=(f"RATE.{short}", f"PID{short}.Act", f"IMU.Gyr{gyro}"),
        setpoints=(f"ATT.Des{word}", f"ANG.Des{word}", f"RATE.{short}Des"),
        terms=(f"PID{short}.Tar", f"PID{short}.P"),
        sticks=(f"RCIN.C{channel}",),  # as RCMAP_ROLL and the like have it by default
    )
    for axis, short, word, gyro, channel, surface in (
        ("roll", "R", "Roll", "X", 1, "Ail"),
        ("pitch", "P", "Pitch", "Y", 2, "Elev"),
        ("yaw", "Y", "Yaw", "Z", 4, "Rudd"),
    )
}
