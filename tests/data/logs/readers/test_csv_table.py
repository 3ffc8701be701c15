import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from synthetic_logs import table

from greybox.data.checked_array import within_range
from greybox.data.logs.readers import read


@pytest.fixture
def saved(tmp_path):
    def write_and_read(text, name="flight.csv", **options):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(path, **options)

    return write_and_read


@pytest.mark.parametrize(
    ("separator", "comma"), [(",", False), (";", False), (";", True), ("\t", False), ("\t", True)]
)
def test_separators_and_decimal_commas(saved, separator, comma):
    recording = saved(table(separator=separator, comma=comma))
    record = recording["flight"]
    np.testing.assert_allclose(record.time, 0.01 * np.arange(400))
    np.testing.assert_allclose(record["pitch"], np.sin(0.1 * np.arange(400)), atol=1e-6)
    assert np.flatnonzero(np.isnan(record["u"])).tolist() == list(range(0, 400, 50))
    assert record.units == {"pitch": "deg", "u": ""}
    assert recording.findings == ("columns without numbers were left out: note.",)


@pytest.mark.parametrize(
    ("heading", "scale"),
    [
        ("time", 1),
        ("Time [s]", 1),
        ("t", 1),
        ("time_s", 1),
        ("time_ms", 1e-3),
        ("Timestamp (us)", 1e-6),
        ("TimeUS", 1e-6),
        ("TimeMS", 1e-3),
        ("timestamp_us", 1e-6),
        ("elapsed [ms]", 1e-3),
        ('"time [ms]"', 1e-3),
    ],
)
def test_the_time_column(saved, heading, scale):
    record = saved(f"{heading},x\n10,1\n20,2\n30,3\n")["flight"]
    np.testing.assert_allclose(record.time, np.array([10, 20, 30]) * scale)
    np.testing.assert_array_equal(record["x"], [1, 2, 3])


@given(
    values=st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=1, max_size=20),
    separator=st.sampled_from([",", ";", "\t"]),
)
@settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_numbers_survive(saved, values, separator):
    lines = [f"t{separator}x"] + [f"{i}{separator}{value!r}" for i, value in enumerate(values)]
    expected = within_range(np.array(values))
    np.testing.assert_array_equal(saved("\n".join(lines) + "\n")["flight"]["x"], expected)


def test_rows_of_another_length_are_counted(saved):
    recording = saved("t [s],x\n0,1\n1\n\n2\n3,5\n")
    assert recording["flight"]["x"].tolist() == [1, 5]
    finding = "2 of 4 lines have fewer cells than the header and were skipped; the first is line 3."
    assert recording.findings == recording["flight"].findings == (finding,)


def test_text_and_infinite_cells_are_named_with_their_lines(saved):
    rows = [f"{k},{k},{k}" for k in range(20)]
    rows[4], rows[7], rows[9] = "4,fault,4", "7,n/a,inf", "9,stall,-inf"
    recording = saved("t,x,y\n# u\n" + "\n".join(rows))
    assert np.flatnonzero(np.isnan(recording["flight"]["x"])).tolist() == [4, 7, 9]
    assert recording.findings == (
        "cells that are not finite numbers, which count as missing: x (2 cells, the first 'fault' in "
        "line 7) and y (2 cells, the first 'inf' in line 10).",
    )
    plain = saved("t,x\n0,1\n1,inf\n")
    assert "x (1 cell, the first 'inf' in line 3)" in plain.findings[0]


def test_many_thousand_columns_take_seconds_of_the_processor(tmp_path):
    """Each step is linear in the columns; a quadratic one would take longer than this allows."""
    names = [f"c{k}" for k in range(10_000)]
    path = tmp_path / "wide.csv"
    path.write_text(
        "\n".join([",".join(["time", *names]), *(",".join([f"{k}"] * 10_001) for k in range(2))])
    )
    limited = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_CPU, (4, 4)); import greybox as gb;"
        "print(len(gb.read(sys.argv[1])['wide'].signals))"
    )
    done = subprocess.run(
        [sys.executable, "-c", limited, path], capture_output=True, text=True, check=True
    )
    assert done.stdout == "10000\n"


def test_separators_at_the_end_of_lines_and_quotes(saved):
    record = saved('t;"roll; filtered [deg]";\n0;1;\n1;;\n2;"3";\n')["flight"]
    np.testing.assert_array_equal(record["roll; filtered"], [1, np.nan, 3])


def test_a_table_is_read_whole(saved):
    assert list(saved("t,x,y\n0,1,2\n1,3,4\n", messages=("ATT",))["flight"].signals) == ["x", "y"]


def test_the_clock_may_start_again(saved):
    rows = [f"{i / 100},{i}" for i in list(range(1000)) + list(range(500))]
    recording = saved("t,x\n" + "\n".join(rows))
    assert len(recording["flight"]) == 1500
    assert "the clock restarted at 10.0 s" in recording.findings[0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("t,x\n", "has no table: write a header line"),
        ("0,1\n1,2\n2,3\n", "has no header line: its first line, '0,1', must name the columns"),
        (
            "time,x\nnoon,2\nlater,3\n",
            "has the column 'time', which is not a time in numbers with a known unit",
        ),
        ("time [weeks],x\n1,2\n2,3\n", r"has the column 'time \[weeks\]', which is not a time"),
        ("t,name\n1,a\n2,b\n", "has no numeric column besides the time"),
        ("time,u\n0.0 s,1.2 N\n0.1 s,1.3 N\n", "has no column of numbers, as in '0.1 s,1.3 N'"),
        ("u:1.2\ty:0.1\nu:1.3\ty:0.2\n", "has no column of numbers, as in 'u:1.3"),
        (
            "t,signal,x\n0,u,1\n0,y,2\n1,u,3\n1,y,4\n",
            "has rows of u and y at each time, by .* 'signal'",
        ),
    ],
)
def test_what_is_no_table_is_refused(saved, text, match):
    with pytest.raises(ValueError, match=match):
        saved(text)


