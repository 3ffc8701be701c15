import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from pymavlink import DFReader
from synthetic_logs import Log, flight

from greybox.data.checked_array import within_range
from greybox.data.logs.readers import read
from greybox.data.logs.readers.ardupilot_metadata import unit
from greybox.data.logs.readers.dataflash import clock_column
from greybox.data.logs.readers.dataflash_layout import Layout

CUT = Path(__file__).parents[2] / "sitl_sweep_cut.BIN"
QUICK = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def saved(tmp_path):
    """Write bytes or text and read them."""

    def write_and_read(data, suffix=".bin", **options):
        path = tmp_path / f"log{suffix}"
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return read(path, **options)

    return write_and_read


def by_pymavlink(path):
    """Return pymavlink's messages by name and instance."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        log = (
            DFReader.DFReader_text(str(path))
            if path.suffix == ".log"
            else DFReader.DFReader_binary(str(path))
        )
        messages = {}
        while (message := log.recv_msg()) is not None:
            name, instance = message.get_type(), message.fmt.instance_field
            messages.setdefault(
                f"{name}[{getattr(message, instance)}]" if instance else name, []
            ).append(message)
        log.close()
    return messages, log


def assert_same(recording, path):
    """Every number and unit as pymavlink has it."""
    messages, log = by_pymavlink(path)
    assert set(messages) - set(recording) <= {"FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG"}
    for name, record in recording.items():
        theirs = messages[name]
        np.testing.assert_array_equal(record.time, [m.TimeUS / 1e6 for m in theirs])
        for field, values in record.signals.items():
            np.testing.assert_array_equal(
                values, within_range(np.array([float(getattr(m, field)) for m in theirs]))
            )
            assert record.units[field] == unit(theirs[0].fmt.get_unit(field))
    assert recording.metadata.get("parameters", {}) == log.params


def test_a_real_log_reads_as_pymavlink_reads_it():
    recording = read(CUT)
    assert_same(recording, CUT)
    assert recording.findings == ()
    assert list(recording)[:3] == ["RCOU", "BAT[0]", "MODE"]
    assert len(recording["IMU[1]"]) == 38


def test_the_metadata_of_a_real_log():
    about = read(CUT, messages=("ATT",)).metadata
    assert about["vehicle"] == "ArduCopter"
    assert about["firmware"] == "ArduCopter V4.6.0-dev (fbb78585)"
    assert about["parameters"]["INS_GYRO_FILTER"] == 20
    assert len(about["parameters"]) == 1360
    assert about["modes"][1] == (63.865277, "SYSTEMID")
    assert (63.865277, "SystemID Starting: axis=11") in about["texts"]


@pytest.mark.parametrize("suffix", [".bin", ".log"])
def test_a_made_log_reads_as_pymavlink_reads_it(saved, tmp_path, suffix):
    log = flight()
    recording = saved(log.binary if suffix == ".bin" else log.text, suffix)
    assert_same(recording, tmp_path / f"log{suffix}")
    assert recording.findings == ()
    assert recording.metadata["parameters"] == {
        "INS_GYRO_FILTER": 20,
        "ATC_RAT_PIT_P": pytest.approx(0.14),
    }
    assert recording.metadata["modes"] == ((10, "LOITER"), (14, "SYSTEMID"))


NUMBERS = {
    **{letter: st.integers(-128, 127) for letter in "bM"},
    "B": st.integers(0, 255),
    "h": st.integers(-(2**15), 2**15 - 1),
    "H": st.integers(0, 2**16 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "I": st.integers(0, 2**32 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "f": st.floats(width=32),
    "d": st.floats(),
    "g": st.floats(width=16),
}
SCALED = {
    "c": NUMBERS["h"],
    "C": NUMBERS["H"],
    "e": NUMBERS["i"],
    "E": NUMBERS["I"],
    "L": NUMBERS["i"],
}


@given(data=st.data(), letters=st.text("".join({**NUMBERS, **SCALED}), min_size=1, max_size=12))
@QUICK
def test_every_format_letter_reads_as_pymavlink_reads_it(saved, tmp_path, data, letters):
    log = Log()
    columns = ",".join(f"V{i}" for i in range(len(letters)))
    log.fmt("TEST", "Q" + letters, "TimeUS," + columns)
    kind, _, body = log.kinds["TEST"]
    for i in range(3):
        values = [data.draw({**NUMBERS, **SCALED}[letter]) for letter in letters]
        log.parts.append(
            struct.pack("<BBB", 0xA3, 0x95, kind) + struct.pack(body, 1000 + i, *values)
        )
    assert_same(saved(log.binary), tmp_path / "log.bin")


def test_only_what_is_asked_for_is_read(saved):
    log = flight().binary
    recording = saved(log, messages=("ATT", "IMU"))
    assert list(recording) == ["ATT", "IMU[0]", "IMU[1]"]
    assert recording.findings == ()
    np.testing.assert_array_equal(recording["IMU"]["GyrX"], saved(log)["IMU[0]"]["GyrX"])
    assert list(saved(log, messages="RATE")) == ["RATE"]


def test_a_message_that_is_not_there_is_a_finding(saved):
    findings = saved(flight().binary, messages=("ATT", "XKF1")).findings
    assert findings == ("there is no message XKF1; the log has ATT, EV, IMU, MODE, RATE.",)


def test_checksum_and_source_are_those_of_the_file(saved):
    recording = saved(flight().binary)
    assert recording.checksum == recording["ATT"].checksum
    assert len(recording.checksum) == 64
    assert recording["ATT"].source == "log.bin"


def test_an_old_log(saved):
    log = Log(units=False)
    log.fmt("ATT", "IccccCC", "TimeMS,RollIn,Roll,PitchIn,Pitch,YawIn,Yaw")
    log.fmt("GPS", "BIHBcLLeeEe", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs")
    log.fmt("GPS2", "BIHBcLLeeEeI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,T")
    log.fmt("CTUN", "hf", "ThrIn,Alt")
    for i in range(30):
        log.add("ATT", 5000 + 20 * i, 0.0, 1.5, 0.0, -2.25, 0.0, 180.0).add("CTUN", 500, 1.5)
        log.add(
            "GPS", 3, 345_600_000 + 200 * i, 1800, 9, 1.2, -35.36, 149.16, 1.0, 584.0, 0.1, 90.0
        )
        log.add(
            "GPS2",
            3,
            345_600_000 + 200 * i,
            1800,
            9,
            1.2,
            -35.36,
            149.16,
            1.0,
            584.0,
            0.1,
            90.0,
            5000 + 20 * i,
        )
    for data, suffix in ((log.binary, ".bin"), (log.text, ".log")):
        recording = saved(data, suffix)
        assert list(recording) == ["ATT", "GPS2"]
        assert recording["ATT"].time[0] == 5.0
        assert recording["ATT"].rate == pytest.approx(50)
        np.testing.assert_array_equal(recording["ATT"]["Pitch"], -2.25)
        np.testing.assert_array_equal(recording["GPS2"]["Lat"], -35.36)
        assert recording["GPS2"].time[0] == 5.0
        assert "RATE" in recording.findings[0]
        assert "LOG_BITMASK" in recording.findings[0]
        assert "CTUN: its 30 messages have no time and were left out." in recording.findings


def test_instances_without_unit_tables(saved):
    log = Log(units=False)
    log.fmt("XKF1", "QBcc", "TimeUS,C,Roll,Pitch")
    for i in range(5):
        log.add("XKF1", 1000 * i + 1, 0, 0.0, 1.0).add("XKF1", 1000 * i + 1, 1, 0.0, 2.0)
    recording = saved(log.binary)
    assert list(recording) == ["XKF1[0]", "XKF1[1]"]
    np.testing.assert_array_equal(recording["XKF1[1]"]["Pitch"], 2)
    assert "C" not in recording["XKF1"].signals


def test_a_restart_of_the_clock_loses_nothing(saved):
    recording = saved(flight(seconds=20, start=300).binary + flight(seconds=10, start=5).binary)
    attitude = recording["ATT"]
    assert len(attitude) == 3000
    assert [len(piece) for piece in attitude.pieces] == [2000, 1000]
    assert "the clock restarted at 320.0 s (another boot)" in recording.findings[0]
    assert "later times were shifted by +325.0 s" in recording.findings[0]
    assert recording["IMU[1]"].time[-1] > 339


def test_a_restart_reads_the_same_whatever_is_asked_for(saved):
    log = flight(seconds=20, start=300).binary + flight(seconds=10, start=5).binary
    np.testing.assert_array_equal(saved(log)["ATT"].time, saved(log, messages=("ATT",))["ATT"].time)


@pytest.mark.parametrize("stamp", [0, 2**20, 2**40, 2**64 - 1])
def test_a_damaged_stamp_costs_one_sample(saved, stamp):
    log = flight()
    at = log.binary.find(struct.pack("<Q", 10_000_000 + 2000 + 1_000_000 + 100))
    damaged = log.binary[:at] + struct.pack("<Q", stamp) + log.binary[at + 8 :]
    recording = saved(damaged)
    assert len(recording["ATT"]) == 399
    assert [f for f in recording.findings if f.startswith("ATT: 1 of 400 samples dropped: 1 ")]


def test_equal_stamps_are_dropped_and_said(saved):
    log = flight()
    log.add("RATE", 13_992_000, 0.0, 7.0, 0.0, 0.0, 0.0, 0.0)
    recording = saved(log.binary)
    assert len(recording["RATE"]) == 400
    assert "RATE: 1 of 401 samples dropped: 1 whose time does not increase." in recording.findings


def test_gaps_are_found(saved):
    log = flight()
    kept = [
        p
        for p in log.parts
        if not (p[2] == log.kinds["ATT"][0] and 11e6 < int.from_bytes(p[3:11], "little") < 12e6)
    ]
    assert "ATT: 1 gap, the longest 1.01 s at 11.0 s." in saved(b"".join(kept)).findings


def test_a_truncated_log(saved):
    whole = saved(flight().binary)
    recording = saved(flight().binary[:-700])
    assert any("is cut off" in finding for finding in recording.findings)
    for name, record in recording.items():
        np.testing.assert_array_equal(record.time, whole[name].time[: len(record)])


@pytest.mark.parametrize("padding", [b"\0" * 500, b"\xff" * 200])
def test_padding_at_the_end_is_no_damage(saved, padding):
    assert saved(flight().binary + padding).findings == ()


@given(
    at=st.integers(2500, 35_000),
    length=st.integers(1, 3000),
    filling=st.sampled_from([b"", b"\0", b"\xa3\x95"]),
)
@QUICK
def test_around_a_damaged_place_everything_is_read(saved, at, length, filling):
    log = flight(seconds=5)
    whole = saved(log.binary)
    broken = saved(log.binary[:at] + filling * (length // 2) + log.binary[at + length :])
    touched = sum(1 for part in log.parts if len(part)) * length // len(log.binary)
    assert sum(map(len, broken.values())) >= sum(map(len, whole.values())) - touched - 8
    for name, record in broken.items():
        if (
            name not in whole
        ):  # a damaged number of an instance makes one message look like another sender's
            assert len(record) <= 1
            continue
        rows = np.searchsorted(whole[name].time, record.time)
        for field, values in record.signals.items():
            wrong = np.count_nonzero(
                values != whole[name][field][np.minimum(rows, len(whole[name]) - 1)]
            )
            assert wrong <= 1  # at most the message that the damage ends in


def test_damage_is_counted(saved):
    data = flight().binary
    recording = saved(data[:5000] + b"garbage" * 10 + data[5000:])
    damage = [f for f in recording.findings if "damaged" in f]
    assert len(damage) == 1
    assert "in 1 place" in damage[0]


def test_what_ends_the_process_in_pymavlink_is_survived(saved, capfd):
    data = flight().binary
    lost_description = data.replace(
        b"\xa3\x95\x80" + bytes([flight().kinds["ATT"][0]]), b"\xa3\x95\x80\x01"
    )
    assert "ATT" not in saved(lost_description)
    assert "RATE" in saved(lost_description)
    assert capfd.readouterr() == ("", "")


def test_impossible_descriptions_are_ignored(saved):
    log = flight(seconds=1)
    empty = Log(units=False).fmt("ODD", "QB", "TimeUS,V", kind=77, length=0).parts[-1]
    few = Log(units=False).fmt("ODE", "QB", "TimeUS", kind=78).parts[-1]
    unknown = struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 0x80, 79, 12, b"ODF", b"Q?", b"TimeUS,V")
    recording = saved(empty + few + unknown + log.binary)
    assert len(recording["ATT"]) == 100
    assert recording.findings == ()


def test_a_type_described_twice_alike_is_one_record(saved):
    first = flight(seconds=2, start=10)
    second = flight(seconds=2, start=12)
    assert len(saved(first.binary + second.binary)["ATT"]) == 400


def test_a_type_described_twice_differently_keeps_the_larger_lot(saved):
    log = Log()
    log.fmt("ATT", "Qf", "TimeUS,Pitch", kind=90)
    for i in range(10):
        log.add("ATT", 1000 * i + 1000, 1.0)
    log.fmt("ATT", "Qff", "TimeUS,Pitch,Roll", kind=90)
    for i in range(30):
        log.add("ATT", 1000 * i + 20_000, 1.0, 2.0)
    recording = saved(log.binary)
    assert len(recording["ATT"]) == 30
    assert any("ATT: 10 messages" in text for text in recording.findings)


def test_a_file_without_messages_is_refused(saved):
    with pytest.raises(ValueError, match=r"log\.bin holds no ArduPilot message that can be read"):
        saved(b"\xa3\x95" + bytes(range(200)))


def test_a_text_log_of_an_old_tool(saved):
    lines = "ArduCopter V3.1.5 (3c57e771)\r\nFree RAM: 1331\r\nFMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format\r\n"
    lines += "FMT, 3, 20, MODE, Mh, Mode,ThrCrs\r\nFMT, 1, 17, ATT, Icc, TimeMS,Roll,Pitch\r\nMODE, Stabilize, 500\r\n"
    lines += "ATT, 100, 0.51, -1.25\r\nATT, 120, 0.52\r\nATT, oops, 0.52, 1\r\nATT, 140, 0.53, -1.23\r\n%$!, 5\r\n"
    recording = saved(lines, ".log")
    np.testing.assert_array_equal(recording["ATT"].time, [0.1, 0.14])
    np.testing.assert_array_equal(recording["ATT"]["Pitch"], [-1.25, -1.23])
    assert "ATT: 1 damaged lines were skipped." in recording.findings
    assert "ATT: 1 of 3 samples dropped: 1 with implausible times." in recording.findings
    assert any(finding.startswith("1 lines are damaged") for finding in recording.findings)


def test_nothing_is_printed(saved, capfd):
    data = bytearray(flight().binary)
    data[3000:3100] = b"\xa3\x95" * 50
    saved(bytes(data))
    assert capfd.readouterr() == ("", "")


def test_damaged_places_are_counted_and_the_first_is_told(saved):
    parts = flight(seconds=0.3).parts
    at = len(b"".join(parts[:40]))
    for places, said in (
        ((40,), "5 bytes in 1 place, the first"),
        ((40, 60), "10 bytes in 2 places, the first"),
    ):
        data = b"".join(b"junk!" * (k in places) + part for k, part in enumerate(parts))
        expected = f"{said} at byte {at}, are damaged and were skipped."
        assert [text for text in saved(data).findings if "byte" in text] == [expected]
    cut = saved(b"".join(parts)[:-1]).findings
    assert "the last message (EV) is cut off: the file was truncated, or the power was lost." in cut


@pytest.mark.parametrize(
    ("name", "columns", "clock"),
    [
        ("ATT", ("TimeUS", "Roll"), "TimeUS"),
        ("ATT", ("TimeMS", "Roll"), "TimeMS"),
        ("ATT", ("Roll", "TimeMS"), ""),
        ("GPS", ("Status", "TimeMS", "T"), "T"),
        ("GPS2", ("TimeMS", "T"), "T"),
        ("GPS", ("TimeUS", "T"), "TimeUS"),
        ("GPS", ("TimeMS", "Status"), "TimeMS"),
        ("BARO", ("Alt", "T"), ""),
        ("ODD", (), ""),
    ],
)
def test_the_clock_of_a_message_is_its_first_column_or_the_t_of_old_gps(name, columns, clock):
    assert clock_column(Layout(1, name, 3, "f" * len(columns), columns)) == clock


@pytest.mark.parametrize(
    ("there", "asked", "said"),
    [
        (("ATT", "IMU"), None, True),
        (("ATT", "RATE"), None, False),
        (("IMU",), None, False),
        (("ATT",), ("ATT",), False),
        (("ATT",), ("ATT", "RATE"), True),
        (("ATT", "RATE"), ("RATE",), False),
    ],
)
def test_without_rates_the_cure_is_said_to_who_needs_them(saved, there, asked, said):
    made = Log()
    for name in there:
        made.fmt(name, "Qf", "TimeUS,X", "s-", "F-")
    for k in range(3):
        for name in there:
            made.add(name, 1_000_000 + 1000 * k, 1.0)
    findings = saved(made.binary, messages=asked).findings
    assert any("set LOG_BITMASK" in text for text in findings) is said
    assert not any(text.startswith("there is no message") for text in findings)


def test_of_two_layouts_of_one_name_the_larger_lot_stays(saved):
    log = Log(units=False).fmt("ATT", "Qf", "TimeUS,Roll")
    for k in range(5):
        log.add("ATT", 1000 * k, float(k))
    log.fmt("ATT", "Qff", "TimeUS,Pitch,Yaw", kind=77).add("ATT", 6000, 1.0, 2.0)
    recording = saved(log.binary)
    assert [*recording["ATT"].signals] == ["Roll"]
    assert "ATT: 1 messages with another layout" in recording.findings[0]


def test_a_number_of_instances_that_is_a_control_is_no_signal(saved):
    # One wrong letter among the units of a damaged log: the output is the number of an instance.
    log = Log()
    log.fmt("RATE", "Qff", "TimeUS,R,ROut", "sk#", "F0-")
    for k in range(100):
        log.add("RATE", 1_000_000 + 2500 * k, 0.1, 0.0)
    (record,) = saved(log.binary).values()
    assert [*record.signals] == ["R"]
    assert "ROut" not in record.hold


def test_a_log_of_px4s_old_logger_is_refused_with_the_way_out(tmp_path):
    """Its messages have the form of DataFlash, but share the times of messages TIME."""
    made = Log(units=False).fmt("TIME", "Q", "StartTime").fmt("ATT", "ff", "Roll,Pitch")
    for k in range(20):
        made.add("TIME", 10_000 * k).add("ATT", 0.1, 0.2 * k)
    path = tmp_path / "flight.px4log"
    path.write_bytes(made.binary)
    with pytest.raises(ValueError, match=r"sdlog2.*sdlog2_dump\.py"):
        read(path)
