"""Metadata of ArduPilot logs, from messages written down by hand."""

import numpy as np
import pytest

from greybox.data.logs.readers.ardupilot_metadata import metadata, mode_name, unit
from greybox.data.logs.readers.messages import Messages


def messages(name, time, columns=None, texts=None):
    return Messages(
        name, np.arange(len(time)), np.array(time, dtype=float), columns or {}, texts or {}
    )


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
    ]  # fmt: skip
    assert metadata(log) == {
        "vehicle": "ArduCopter",
        "firmware": "ArduCopter V4.5.1 (abc)",
        "parameters": {"INS_GYRO_FILTER": 20.0, "FRAME": 3.0},
        "texts": ((0.5, "ArduCopter V4.5.1 (abc)"),),
        "modes": ((1.0, "GUIDED"), (2.0, "?")),
    }
    assert metadata([]) == {}


def test_parameters_that_change_in_flight_are_kept_with_their_times():
    times, names, values = [0, 0, 5, 7], ["P", "I", "P", "I"], np.array([0.1, 0.2, 0.3, 0.2])
    about = metadata([messages("PARM", times, {"Value": values}, {"Name": names})])
    assert about["parameters"] == {"P": 0.3, "I": 0.2}
    assert about["parameter_changes"] == ((5.0, "P", 0.1, 0.3),)


def test_units_are_written_as_greybox_writes_them():
    assert [unit(u) for u in ("deg/s/s", "degheading", "UNKNOWN", "us", "m")] == [
        "deg/s²",
        "deg",
        "",
        "µs",
        "m",
    ]


@pytest.mark.parametrize(
    ("vehicle", "modes"),
    [
        ("ArduCopter", {4: "GUIDED", 25: "SYSTEMID"}),
        ("ArduPlane", {4: "ACRO", 19: "QLOITER"}),
        ("ArduRover", {4: "HOLD", 10: "AUTO"}),
        ("APMrover2", {4: "HOLD", 10: "AUTO"}),
        ("APM:Copter", {5: "LOITER"}),
        ("ArduSub", {9: "SURFACE", 19: "MANUAL"}),
        ("AntennaTracker", {1: "STOP", 2: "SCAN"}),
        ("Blimp", {1: "MANUAL", 2: "VELOCITY"}),
    ],
)
def test_modes_are_those_of_each_firmware(vehicle, modes):
    """Of the enumerations in the mode.h of each."""
    assert {number: mode_name(vehicle, number) for number in modes} == modes


def test_the_first_text_that_names_a_firmware_counts():
    texts = ["hello", "Frame: HEXA", "ArduSub V4.1 (ab)", "ArduCopter V4.5 (cd)"]
    log = [messages("MSG", range(4), texts={"Message": texts})]
    assert metadata(log)["firmware"] == "ArduSub V4.1 (ab)"
    version = messages("VER", [0], texts={"FWS": ["Blimp V4.6"]})
    about = metadata([*log, version])
    assert (about["vehicle"], about["firmware"]) == ("Blimp", "Blimp V4.6")


def test_modes_by_number_and_by_name():
    """ModeNum is the number that Mode is in binary logs; a text is a name already."""
    said = messages("MSG", [0], texts={"Message": ["ArduCopter V4.5.1 (abc)"]})
    numbered = messages(
        "MODE", [1, 2], {"Mode": np.array([5.0, 6.0]), "ModeNum": np.array([5.0, 6.0])}
    )
    assert metadata([said, numbered])["modes"] == ((1.0, "LOITER"), (2.0, "RTL"))
    named = messages(
        "MODE", [1, 2], {"ModeNum": np.array([5.0, 6.0])}, {"Mode": ["Stabilize", "Guided"]}
    )
    assert metadata([said, named])["modes"] == ((1.0, "STABILIZE"), (2.0, "GUIDED"))
    assert "modes" not in metadata([said, messages("MODE", [1], {"Rsn": np.array([5.0])})])