def test_exponents_of_fortran(saved):
    record = saved("# t u 2D-3\n0.0D+00 1.5D-03 1.0\n1.0D-02 -1.5D+01 2.0\n")["flight"]
    np.testing.assert_array_equal(record["u"], [0.0015, -15])
    assert list(record.signals) == ["u", "2D-3"]


def test_settings_of_labview_are_no_table(saved):
    settings = "LabVIEW Measurement\t\nSeparator\tTab\n***End_of_Header***\t\nX0\t0.0\t0.0\n"
    names = "***End_of_Header***\t\nX_Value\tForce\tPosition\tComment\n"
    rows = "0.00\t1.5\t0.1\n0.02\t1.6\t0.2\n0.04\t1.7\t0.3\n"
    record = saved(settings + names + rows, columns={"time": "X_Value:s", "u": "Force"})["flight"]
    np.testing.assert_allclose(record.time, [0, 0.02, 0.04])
    np.testing.assert_array_equal(record["u"], [1.5, 1.6, 1.7])
    np.testing.assert_array_equal(record["Position"], [0.1, 0.2, 0.3])


def test_a_table_without_a_time_holds_rows(saved):
    recording = saved("x [V]; y [m held]\n3,5; 2\n1,25; nan\n2,0; 4\n")
    record = recording["flight"]
    assert not record.has_time
    assert (len(record), record.units, dict(record.hold)) == (3, {"x": "V", "y": "m"}, {})
    np.testing.assert_array_equal(record["x"], [3.5, 1.25, 2])
    np.testing.assert_array_equal(record["y"], [2, np.nan, 4])
    assert str(record) == "flight: 3 rows without a time: x (V), y (m)"


def test_other_encodings(saved):
    assert saved("t,Neigung [°]\n0,1\n1,2\n".encode("cp1252"))["flight"].units == {"Neigung": "°"}
    assert saved("t,Neigung [°]\n0,1\n1,2\n".encode("utf-8-sig"))["flight"].units == {
        "Neigung": "°"
    }


SECONDS = {
    "s": 1,
    "sec": 1,
    "seconds": 1,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "ns": 1e-9,
    "min": 60,
    "h": 3600,
}


@pytest.mark.parametrize("unit", SECONDS)
def test_times_have_the_unit_that_their_column_states(saved, unit):
    record = saved(f"time [{unit}],x\n0,1\n2000,2\n4000,3\n")["flight"]
    np.testing.assert_allclose(np.diff(record.time), 2000 * SECONDS[unit])


@pytest.mark.parametrize("units", ["s,deg,deg/s,", "[s],[deg],[deg/s],[-]", "(s),(deg),(deg/s),()"])
def test_units_are_in_a_line_below_the_names(saved, units):
    rows = "".join(f"{k / 10},1.5,2,3\n" for k in range(9))
    recording = saved(f"time,de,q,n\n{units}\n{rows}")
    record = recording["flight"]
    assert record.units["de"] == "deg"
    assert record.units["q"] == "deg/s"
    assert len(record) == 9
    assert not recording.findings


def test_a_line_of_missing_numbers_is_no_line_of_units(saved):
    assert len(saved("time,de\n0,nan\n1,nan\n2,1.5\n3,1.5\n")["flight"]) == 4


@pytest.mark.parametrize("header", ["Time (msec)", "time [usec]", "sample [min]", "t_ms"])
def test_times_in_any_unit_of_time(saved, header):
    ticks = {"Time (msec)": 1e3, "time [usec]": 1e6, "sample [min]": 1 / 60, "t_ms": 1e3}[header]
    rows = "\n".join(f"{2 * k * ticks:.9f},{k % 3}" for k in range(9))
    recording = saved(f"{header},x\n{rows}\n")
    np.testing.assert_allclose(recording["flight"].time, 2 * np.arange(9), atol=1e-5)
    assert recording.findings == ()


@pytest.mark.parametrize("end", ["", "Z"])
def test_dates_are_times(saved, end):
    rows = (f"2026-05-01T10:59:59.{k:02d}{end},{k}" for k in range(95, 100))
    recording = saved("\n".join(["timestamp,u", *rows, f"2026-05-01 11:00:00{end},100"]))
    np.testing.assert_allclose(recording["flight"].time, 0.01 * np.arange(6), atol=1e-6)
    assert recording["flight"]["u"].tolist() == list(range(95, 101))


@pytest.mark.parametrize("rate", [0, -5.0, float("nan"), float("inf"), "50"])
def test_a_rate_that_is_none_is_named(tmp_path, rate):
    path = tmp_path / "bench.csv"
    path.write_text("u,y\n1,2\n3,4\n")
    with pytest.raises(ValueError, match=f"rate={rate!r} must be a number of Hz above 0"):
        read(path, rate=rate)
