"""Metadata of ArduPilot logs, from messages written down by hand."""

import numpy as np
import pytest

from greybox.logs.readers.ardupilot_metadata import armed_intervals, metadata, mode_name, unit
from greybox.logs.readers.messages import Messages


def messages(name, time, columns=None, texts=None):
    return Messages(
        name, np.arange(len(time)), np.array(time, dtype=float), columns or {}, texts or {}
    )


@pytest.mark.parametrize(
    ("changes", "intervals"),
    [
        ([], ()),
        ([(1.0, True), (5.0, False)], ((1.0, 5.0),)),
        ([(5.0, False), (1.0, True)], ((1.0, 5.0),)),
        ([(5.0, False)], ((0.0, 5.0),)),
        ([(5.0, True)], ((5.0, 9.0),)),
        (
            [(1.0, True), (2.0, True), (3.0, False), (4.0, False), (6.0, True)],
            ((1.0, 3.0), (6.0, 9.0)),
        ),
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
        "frame": "H",
        "parameters": {"INS_GYRO_FILTER": 20.0, "FRAME": 3.0},
        "defaults": {"INS_GYRO_FILTER": 20.0},
        "texts": ((0.5, "ArduCopter V4.5.1 (abc)"),),
        "modes": ((1.0, "GUIDED"), (2.0, "?")),
        "armed": ((1.0, 8.0),),
    }
    assert metadata([], (0.0, 0.0)) == {}


@pytest.mark.parametrize(
    ("texts", "parameters", "expected"),
    [
        (["APM:Copter V3.4-rc2 (cb1ff4c)", "PX4: 8d505a02", "PX4v2 00390026 30365105 33343234"], {"FRAME": 1.0},
         ("ArduCopter", "X", "PX4v2")),
        (["ArduCopter V4.6.0 (fbb78585)", "Frame: QUAD/PLUS"], {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0},
         ("ArduCopter", "QUAD/PLUS", None)),
        (["ArduPlane V4.5.7 (abc)", "CubeOrange 0036002A 30325105 37383433"], {}, ("ArduPlane", None, "CubeOrange")),
        (["hello"], {"FRAME_CLASS": 2.0, "FRAME_TYPE": 1.0}, (None, "HEXA/X", None)),
    ],
)  # fmt: skip
def test_vehicle_frame_and_board_of_old_logs_too(texts, parameters, expected):
    values = {"Value": np.array(list(parameters.values()))}
    log = [
        messages("MSG", [0.5] * len(texts), texts={"Message": texts}),
        messages("PARM", [0] * len(parameters), values, {"Name": list(parameters)}),
        messages("MODE", [1], {"Mode": np.array([5.0])}),
    ]
    about = metadata(log, (0.5, 9.0))
    assert (about.get("vehicle"), about.get("frame"), about.get("board")) == expected
    if expected[0] == "ArduCopter":
        assert about["modes"] == ((1.0, "LOITER"),)


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
        ("ArduSub", {9: "SURFACE", 19: "MANUAL"}),
        ("AntennaTracker", {1: "STOP", 2: "SCAN"}),
        ("Blimp", {1: "MANUAL", 2: "VELOCITY"}),
    ],
)
def test_modes_are_those_of_each_firmware(vehicle, modes):
    """Of the enumerations in the mode.h of each."""
    assert {number: mode_name(vehicle, number) for number in modes} == modes


@pytest.mark.parametrize(
    ("parameters", "frame"),
    [
        *(
            ({"FRAME_CLASS": float(number)}, name)
            for number, name in enumerate(
                ("QUAD", "HEXA", "OCTA", "OCTAQUAD", "Y6", "HELI", "TRI"), start=1
            )
        ),
        *(({"FRAME": float(number)}, name) for number, name in enumerate(("PLUS", "X", "V", "H"))),
        ({"FRAME_CLASS": 3.0, "FRAME_TYPE": 2.0, "FRAME": 1.0}, "OCTA/V"),
        ({"FRAME_CLASS": 0.0, "FRAME_TYPE": 3.0}, "H"),
        ({"FRAME_CLASS": 2.0, "FRAME_TYPE": 99.0}, "HEXA"),
        ({"FRAME": 17.0}, None),
    ],
)
def test_frames_are_those_of_ardupilots_parameters(parameters, frame):
    values = np.array(list(parameters.values()))
    log = [messages("PARM", [0] * len(parameters), {"Value": values}, {"Name": list(parameters)})]
    assert metadata(log, (0.0, 9.0)).get("frame") == frame


def test_the_first_text_that_tells_counts():
    texts = [
        "hello",
        "Frame: HEXA",
        "Frame: QUAD",
        "Pixhawk4 0036002A 30325105 37383433",
        "fmuv3 0 1 2",
    ]
    texts += ["Cube 0036002A 30325105 37383433", "ArduSub V4.1 (ab)", "ArduCopter V4.5 (cd)"]
    about = metadata([messages("MSG", range(8), texts={"Message": texts})], (0.0, 9.0))
    assert (about["frame"], about["board"], about["firmware"]) == (
        "HEXA",
        "Pixhawk4",
        "ArduSub V4.1 (ab)",
    )
    version = messages("VER", [0], texts={"FWS": ["Blimp V4.6"]})
    about = metadata([messages("MSG", range(8), texts={"Message": texts}), version], (0.0, 9.0))
    assert (about["vehicle"], about["firmware"]) == ("Blimp", "Blimp V4.6")


def test_arming_is_that_of_both_messages():
    """ARM by its state, EV by 10 and 11; times that are not known and other events count for nothing."""
    arm = messages("ARM", [2, 5, np.nan], {"ArmState": np.array([1.0, 0.0, 1.0])})
    event = messages("EV", [2.5, 5.5, 7, 8, 8.5], {"Id": np.array([10.0, 11.0, 10.0, 12.0, 9.0])})
    assert metadata([arm, event], (0.0, 9.0)) == {"armed": ((2.0, 5.0), (7.0, 9.0))}
    assert metadata([arm], (0.0, 9.0)) == {"armed": ((2.0, 5.0),)}


def test_modes_by_number_and_by_name():
    """ModeNum goes before Mode; a text is a name already."""
    said = messages("MSG", [0], texts={"Message": ["ArduCopter V4.5.1 (abc)"]})
    numbered = messages(
        "MODE", [1, 2], {"Mode": np.array([9.0, 9.0]), "ModeNum": np.array([5.0, 6.0])}
    )
    assert metadata([said, numbered], (0.0, 9.0))["modes"] == ((1.0, "LOITER"), (2.0, "RTL"))
    named = messages(
        "MODE", [1, 2], {"ModeNum": np.array([5.0, 6.0])}, {"Mode": ["Stabilize", "Guided"]}
    )
    assert metadata([said, named], (0.0, 9.0))["modes"] == ((1.0, "STABILIZE"), (2.0, "GUIDED"))
    assert "modes" not in metadata(
        [said, messages("MODE", [1], {"Rsn": np.array([5.0])})], (0.0, 9.0)
    )
