"""Metadata of ArduPilot logs, from messages written down by hand."""

import numpy as np
import pytest

from greybox.logs.readers.ardupilot_metadata import armed_intervals, metadata, mode_name, unit
from greybox.logs.readers.messages import Messages


def messages(name, time, columns=None, texts=None):
    return Messages(name, np.arange(len(time)), np.array(time, dtype=float), columns or {}, texts or {})


@pytest.mark.parametrize(
    ("changes", "intervals"),
    [
        ([], ()),
        ([(1.0, True), (5.0, False)], ((1.0, 5.0),)),
        ([(5.0, False), (1.0, True)], ((1.0, 5.0),)),
        ([(5.0, False)], ((0.0, 5.0),)),
        ([(5.0, True)], ((5.0, 9.0),)),
        ([(1.0, True), (2.0, True), (3.0, False), (4.0, False), (6.0, True)], ((1.0, 3.0), (6.0, 9.0))),
    ],
)
def test_armed_intervals(changes, intervals):
    assert armed_intervals(changes, (0.0, 9.0)) == intervals


def test_modes_are_arducopters():
    """Numbers of the Mode enumeration in ArduCopter/mode.h."""
    numbers = {0: "STABILIZE", 4: "GUIDED", 5: "LOITER", 25: "SYSTEMID"}
    assert {n: mode_name("ArduCopter", n) for n in numbers} == numbers
    assert mode_name("ArduPlane", 5) == "FBWA"
    assert mode_name("ArduCopter", 999) == "mode 999"
    assert mode_name("a teapot", 5) == "mode 5"


def test_what_a_log_says_about_its_vehicle():
    log = [
        messages("MSG", [0.5], texts={"Message": ["ArduCopter V4.5.1 (abc)"]}),
        messages("PARM", [0, 0], {"Value": np.array([20.0, 3.0]), "Default": np.array([20.0, np.nan])},
                 {"Name": ["INS_GYRO_FILTER", "FRAME"]}),
        messages("MODE", [1, 2], {"Mode": np.array([4.0, np.nan])}),
        messages("EV", [1, 8, 9], {"Id": np.array([10.0, 11.0, 77.0])}),
    ]  # fmt: skip
    assert metadata(log, (0.5, 9.0)) == {
        "vehicle": "ArduCopter",
        "firmware": "ArduCopter V4.5.1 (abc)",
        "parameters": {"INS_GYRO_FILTER": 20.0, "FRAME": 3.0},
        "defaults": {"INS_GYRO_FILTER": 20.0},
        "texts": ((0.5, "ArduCopter V4.5.1 (abc)"),),
        "modes": ((1.0, "GUIDED"), (2.0, "?")),
        "armed": ((1.0, 8.0),),
    }
    assert metadata([], (0.0, 0.0)) == {}


def test_units_are_written_as_greybox_writes_them():
    assert [unit(u) for u in ("deg/s/s", "degheading", "UNKNOWN", "us", "m")] == ["deg/s²", "deg", "", "µs", "m"]
