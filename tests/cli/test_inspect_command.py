"""`greybox inspect` says what a log holds."""

import json
import math
import shlex
from argparse import Namespace
from importlib.resources import files

import numpy as np
import pytest
from command_line import run

from greybox.cli.inspect_command import about, contents, message, next_command, rate
from greybox.data.excited_segment import Segment
from greybox.data.record import Record, Recording

LOG = str(files("greybox.problems") / "data" / "sitl_pitch.BIN")
PITCH = ["--announced", "SINE", "--input", "u=RATE.POut", "--output", "theta=ATT.Pitch"]


def test_inspect_says_what_a_log_holds(capsys, tmp_path):
    status, out, _ = run(
        capsys, "inspect", LOG, "--announced", "SINE", "--plot", tmp_path / "log.png"
    )
    assert status == 0
    following = shlex.join(["greybox", "identify", LOG, "--announced", "SINE"])
    assert out.splitlines()[-1] == f"next: {following}"
    for words in (
        "ArduCopter",
        "modes GUIDED from",
        "ATT",
        "RATE",
        "20.11",
        "sitl_pitch.BIN",
    ):
        assert words in out
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")


def test_inspect_as_json(capsys):
    status, out, _ = run(capsys, "inspect", LOG, "--announced", "SINE", "--json")
    answer = json.loads(out)
    assert status == 0
    assert [round(s["omega"], 2) for s in answer["segments"]][:3] == [20.11, 16.01, 12.03]
    assert "Pitch" in next(m for m in answer["messages"] if m["name"] == "ATT")["signals"]


def test_without_an_announcement_the_tests_are_found_in_the_setpoint(capsys):
    answer = json.loads(run(capsys, "inspect", LOG, "--setpoint", "ATT.DesPitch", "--json")[1])
    found = [s["omega"] for s in answer["segments"] if s["usable"]]
    assert found == pytest.approx([20.11, 16.01, 12.03, 8, 5.34, 4, 3.5, 3, 2, 1], rel=0.01)


def test_the_next_command_for_a_table_names_what_it_needs(capsys, tmp_path):
    time = [0.01 * k for k in range(3000)]
    rows = "\n".join(f"{t},{math.sin(3 * t)},{math.cos(3 * t)}" for t in time)
    (tmp_path / "flight.csv").write_text(f"time,r,y\n{rows}\n")
    out = run(capsys, "inspect", tmp_path / "flight.csv")[1]
    path = shlex.quote(str(tmp_path / "flight.csv"))
    expected = f"next: greybox response {path} --input SIGNAL --output SIGNAL"
    assert out.splitlines()[-1] == expected


def test_columns_without_names_are_stated(capsys, tmp_path):
    rows = "\n".join(f"{10 * k} {math.sin(0.03 * k):.6f} {k}" for k in range(3000))
    (tmp_path / "flight.asc").write_text(f"{rows}\n")
    words = ["inspect", tmp_path / "flight.asc", "--columns", "time=1:ms", "r=2", "y=3:deg"]
    out = run(capsys, *words)[1]
    assert "sine" in out
    assert out.splitlines()[-1].endswith("--columns time=1:ms r=2 y=3:deg")
    assert (
        "write NAME=COLUMN"
        in run(capsys, "inspect", tmp_path / "flight.asc", "--columns", "time")[2]
    )


def test_the_rate_of_messages_in_bursts_is_their_mean(capsys, tmp_path):
    """Fourteen messages a second that a link hands over at once are 14 Hz, not the 2000 Hz of their
    median interval."""
    time = [second + 0.0005 * k for second in range(20) for k in range(14)]
    (tmp_path / "link.csv").write_text("time,x\n" + "\n".join(f"{t:.4f},{t}" for t in time) + "\n")
    (message,) = json.loads(run(capsys, "inspect", tmp_path / "link.csv", "--json")[1])["messages"]
    assert message["rate"] == pytest.approx(279 / (time[-1] - time[0]))


