"""Tables that do not name their columns."""

import numpy as np
import pytest

import greybox as gb

TIME = np.arange(0, 5, 0.01)
TABLE = np.c_[1e3 * TIME, np.sin(TIME), np.cos(TIME)]
COLUMNS = {"time": "1:ms", "u": "2", "theta": "3:deg"}


@pytest.mark.parametrize("separator", [" ", "   ", "\t", ",", ";"])
@pytest.mark.parametrize("comment", ["", "% made for a test\n"])
def test_a_table_without_a_header_goes_by_numbers(tmp_path, separator, comment):
    path = tmp_path / "flight.asc"
    rows = "\n".join(separator.join(f"{x:.9f}" for x in row) for row in TABLE)
    path.write_text(f"{comment}{rows}\n")
    record = gb.read(path, columns=COLUMNS)["flight"]
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)
    np.testing.assert_allclose(record["u"], np.sin(TIME), atol=1e-8)
    np.testing.assert_allclose(record["theta"], np.radians(np.cos(TIME)), atol=1e-9)
    assert record.units["theta"] == "rad"
    with pytest.raises(ValueError, match=r"has no column '4'; it has 1, 2, 3"):
        gb.read(path, columns={"time": "1", "u": "4"})
    with pytest.raises(ValueError, match="has no header line"):
        gb.read(path)


def test_a_derivative_per_degree_is_not_taken_for_an_angle(tmp_path):
    path = tmp_path / "tunnel.csv"
    path.write_text("time,dCL/deg\n0,0.1\n1,0.2\n")
    with pytest.raises(ValueError, match="dCL/deg: is in degrees or per degree: add :deg or"):
        gb.read(path, columns={"CL_alpha": "dCL/deg"})
    record = gb.read(path, columns={"CL_alpha": "dCL/deg:1/deg"})["tunnel"]
    np.testing.assert_allclose(record["CL_alpha"], np.degrees([0.1, 0.2]))
    record = gb.read(path, columns={"elevator": "dCL/deg:deg"})["tunnel"]
    np.testing.assert_allclose(record["elevator"], np.radians([0.1, 0.2]))


def test_names_may_be_replaced(tmp_path):
    path = tmp_path / "flight.csv"
    np.savetxt(path, TABLE, delimiter=",", header="tick,stick,angle", comments="")
    record = gb.read(path, columns={"time": "tick:ms", "theta": "angle:deg"})["flight"]
    assert list(record.signals) == ["stick", "theta"]
    assert record.rate == pytest.approx(100)


def test_a_heading_is_found_as_it_is_written(tmp_path):
    path = tmp_path / "dive.csv"
    np.savetxt(
        path, TABLE, delimiter=",", header="Time (ms),Thruster (rpm),u DVL (m/s)", comments=""
    )
    columns = {"n": "Thruster (rpm)", "u": "u DVL [m/s]"}
    record = gb.read(path, columns=columns)["dive"]
    assert dict(record.units) == {"n": "rad/s", "u": "m/s"}
    with pytest.raises(ValueError, match=r"did you mean 'Thruster \[rpm\]'\?$"):
        gb.read(path, columns={"n": "Thrster [rpm]"})


def test_a_first_column_remains_the_clock_when_others_get_names(tmp_path):
    path = tmp_path / "flight.csv"
    np.savetxt(path, TABLE, delimiter=",", header="Zeit [ms],stick,angle", comments="")
    record = gb.read(path, columns={"theta": "angle:deg"})["flight"]
    assert list(record.signals) == ["stick", "theta"]
    assert record.rate == pytest.approx(100)


def test_of_two_clocks_the_one_that_is_named_is_the_time(tmp_path):
    """The reader takes the column `time`; the other began at 20 s."""
    path = tmp_path / "flight.csv"
    rows = np.c_[TIME, 1e3 * (20 + TIME), np.sin(TIME)]
    np.savetxt(path, rows, delimiter=",", header="time,clock,stick", comments="")
    record = gb.read(path, columns={"time": "clock:ms", "u": "stick"})["flight"]
    np.testing.assert_allclose(record.time, 20 + TIME)
    kept = gb.read(path, columns={"time": "time", "u": "stick"})["flight"]
    np.testing.assert_allclose(kept.time, TIME)


