"""Text logs: of any size, of before 2014, whose messages have no times, with units that contradict themselves."""

import tracemalloc

import numpy as np
import pytest
from synthetic_logs import Log

from greybox.logs.readers import read


def long_log(lines):
    """Attitudes at 100 Hz, as every fourth line; what lies between is longer."""
    made = Log().fmt("ATT", "Qf", "TimeUS,Roll").fmt("BULK", "Q" + "f" * 12, "TimeUS," + ",".join("ABCDEFGHIJKL"))
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


def test_batches_of_lines_are_one_message(tmp_path, monkeypatch):
    """Lines that are cut short are skipped and counted, whichever batch they are in."""
    path = tmp_path / "short.log"
    path.write_text(long_log(60).replace("ATT, 50000, 0.5", "ATT, 50000"))
    whole = read(path)
    monkeypatch.setattr("greybox.logs.readers.dataflash_text.BATCH", 4)
    parts = read(path)
    assert len(whole["ATT"]) == 14
    assert "ATT: 1 damaged lines were skipped." in whole.findings
    assert {name: record.checksum for name, record in parts.items()} == {n: r.checksum for n, r in whole.items()}
    assert (parts.findings, parts.checksum) == (whole.findings, whole.checksum)


def old_log():
    """GPS at 5 Hz with the vehicle's time, attitudes at 50 Hz without one."""
    lines = [
        "ArduCopter V3.0.1 (5c6503e2)",
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 130, 45, GPS, BIHBcLLeeEefI, Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
        "FMT, 138, 15, ATT, cccc, RollIn,Roll,PitchIn,Pitch",
    ]
    for k in range(500):
        if k % 10 == 0:
            lines.append(f"GPS, 3, {130040903 + 20 * k}, 1769, 8, 2.35, 1.0, 2.0, 0, 0, 0, 0, 0, {20000 + 20 * k}")
        lines.append(f"ATT, 0.0, {np.sin(0.1 * k):.2f}, 0.0, 1.0")
    return "\n".join(lines) + "\n"


def test_times_lie_between_those_of_gps(tmp_path):
    (tmp_path / "old.log").write_text(old_log())
    recording = read(tmp_path / "old.log")
    attitude = recording["ATT"]
    first = round((attitude.time[0] - 20) / 0.02)
    truth = 20 + 0.02 * np.arange(first, first + len(attitude))
    assert len(attitude) > 480
    assert np.abs(attitude.time - truth).max() < 0.04
    assert any("only GPS has times, every 0.2 s" in text for text in recording.findings)
    assert recording.metadata["vehicle"] == "ArduCopter"


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
