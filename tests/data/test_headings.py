"""The grammar of headers: one truth in tables, data frames and named columns, whatever the brackets."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.headings import Heading, find_column, heading, headings

TIME = np.arange(0, 5, 0.02)


@pytest.mark.parametrize(
    ("cell", "name", "unit"),
    [
        ("pitch [deg]", "pitch", "deg"),
        (" pitch (deg/s) ", "pitch", "deg/s"),
        ("pitch", "pitch", ""),
        ("q[0]", "q[0]", ""),
        ("a []", "a", ""),
        ("[deg]", "[deg]", ""),
        ("pos[0] [mm]", "pos[0]", "mm"),
        ("q(1) (rad)", "q(1)", "rad"),
        ("R(1,2) [1]", "R(1,2)", "1"),
        ("Pos (X) [mm]", "Pos (X)", "mm"),
        ("x {mm}", "x", "mm"),
        ("pos [mm] (raw)", "pos (raw)", "mm"),
        ("gyroADC[0] (deg/s)", "gyroADC[0]", "deg/s"),
        ("Accel (X) [g]", "Accel (X)", "g"),
        ("c (N/(m/s))", "c", "N/(m/s)"),
        ("thrust [counts]", "thrust", "counts"),
        ("thrust (PWM)", "thrust", "PWM"),
        ("Pitch (cmd)", "Pitch (cmd)", ""),
        ("Alt (baro)", "Alt (baro)", ""),
        ("pos [0]", "pos [0]", ""),
        ("torque [nm]", "torque", "nm"),  # refused where it is used, not lost
        ("rate (degrees per second)", "rate", "degrees per second"),
    ],
)
def test_units_stand_in_brackets(cell, name, unit):
    assert heading(cell) == Heading(name, unit)


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["Pitch (cmd)", "Pitch (meas)"], [("Pitch (cmd)", ""), ("Pitch (meas)", "")]),
        (["V (N)", "V (E)"], [("V (N)", ""), ("V (E)", "")]),
        (["p (min)", "p (max)"], [("p (min)", ""), ("p (max)", "")]),
        (["I (A)", "U (V)"], [("I", "A"), ("U", "V")]),
        (["T (C)", "T (K)"], [("T (C)", "C"), ("T (K)", "K")]),
        (["x", "y", "x"], [("x (column 1)", ""), ("y", ""), ("x (column 3)", "")]),
        (["x [m]", "x [m]"], [("x [m] (column 1)", "m"), ("x [m] (column 2)", "m")]),
    ],
)
def test_every_column_of_a_table_has_a_name_of_its_own(cells, expected):
    assert headings(cells) == expected


@pytest.mark.parametrize(
    ("text", "place", "unit"),
    [
        ("Pos (X)", 0, "mm"),
        ("Pos (X) [mm]", 0, "mm"),
        ("Pos (X) (mm)", 0, "mm"),
        ("Pos (X):cm", 0, "cm"),
        ("Pos (Y) [mm]", 1, "mm"),
        ("stick", 2, ""),
        ("stick (raw):deg", 2, "deg"),
        ("a:b", 3, ""),
        ("a:b:rad", 3, "rad"),
    ],
)
def test_a_column_is_named_with_its_brackets_or_without(text, place, unit):
    columns = headings(["Pos (X) [mm]", "Pos (Y) [mm]", "stick (raw)", "a:b"])
    assert find_column(text, columns) == (place, unit)


def test_columns_of_one_name_are_told_apart_by_their_places():
    columns = headings(["x", "x", "y (a)", "y (b)"])
    with pytest.raises(ValueError, match=r"several columns 'x': name one of 'x \(column 1\)' and"):
        find_column("x", columns)
    assert find_column("x (column 2)", columns).place == 1
    with pytest.raises(ValueError, match="several columns 'y'"):
        find_column("y", columns)


@pytest.mark.parametrize("cell", ["pos[0] [mm]", "Pos (X) [mm]", "x {mm}", "pos [mm] (raw)"])
def test_millimeters_are_millimeters_in_tables_and_data_frames(tmp_path, cell):
    path = tmp_path / "flight.csv"
    rows = "\n".join(f"{t:.2f},{1000 * t:.1f}" for t in TIME)
    path.write_text(f"time [s],{cell}\n{rows}\n")
    record = gb.read(path, columns={"x": cell})["flight"]
    np.testing.assert_allclose(record["x"], TIME, atol=1e-9)
    assert record.units["x"] == "m"

    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"time [s]": TIME, cell: 1000 * TIME})
    assert dict(gb.Record.from_pandas(frame).units) == {heading(cell).name: "mm"}


def test_columns_that_nobody_uses_refuse_nothing(tmp_path):
    path = tmp_path / "flight.csv"
    rows = "\n".join(f"{t:.2f},{t:.2f},1,2,7,7" for t in TIME)
    path.write_text(f"time [s],x [m],y,y,torque [nm],load [lb]\n{rows}\n")
    record = gb.read(path, columns={"x": "x"})["flight"]
    np.testing.assert_allclose(record["x"], TIME, atol=1e-9)
    assert gb.read(path, columns={"y": "y (column 4)"})["flight"]["y"][0] == 2


@pytest.mark.parametrize(
    ("header", "cure", "factor", "si"),
    [
        ("nm", "N*m", 1, "N·m"),
        ("NM", "nmi", 1852, "m"),
        ("lb", "lbf", 4.4482216152605, "N"),
        ("MV", "mV", 1e-3, "V"),
        ("MA", "1e6 A", 1e6, "A"),
        ("ms^-1", "m/s", 1, "m/s"),
        ("m s^-1 held", "", 1, "m/s"),
        ("Nm^-1", "N/m", 1, "N/m"),
    ],
)
def test_a_unit_with_two_readings_is_refused_and_the_cure_works(tmp_path, header, cure, factor, si):
    path = tmp_path / "stand.csv"
    path.write_text(f"time [s],x [{header}]\n0,1\n1,2\n2,4\n")
    if cure:
        with pytest.raises(ValueError, match=r"may be .* write .*") as caught:
            gb.read(path, columns={"x": "x"})
        assert cure in str(caught.value)
    record = gb.read(path, columns={"x": f"x:{cure}" if cure else "x"})["stand"]
    np.testing.assert_allclose(record["x"], factor * np.array([1, 2, 4]))
    assert record.units["x"] == si


@pytest.mark.parametrize("unit", ["PWM", "counts", "furlong"])
def test_a_unit_that_greybox_does_not_know_stays_or_is_stated(tmp_path, unit):
    path = tmp_path / "stand.csv"
    path.write_text(f"time [s],x [{unit}]\n0,1\n1,2\n2,4\n")
    log = gb.read(path, columns={"u": "x"})
    assert log["stand"].units["u"] == unit
    assert any("taken as it is" in finding for finding in log["stand"].findings)
    np.testing.assert_allclose(gb.read(path, columns={"u": "x:mm"})["stand"]["u"][2], 0.004)


TABLES = {
    "a comment above a text": "%time,frame,x\n0,world,1\n0.5,world,2\n1,world,3\n",
    "a comment above an empty cell": "# time,x,y\n0,1,\n0.5,2,\n1,3,4\n",
    "units in a comment": "# time x\n# s mm\n0 1000\n0.5 2000\n1 3000\n",
    "a line of units with a one": "time,u,x\ns,1,mm\n0,1,1000\n0.5,1,2000\n1,1,3000\n",
    "a repeated header": "time,x\n0,1\n0.5,2\ntime,x\n1,3\n",
    "zeros at the end": "time,x\n0,1\n0.5,2\n1,3\n\0\0\0",
    "names that are numbers": "time,x,0,1\n0,1,5,5\n0.5,2,5,5\n1,3,5,5\n",
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
def test_headers_are_found(tmp_path, text):
    path = tmp_path / "flight.csv"
    path.write_text(text)
    record = gb.read(path, columns={"x": "x"})["flight"]
    assert record.time.tolist() == [0, 0.5, 1]
    assert record["x"].tolist() == [1, 2, 3]


def test_a_table_without_a_header_keeps_its_first_row_beside_a_text(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("0,take-off,1\n0.5,,2\n1,landing,3\n")
    record = gb.read(path, columns={"time": "1:s", "x": "3"})["flight"]
    assert record["x"].tolist() == [1, 2, 3]


@pytest.mark.parametrize("second", ["time,y", "time,x,y", "a,b"])
def test_another_header_in_the_middle_is_refused_with_its_line(tmp_path, second):
    path = tmp_path / "flight.csv"
    rows = "0,1,1\n1,2,2\n" if second.count(",") > 1 else "0,1\n1,2\n"
    path.write_text(f"time,x\n0,1\n1,2\n2,3\n3,4\n4,5\n{second}\n{rows}")
    with pytest.raises(ValueError, match="line 7, is the header of a second table: save each"):
        gb.read(path)


@pytest.mark.parametrize("cell", ["1 234.5", "1'234.5", "1\u202f234,5", "1.234.567", "12 345"])
def test_thousands_are_refused_whatever_separates_them(tmp_path, cell):
    path = tmp_path / "flight.csv"
    path.write_text(f"time;x\n0;1\n1;{cell}\n2;3\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"line 3: .* has a thousands separator: leave it out"):
        gb.read(path)


def test_numbers_that_nobody_uses_decide_nothing(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("time;x;load;mass\n0;1.5;1,234;1 234\n0.5;2.5;2,5;1'234\n1;3.5;3;1.234.567\n")
    with pytest.raises(ValueError, match="thousands separator"):
        gb.read(path)
    record = gb.read(path, columns={"x": "x"})["flight"]
    assert record["x"].tolist() == [1.5, 2.5, 3.5]


@pytest.mark.parametrize("clock", ["t", "time", "Time [s]"])
def test_a_clock_decides_the_decimal_mark_though_only_a_signal_is_named(tmp_path, clock):
    path = tmp_path / "flight.csv"
    path.write_text(f"{clock};x;n\n0,0;1;7\n0,5;2;8\n1,0;3;9\n")
    record = gb.read(path, columns={"x": "x"})["flight"]
    assert record.time.tolist() == [0, 0.5, 1]


def test_a_text_beside_a_column_of_numbers_is_not_meant(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("time,x,x (note)\n0,1,a\n0.5,2,b\n1,3,c\n")
    assert gb.read(path, columns={"x": "x"})["flight"]["x"].tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="no numbers in the column"):
        gb.read(path, columns={"x": "x (note)"})


def test_files_of_unlike_headers_have_one_statement(tmp_path):
    columns = {"time": "t:ms,Time", "x": "pos,Position (X)"}
    for header, scale in {"t,pos [mm]": 1000, "Time [s],Position (X) [m]": 1}.items():
        path = tmp_path / "flight.csv"
        rows = "\n".join(f"{scale * t:.3f},{scale * t:.3f}" for t in TIME)
        path.write_text(f"{header}\n{rows}\n")
        record = gb.read(path, columns=columns)["flight"]
        np.testing.assert_allclose(record.time, TIME, atol=1e-9)
        np.testing.assert_allclose(record["x"], TIME, atol=1e-9)
    with pytest.raises(ValueError, match=r"name both: x=altitude,COLUMN"):
        gb.read(path, columns={"x": "altitude"})


def test_a_hold_and_units_can_be_stated_after_reading(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("time,u,x [mm],y [nm]\n0,1,1000,1\n0.5,2,2000,2\n1,3,3000,3\n")
    record = gb.read(path)["flight"].stated(units={"u": "deg"}, hold={"u": "held", "x": 0.0})
    assert (record.hold, record.units["u"]) == ({"u": np.inf, "x": 0.0}, "deg")
    in_si = record.in_si(["u", "x"])
    np.testing.assert_allclose(in_si["u"], np.radians([1, 2, 3]))
    assert in_si["x"].tolist() == [1, 2, 3]
    with pytest.raises(ValueError, match="nm may be a torque or a length"):
        record.in_si()
    np.testing.assert_allclose(record.stated({"y": "N*m"}).in_si()["y"], [1, 2, 3])


def test_names_of_signals_may_have_dots(tmp_path):
    path = tmp_path / "flight.csv"
    rows = "\n".join(f"{t:.2f},{t:.2f},{2 * t:.2f}" for t in TIME)
    path.write_text(f"time [s],cmd.x,pose.x.value\n{rows}\n")
    log = gb.read(path)
    signals = {"u": "cmd.x", "y": "flight.pose.x.value"}
    record = gb.prepare(log, signals)
    np.testing.assert_allclose(record["y"], 2 * record["u"])
    with pytest.raises(KeyError, match="cmd"):
        gb.prepare(log, {"u": "cmd.y"})


def test_names_in_files_of_arrays_follow_the_grammar(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "flight.h5"
    with h5py.File(path, "w") as file:
        file["stamp.sec"], file["stamp.nanosec"] = np.floor(TIME), np.round(TIME % 1 * 1e9)
        file["Pos (X) [mm]"] = 1000 * TIME
        file["T"] = 300 - TIME
    record = gb.read(path, columns={"x": "Pos (X)"})["flight"]
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    np.testing.assert_allclose(record["x"], TIME)
