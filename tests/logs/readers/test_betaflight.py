"""Tables as blackbox_decode and Blackbox Explorer write them."""

import numpy as np
import pytest

from greybox.logs.readers import read

DECODED = "loopIteration, time (us), axisP[0], gyroADC[0], setpoint[0], setpoint[3], motor[0], flightModeFlags (flags)"
EXPLORED = '"loopIteration","time","axisP[0]","gyroADC[0]","setpoint[0]","setpoint[3]","motor[0]","flightModeFlags"'
SETTINGS = '"Product","Blackbox flight data recorder by Nicholas Sherlock"\n"looptime","125"\n"rollPID","45,80,40"\n'


@pytest.mark.parametrize("head", [DECODED, SETTINGS + EXPLORED])
def test_signals_have_times_and_units(tmp_path, head):
    time = 1_000_000 + 500 * np.arange(400)
    rate = np.sin(0.05 * np.arange(400))
    rows = [
        f"{k},{t},1,{w:.6f},0,1500,1100,ANGLE_MODE"
        for k, (t, w) in enumerate(zip(time, rate, strict=True))
    ]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]) + "\n")
    record = read(tmp_path / "log.csv")["log"]
    assert record.rate == pytest.approx(2000)
    np.testing.assert_allclose(record["gyroADC[0]"], rate, atol=1e-6)
    assert record.units["gyroADC[0]"] == record.units["setpoint[0]"] == "deg/s"
    assert not record.units.get("setpoint[3]")
