"""Text logs of any size, damaged ones, and unit tables."""

import tracemalloc

import numpy as np
import pytest
from synthetic_logs import Log

from greybox.data.logs.readers import read
from greybox.data.logs.readers.dataflash_units import with_usual_units
from greybox.data.logs.readers.messages import Messages


def long_log(lines):
    """Attitudes at 100 Hz, as every fourth line; what lies between is longer."""
    made = (
        Log()
        .fmt("ATT", "Qf", "TimeUS,Roll")
        .fmt("BULK", "Q" + "f" * 12, "TimeUS," + ",".join("ABCDEFGHIJKL"))
    )
    text = [made.text.rstrip("\n")]
    for k in range(lines):
        name, values = ("ATT", "0.5") if k % 4 == 0 else ("BULK", ", ".join(12 * ["-1.234567"]))
        text.append(f"{name}, {2500 * k}, {values}")
    return "\n".join(text) + "\n"


def test_what_is_not_asked_for_is_not_in_memory(tmp_path):
    path = tmp_path / "long.log"
    path.write_text(long_log(20_000))
    tracemalloc.start()
    recording = read(path, ["ATT"])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(recording["ATT"]) == 5000
    assert peak < path.stat().st_size  # 2.3 MB, of which half are text at a time


@pytest.mark.parametrize("suffix", [".log", ".bin"])
def test_a_letter_with_two_units_means_none(tmp_path, suffix):
    made = Log()
    made.add("UNIT", 0, ord("d"), "rad")
    made.fmt("ATT", "Qff", "TimeUS,Roll,Spd", "sdn", "F00")
    made.add("ATT", 1_000_000, 1.0, 2.0).add("ATT", 1_100_000, 1.0, 2.0)
    path = tmp_path / f"log{suffix}"
    path.write_bytes(made.binary) if suffix == ".bin" else path.write_text(made.text)
    recording = read(path)
    assert (recording["ATT"].units["Roll"], recording["ATT"].units["Spd"]) == ("", "m/s")
    assert any("the letter 'd' for deg and for rad" in text for text in recording.findings)


def test_damaged_lines_cost_only_themselves(tmp_path):
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 1, 17, ATT, Qfn, TimeUS,Roll,Who",
        "FMT, x, 17, BAD, Qf, TimeUS,Roll",
        "FMT, 2, 17, BAE, Q?, TimeUS,Roll",
        "FMT, 3, 17, BAF, Qff, TimeUS,Roll",
        "FMT, 4, 17, BAG, Qff, TimeUS,Roll,Roll",
        "FMT, 5, 17",
        "ATT, 1000000, 1.5, me",
        "ATT, 1100000, 2.5",
        "ATT, 1200000, oops, you",
        "ATT, 1300000, 4.5, him",
        *(f"{name}, 1000000, 1" for name in ("BAD", "BAE", "BAF", "BAG", "ODD")),
        "no comma in this line",
    ]
    (tmp_path / "flight.log").write_text("\n".join(lines) + "\n")
    recording = read(tmp_path / "flight.log")
    assert [*recording] == ["ATT"]
    np.testing.assert_array_equal(recording["ATT"].time, [1.0, 1.2, 1.3])
    np.testing.assert_array_equal(recording["ATT"]["Roll"], [1.5, np.nan, 4.5])
    assert "ATT: 1 damaged lines were skipped." in recording.findings
    assert (
        "5 lines are damaged, or have no FMT line that describes them, and were skipped."
        in recording.findings
    )


@pytest.mark.parametrize("suffix", [".log", ".bin"])
def test_multipliers_are_a_part_of_the_unit(tmp_path, suffix):
    """By their prefix, or as a number; one is none, and a letter that scales has its own."""
    made = Log()
    made.add("MULT", 0, ord("x"), 3.5).add("UNIT", 0, ord("m"), "m")
    made.fmt("TST", "Qhhhhc", "TimeUS,A,B,C,D,E", "snnmms", "FBx0?B")
    for k in range(3):
        made.add("TST", 1_000_000 + 100_000 * k, 1, 2, 3, 4, 5.0)
    path = tmp_path / f"log{suffix}"
    path.write_bytes(made.binary) if suffix == ".bin" else path.write_text(made.text)
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


def test_a_field_too_many_is_damage(tmp_path):
    """Only a text at the end may have commas."""
    lines = [
        "FMT, 1, 17, ATT, Qff, TimeUS,Roll,Pitch",
        "FMT, 2, 17, MSG, QZ, TimeUS,Message",
        "ATT, 1000000, 1.5, 2.5",
        "ATT, 1100000, 9, 1.5, 2.5",
        "ATT, 1200000, 3.5, 4.5",
        "MSG, 1200000, hover, then land",
    ]
    (tmp_path / "flight.log").write_text("\n".join(lines) + "\n")
    recording = read(tmp_path / "flight.log")
    np.testing.assert_array_equal(recording["ATT"]["Pitch"], [2.5, 4.5])
    assert "ATT: 1 damaged lines were skipped." in recording.findings
    assert not any("MSG" in text for text in recording.findings)


def test_the_latest_description_of_a_message_counts(tmp_path):
    """Two logs in one file: columns that were moved keep their names, as pymavlink reads them."""
    lines = ["FMT, 1, 17, ATT, Qff, TimeUS,Roll,Pitch"]
    lines += [f"ATT, {1_000_000 + 10_000 * k}, 1, 2" for k in range(3)]
    lines += ["FMT, 1, 17, ATT, Qff, TimeUS,Pitch,Roll"]
    lines += [f"ATT, {1_100_000 + 10_000 * k}, 2, 1" for k in range(10)]
    (tmp_path / "flight.log").write_text("\n".join(lines) + "\n")
    recording = read(tmp_path / "flight.log")
    record = recording["ATT"]
    np.testing.assert_array_equal(record["Roll"], np.ones(10))
    np.testing.assert_array_equal(record["Pitch"], np.full(10, 2.0))
    lost = "ATT: 3 lines with another layout than the rest were left out."
    assert lost in recording.findings