def test_what_a_log_holds_is_a_table_of_its_messages():
    time = 10 + 0.02 * np.arange(101)
    wide = {f"s{k}": time[::4] for k in range(10)}
    log = Recording(
        {
            "ATT": Record(time, {"Roll": time, "Pitch": time}, {"Roll": "deg"}),
            "WIDE": Record(time[::4], wide),
            "ROWS": Record(np.arange(5.0), {"x": np.arange(5.0)}, has_time=False),
        },
        "made.bin",
        checksum="0123456789abcdef0123",
        metadata={
            "vehicle": "ArduCopter", "modes": ((10.04, "LOITER"), (12.0, "LAND")),
            "parameters": {"A": 1.0, "B": 2.0},
        },
    )  # fmt: skip
    rows = [
        " ".join(line.split())
        for line in contents([message(*item) for item in log.items()]).splitlines()
    ]
    assert rows[0] == "message samples Hz from s to s signals"
    assert rows[2:] == [
        "ATT 101 50 10.0 12.0 Roll (deg), Pitch",
        "WIDE 26 12.5 10.0 12.0 s0, s1, s2, s3, s4, s5, s6, s7 and 2 more",
        "ROWS 5 - - - x",
    ]
    assert about(log).splitlines() == [
        "made.bin",
        "SHA-256 0123456789abcdef...",
        "ArduCopter",
        "modes LOITER from 10.0 s, LAND from 12.0 s",
        "2 parameters",
    ]


@pytest.mark.parametrize(
    ("message", "found", "stated", "following"),
    [
        ("RATE.POut", ["sine"], {}, "greybox identify my.BIN"),
        (
            "RATE.POut", ["sine"],
            {"announced": "SINE", "setpoint": "A.x", "fields": {"omega": "W"}, "columns": {"time": "1"}},
            "greybox identify my.BIN --announced SINE --setpoint A.x --fields omega=W --columns "
            "time=1",
        ),
        ("T.u", ["sine"], {}, "greybox response my.BIN --input SIGNAL --output SIGNAL"),
        ("T.u", [], {}, ""),
    ],
)  # fmt: skip
def test_the_next_command_follows_from_what_was_found(message, found, stated, following):
    name, _, field = message.partition(".")
    log = Recording({name: Record([0.0, 1.0], {field: [0.0, 1.0]})})
    tests = [Segment(0.0, 1.0, kind=kind, axis=message, omega=9.0) for kind in found]
    options = {
        "log": "my.BIN",
        "announced": "",
        "setpoint": "",
        "fields": {},
        "columns": {},
    } | stated
    assert next_command(log, tests, Namespace(**options)) == following


def test_bursts_are_gaps_before_more_than_a_twentieth_of_the_samples():
    """A lossy log of 100 samples at 10 Hz has their rate, one with six gaps the mean."""
    for gaps, expected in ((5, 10.0), (6, 99 / (9.9 + 6 * 0.4))):
        intervals = np.full(99, 0.1)
        intervals[10 : 10 + 5 * gaps : 5] += 0.4
        record = Record(np.concatenate([[0.0], np.cumsum(intervals)]), {"x": np.arange(100.0)})
        assert len(record.pieces) == gaps + 1
        assert rate(record) == pytest.approx(expected)


def test_samples_that_a_logger_damaged_are_named(capsys, tmp_path):
    time = np.arange(0, 60, 0.01)
    y = np.sin(2 * time) + 0.01 * np.random.default_rng(0).normal(size=time.size)
    clean, damaged = tmp_path / "clean.csv", tmp_path / "damaged.csv"
    header = "time [s],u,y"
    np.savetxt(clean, np.c_[time, np.sign(y), y], delimiter=",", header=header, comments="")
    y[4000] = 30
    np.savetxt(damaged, np.c_[time, np.sign(y), y], delimiter=",", header=header, comments="")
    assert "far from both neighbors" not in run(capsys, "inspect", clean)[1]
    assert "y has 1 sample far from both neighbors" in run(capsys, "inspect", damaged)[1]