@pytest.mark.parametrize("before", [0, 2])
def test_lines_are_counted_from_the_first_without_a_header_too(tmp_path, before):
    """Where comments or nothing stand before it."""
    path = tmp_path / "flight.txt"
    path.write_text("% made for a test\n" * before + "0 1\n1 oops\n2 3\n3 4\n")
    log = gb.read(path, columns={"time": "1:s", "u": "2"})
    found = f"cells that are not finite numbers, which count as missing: 2 (1 cell, the first 'oops' in line {before + 2})."
    assert log.findings == (found,)
    np.testing.assert_array_equal(log["flight"]["u"], [1, np.nan, 3, 4])


def test_how_a_column_runs_between_samples_stays_with_it(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("t [s],stick [% held],angle [deg sampled],x\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    record = gb.read(path, columns={"u": "stick", "theta": "angle", "x": "x:ft"})["flight"]
    assert record.hold == {"u": np.inf, "theta": 0.0}
    assert record.units == {"u": "1", "theta": "rad", "x": "m"}
    np.testing.assert_allclose(record["x"], 0.3048 * np.array([3, 4, 5]))
    np.testing.assert_allclose(record["u"], [0.01, 0.02, 0.03])


def test_the_option_may_state_how_a_column_runs(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("t [s],stick,angle [deg],x [m held]\n0,1,2,3\n1,2,3,4\n2,3,4,5\n")
    columns = {"u": "stick:1 held", "theta": "angle:sampled", "z": "x:m sampled"}
    record = gb.read(path, columns=columns)["flight"]
    assert record.hold == {"u": np.inf, "theta": 0.0, "z": 0.0}
    assert record.units == {"u": "1", "theta": "rad", "z": "m"}


def test_the_end_of_a_name_is_a_unit_where_the_column_is_named(tmp_path):
    path = tmp_path / "servo.csv"
    path.write_text("t_us,pwm_us,angle_deg\n0,1500,2\n500,1510,3\n1000,1520,4\n")
    columns = {"time": "t_us", "pwm": "pwm_us", "angle": "angle_deg"}
    record = gb.read(path, columns=columns)["servo"]
    np.testing.assert_allclose(record.time, [0, 5e-4, 1e-3])
    np.testing.assert_allclose(record["angle"], np.radians([2, 3, 4]))
    # A pulse in µs is no time.
    np.testing.assert_array_equal(record["pwm"], [1500, 1510, 1520])


def test_the_end_of_a_name_is_a_unit_only_where_it_can_be_nothing_else(tmp_path):
    path = tmp_path / "scope.csv"
    names = "t_us CH1_mV shunt_mA gyro_dps arm_mm cmd_in v_N x_dT lag_ms p_ma".split()
    rows = [",".join([str(k)] + ["1000"] * 9) for k in range(3)]
    path.write_text("\n".join([",".join(names), *rows]))
    record = gb.read(path, columns={name.split("_")[0]: name for name in names})["scope"]
    in_si = {
        "CH1": (1, "V"),
        "shunt": (1, "A"),
        "gyro": (np.radians(1000), "rad/s"),
        "arm": (1, "m"),
    }
    for name, (value, unit) in in_si.items():
        assert (record[name][0], record.units[name]) == (pytest.approx(value), unit)
    for name in ("cmd", "v", "x", "lag", "p"):  # an input, north, a difference, a moving average
        assert (record[name][0], record.units.get(name, "")) == (1000, "")


@pytest.mark.parametrize(
    "name",
    ["q_deg/s", "q deg/s", "q/deg/s", "q:deg/s", "q in deg/s", "q_deg_s", "q_deg/sec", "Q_DEG_S"],
)
@pytest.mark.parametrize("hold", ["", ":held", ":sampled"])
def test_rates_and_words_on_the_hold_leave_the_unit_in_a_name(tmp_path, name, hold):
    path = tmp_path / "flight.csv"
    path.write_text(f"time in s,{name},V_m/s\n0,90,3\n1,90,4\n2,180,5\n")
    record = gb.read(path, columns={"q": name + hold, "V": "V_m/s"})["flight"]
    np.testing.assert_allclose(record["q"], np.radians([90, 90, 180]))
    assert record.units == {"q": "rad/s", "V": "m/s"}
    assert record.hold == {"": {}, ":held": {"q": np.inf}, ":sampled": {"q": 0.0}}[hold]


def test_a_unit_that_the_table_contradicts_is_refused(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("t [s],stick [deg]\n0,1\n1,2\n")
    with pytest.raises(ValueError, match=r"its unit is deg in the table, not V: leave"):
        gb.read(path, columns={"u": "stick:V"})
