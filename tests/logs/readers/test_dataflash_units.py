"""Unit tables of ArduPilot logs, and the usual units without them."""

import numpy as np
from synthetic_logs import Log

from greybox.logs.readers import read
from greybox.logs.readers.dataflash_units import with_usual_units
from greybox.logs.readers.messages import Messages


def test_a_letter_with_two_units_means_none(tmp_path):
    made = Log()
    made.add("UNIT", 0, ord("d"), "rad")
    made.fmt("ATT", "Qff", "TimeUS,Roll,Spd", "sdn", "F00")
    made.add("ATT", 1_000_000, 1.0, 2.0).add("ATT", 1_100_000, 1.0, 2.0)
    path = tmp_path / "log.bin"
    path.write_bytes(made.binary)
    recording = read(path)
    assert (recording["ATT"].units["Roll"], recording["ATT"].units["Spd"]) == ("", "m/s")
    assert any("the letter 'd' for deg and for rad" in text for text in recording.findings)


def test_multipliers_are_a_part_of_the_unit(tmp_path):
    """By their prefix, or as a number; one is none, and a letter that scales has its own."""
    made = Log()
    made.add("MULT", 0, ord("x"), 3.5).add("UNIT", 0, ord("m"), "m")
    made.fmt("TST", "Qhhhhc", "TimeUS,A,B,C,D,E", "snnmms", "FBx0?B")
    for k in range(3):
        made.add("TST", 1_000_000 + 100_000 * k, 1, 2, 3, 4, 5.0)
    path = tmp_path / "log.bin"
    path.write_bytes(made.binary)
    record = read(path)["TST"]
    assert record.units == {"A": "cm/s", "B": "3.5 m/s", "C": "m", "D": "m", "E": "s"}
    assert [record[name][0] for name in "ABCDE"] == [1, 2, 3, 4, 5]


def test_the_usual_units_are_those_of_ardupilots_messages():
    """As LogStructure.h of ArduPilot has them; a log that states one unit is believed."""
    fields = {
        "ATT": {"Roll": "deg", "DesPitch": "deg", "ErrYaw": "deg", "AEKF": ""},
        "RATE": {"PDes": "deg/s", "P": "deg/s", "POut": "", "Y": "deg/s", "RDes": "deg/s"},
        "IMU": {"GyrX": "rad/s", "GyrZ": "rad/s", "AccY": "m/s²", "T": ""},
        "XKF1": {"Pitch": "deg", "VN": "m/s", "VD": "m/s", "PE": "m", "GX": ""},
        "AHR2": {"Yaw": "deg", "Alt": ""},
        "BARO": {"Alt": ""},
    }
    groups = [
        Messages(name, np.arange(2), np.arange(2.0), {field: np.zeros(2) for field in units})
        for name, units in fields.items()
    ]
    made, findings = with_usual_units(groups)
    for group in made:
        assert {name: group.units.get(name, "") for name in group.columns} == fields[group.name]
    assert findings == (
        "the log has no table of units: ArduPilot's usual ones are assumed for ATT, RATE, IMU, XKF1, AHR2.",
    )
    stated = [
        *groups,
        Messages("GPS", np.arange(2), np.arange(2.0), {"Spd": np.zeros(2)}, units={"Spd": "m/s"}),
    ]
    assert with_usual_units(stated) == (stated, ())
    (barometer,), findings = with_usual_units(groups[-1:])
    assert (barometer.units, findings) == ({}, ())
