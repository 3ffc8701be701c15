import pytest

from greybox.data.record import Record, Recording
from greybox.experiment.scripts import FLOWN_AXES
from greybox.logs.ardupilot import SYSTEMID_AXES, SecondOrderLowPass, gyro_filter


@pytest.mark.parametrize(("signal", "filtered"), [("RATE.P", True), ("IMU[1].GyrX", True), ("RATE.PDes", False)])
def test_rates_have_passed_the_gyro_filter(signal, filtered):
    log = Recording({"ATT": Record([0.0], {})}, metadata={"parameters": {"INS_GYRO_FILTER": 20}})
    assert gyro_filter(log, signal) == (SecondOrderLowPass(20.0) if filtered else None)
    assert gyro_filter(Recording({}), signal) is None


def test_axes_have_the_numbers_of_the_parameter():
    """SID_AXIS in ArduPilot's list of parameters: 8 rate pitch, 11 mixer pitch, 13 mixer thrust."""
    assert [SYSTEMID_AXES[k - 1] for k in (1, 8, 11, 13)] == ["input roll", "rate pitch", "mixer pitch", "mixer thrust"]
    assert FLOWN_AXES[-1] == "mixer thrust"
