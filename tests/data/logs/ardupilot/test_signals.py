from greybox.data.logs.ardupilot.signals import SYSTEMID_AXES
from greybox.data.logs.flight_controllers import axis_of
from greybox.workflows.experiment.scripts import FLOWN_AXES


def test_axes_have_the_numbers_of_the_parameter():
    """SID_AXIS in ArduPilot's list of parameters: 8 rate pitch, 11 mixer pitch, 13 mixer thrust."""
    assert [SYSTEMID_AXES[k - 1] for k in (1, 8, 11, 13)] == [
        "input roll",
        "rate pitch",
        "mixer pitch",
        "mixer thrust",
    ]
    assert FLOWN_AXES[-1] == "mixer thrust"


def test_controls_of_both_flight_controllers_tell_their_axis():
    assert [
        axis_of(name) for name in ("RATE.YOut", "vehicle_torque_setpoint.xyz[1]", "BAT.Volt")
    ] == [
        "yaw",
        "pitch",
        "",
    ]
