"""The grammar of clocks against known truths: each is read right, or refused with a cure that works."""

import itertools
import re
import shlex

import numpy as np
import pytest

import greybox as gb
from greybox.cli.main import main
from greybox.data.time_column import clock_names, seconds, times_in_seconds

TIME = np.arange(0, 5, 0.02)


@pytest.mark.parametrize(
    ("name", "unit", "start", "ticks", "word"),
    [
        ("time", "", 1_700_000_000 * 10**9, 1e9, "ns since 1970"),  # ROS
        ("timestamp", "", 1_700_000_000 * 10**6, 1e6, "µs since 1970"),
        ("time", "", 1_700_000_000_000, 1e3, "ms since 1970"),
        ("t", "", 1_700_000_000, 1.0, "s since 1970"),
        ("timestamp", "", 123_456_789, 1e6, "taken for µs"),  # ulog2csv of PX4
        ("Timestamp", "", 51_234, 1e3, "taken for ms"),  # the client of Crazyflie
        ("timestamp", "", 5_000_000_000, 1e9, "taken for ns"),  # ROS 2, since the start
        ("micros", "", 7.0, 1e6, ""),
        ("Millis", "", 7.0, 1e3, ""),
        ("Time_ms", "", 7.0, 1e3, ""),
        ("time_boot_ms", "", 7.0, 1e3, ""),
        ("time", "", 3.0, 1.0, ""),
        ("time", "ms", 0.0, 1e3, ""),
        ("time_us", "", 7.0, 1e6, ""),
        ("timestamp_sample", "", 7.0, 1e6, ""),
        ("SampleUS", "", 7.0, 1e6, ""),
    ],
)
def test_the_clock_is_told_by_name_and_size(name, unit, start, ticks, word):
    times, findings = times_in_seconds(name, unit, start + np.round(ticks * TIME, 9))
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-6)
    assert [word in text for text in findings] == [True] * bool(word)


def test_days_of_matlab_are_times():
    times, findings = times_in_seconds("datenum", "", 738_000 + TIME / 86_400)
    np.testing.assert_allclose(times, TIME, atol=1e-4)  # the digits of a day
    assert "taken for days" in findings[0]
    assert clock_names({"datenum": 738_000 + TIME / 86_400, "x": TIME}, {}) == ("datenum",)


@pytest.mark.parametrize("name", ["timestamp", "time", "t"])
def test_seconds_of_the_day_run_on_at_midnight(name):
    times, findings = times_in_seconds(name, "", (86_398 + TIME) % 86_400)
    np.testing.assert_allclose(times, 86_398 + TIME)
    assert "starts again after 86400" in findings[0]


@pytest.mark.parametrize("clock", ["timestamp", "timestamp [us]", "TimeUS"])
@pytest.mark.parametrize("name", ["timestamp_sample", "SampleUS"])
def test_the_clock_of_the_samples_beats_that_of_the_rows(tmp_path, clock, name):
    path = tmp_path / "flight.csv"
    sampled = np.round(1e6 * (3 + TIME))
    late = sampled + np.random.default_rng(0).integers(300, 900, sampled.size)
    written(path, [clock, name, "x"], late, sampled, TIME)
    np.testing.assert_allclose(gb.read(path)["flight"].time, 3 + TIME, atol=1e-9)
    # A stamp that is never set is no clock.
    written(path, [clock, name, "x"], late, 0 * sampled, TIME)
    record, _ = read_or_cured(path, "us")
    np.testing.assert_allclose(record.time, late / 1e6, atol=1e-9)


def test_a_clock_that_stands_still_needs_a_rate(tmp_path, capsys):
    path = tmp_path / "flight.csv"
    written(path, ["time", "x"], 5 + 0 * TIME, TIME)
    with pytest.raises(ValueError, match=r"stands still: .* state the rate, rate=HZ"):
        gb.read(path)
    np.testing.assert_allclose(gb.read(path, rate=50)["flight"].time, TIME)
    assert main(["inspect", str(path)]) == 2
    assert main(["inspect", str(path), "--rate", "50"]) == 0


def test_a_time_beats_the_hours_minutes_and_seconds_of_a_receiver():
    """As in the tables of an altimeter with a receiver of satellites."""
    day = {"hour": 20 + 0 * TIME, "minute": 10 + 0 * TIME, "second": np.floor(TIME)}
    assert clock_names({**day, "x": TIME}, {}) == ("hour", "minute", "second")
    assert clock_names({**day, "time": TIME, "x": TIME}, {}) == ("time",)
    assert clock_names({**day, "time": 0 * TIME, "x": TIME}, {}) == ("hour", "minute", "second")


def test_slow_samples_in_seconds_are_said():
    times, findings = times_in_seconds("t", "", 20 * np.arange(5.0))
    assert times[1] == 20
    assert "taken for s, 0.05 Hz" in findings[0]
    assert times_in_seconds("t", "", 0.8 * np.arange(5.0))[1] == ()


@pytest.mark.parametrize("step", [1e5, 1e-6])
def test_an_implausible_rate_asks_for_the_unit(step):
    with pytest.raises(ValueError, match=r"no unit.* Hz .*: state its unit"):
        times_in_seconds("time", "", step * np.arange(5.0))
    assert times_in_seconds("time", "s", step * np.arange(5.0))[1] == ()


def test_a_timestamp_that_counts_by_one_asks_for_the_unit():
    with pytest.raises(ValueError, match="may count samples, ms or s"):
        times_in_seconds("timestamp", "", 4000 + np.arange(50.0))
    assert times_in_seconds("timestamp", "ms", np.arange(5.0))[0][1] == 1e-3


def written(path, header, *columns, separator=","):
    """Write a table; numbers have all their digits."""
    texts = [[c if isinstance(c, str) else f"{c:.17g}" for c in column] for column in columns]
    rows = (separator.join(row) for row in zip(*texts, strict=True))
    path.write_text("\n".join([separator.join(header), *rows, ""]))


def read_or_cured(path, stated):
    """Return the record of a table, and whether it was read only with the cure of the refusal.

    The cure is typed as it stands, with the true unit in it.
    """
    try:
        return gb.read(path)["flight"], False
    except ValueError as error:
        name, _, text = shlex.split(re.search(r"columns=(.+), or 'time \[", str(error))[1])[
            0
        ].partition("=")
        column = text.rpartition(":")[0]
        return gb.read(path, columns={name: f"{column}:{stated}"})["flight"], True


@pytest.mark.parametrize("name", ["timestamp", "time", "t"])
@pytest.mark.parametrize("start", [0.0, 3.0, 112.574])
def test_a_clock_without_a_unit_is_right_or_refused_with_a_cure(tmp_path, name, start):
    """Also where the step alone would be right for two units: 1 kHz in µs is 1 Hz in ms."""
    refused = 0
    rates = [(1, 60), (1, 2000), (10, 600), (50, 300), (100, 6000), (250, 3000), (1000, 3000)]
    for (rate, count), (unit, ticks) in itertools.product(
        rates, {"s": 1, "ms": 1e3, "us": 1e6, "ns": 1e9}.items()
    ):
        exact = start + np.arange(count) / rate
        stamps = np.round(exact * ticks) if ticks > 1 else exact
        path = tmp_path / "flight.csv"
        written(path, [name, "x"], stamps, np.sin(exact))
        record, was_refused = read_or_cured(path, unit)
        np.testing.assert_allclose(record.time - record.time[0], exact - start, atol=6e-4)
        refused += was_refused
    # Most counters are read without a question; what is called a time must be in seconds.
    assert refused <= (10 if name == "timestamp" else 22)


CLOCKS = {
    "time [s]": 1.0,
    "Time(s)": 1.0,
    "__time": 1.0,
    "elapsed_s": 1.0,
    "Elapsed Time (ms)": 1e3,
    "time_us": 1e6,
    "TimeUS": 1e6,
    "millis": 1e3,
    "time since start {ms}": 1e3,
    "Timestamp [µs]": 1e6,
    "time (boot) [ms]": 1e3,
    "field.header.stamp [ns]": 1e9,
    "Zeit [s]": 1.0,
}
NAMES = ("pos", "pos[0]", "Pos (X)", "q(1)", "roll rate", "v.x", "Höhe")
BRACKETS = ("{} [{}]", "{} ({})", "{} {{{}}}", "{}[{}]", "{} [{} held]", "{} [{}] (raw)")
UNITS = {"mm": 1e-3, "deg/s": np.pi / 180, "°/s": np.pi / 180, "kN": 1e3, "m s^-2": 1.0, "%": 0.01}


def test_mutated_headers(tmp_path):
    """Names, units, brackets, clocks and separators in all pairs: 84 of their combinations."""
    path = tmp_path / "flight.csv"
    pairs = [(n, b, u) for n, b in itertools.product(NAMES, BRACKETS) for u in UNITS]
    clocks = itertools.cycle(CLOCKS.items())
    separators = itertools.cycle(",;\t")
    for name, bracket, unit in pairs[::3]:
        clock, ticks = next(clocks)
        cell = bracket.format(name, unit)
        written(path, [clock, cell], TIME * ticks, TIME + 1, separator=next(separators))
        record = gb.read(path, columns={"x": cell})["flight"]
        np.testing.assert_allclose(record.time, TIME, atol=1e-9, err_msg=f"{clock},{cell}")
        np.testing.assert_allclose(record["x"], UNITS[unit] * (TIME + 1), err_msg=cell)


@pytest.mark.parametrize("other", ["T", "t", "T [K]", "T (ms)"])
@pytest.mark.parametrize("clock", ["time [s]", "time", "Timestamp [s]"])
def test_a_full_name_beats_a_short_one_wherever_it_stands(tmp_path, other, clock):
    path = tmp_path / "flight.csv"
    for header in ([other, clock], [clock, other]):
        columns = {clock: TIME, other: 300 - TIME}
        written(path, header, *(columns[name] for name in header))
        record = gb.read(path)["flight"]
        np.testing.assert_allclose(record.time, TIME)
        assert len(record.signals) == 1


def test_a_temperature_is_no_time():
    columns = {"T": 20 + np.sin(TIME), "x": TIME}
    assert clock_names(columns, {}) == ()
    assert clock_names({"T": TIME, "x": TIME}, {}) == ("T",)
    assert seconds("flight_time") is None


def test_a_temperature_is_no_time_where_the_time_cannot_be_read(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("time,T,x\n05/01/2026 10:00,20,1\n05/01/2026 10:01,21,2\n")
    with pytest.raises(ValueError, match="'time', which is not a time in numbers"):
        gb.read(path)
    assert gb.read(path, columns={"time": "T:s"})["flight"].step == 1


def test_a_stated_clock_beats_two_columns_and_these_beat_one_without_a_unit():
    columns = {"sec": np.zeros(250), "nanosec": 1e6 * np.arange(250), "time": TIME}
    assert clock_names(columns, {"time": "s"}) == ("time",)
    assert clock_names(columns, {}) == ("sec", "nanosec")
    assert clock_names({"pulse_s": TIME, "pulse_ms": 1e3 * TIME % 1}, {}) == ()


@pytest.mark.parametrize("prefix", ["", "stamp.", "header.stamp.", "time_"])
@pytest.mark.parametrize("epoch", [0.0, 1.7e9])
@pytest.mark.parametrize(
    ("whole", "part", "ticks"),
    [("sec", "nanosec", 1e9), ("secs", "nsecs", 1e9), ("seconds", "usec", 1e6)],
)
def test_seconds_and_their_fractions_are_one_time(tmp_path, prefix, epoch, whole, part, ticks):
    path = tmp_path / "flight.csv"
    hundredths = 50 + 2 * np.arange(250)
    columns = epoch + hundredths // 100, hundredths % 100 * (ticks / 100)
    written(path, [prefix + whole, prefix + part, "x"], *columns, TIME)
    record = gb.read(path)["flight"]
    np.testing.assert_allclose(np.diff(record.time), 0.02, atol=1e-6)
    assert list(record.signals) == ["x"]


@pytest.mark.parametrize("start", [36_000.0, 86_398.0])
def test_a_date_and_a_time_are_one_time_also_across_midnight(tmp_path, start):
    path = tmp_path / "flight.csv"
    milliseconds = np.round(1000 * (start + TIME)).astype(int)
    dates = [f"2026-05-{1 + ms // 86_400_000:02d}" for ms in milliseconds]
    seconds_of_day = milliseconds % 86_400_000 / 1000
    times = [f"{s // 3600:02.0f}:{s // 60 % 60:02.0f}:{s % 60:06.3f}" for s in seconds_of_day]
    for header, columns in {
        ("Date", "Time"): (dates, times),
        ("Time (HH:MM:SS)",): (times,),
        ("UTC",): ([f"{d}T{t}Z" for d, t in zip(dates, times, strict=True)],),
    }.items():
        written(path, [*header, "x"], *columns, TIME)
        record = gb.read(path)["flight"]
        np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-6)


@pytest.mark.parametrize("start", [36_059.0, 86_398.0])
def test_hours_minutes_and_seconds_are_one_time(tmp_path, start):
    path = tmp_path / "flight.csv"
    of_day = np.round(start + TIME, 6) % 86_400
    columns = of_day // 3600, of_day // 60 % 60, of_day % 60
    written(path, ["Hour", "Minute", "Second", "x"], *columns, TIME)
    record = gb.read(path)["flight"]
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=1e-6)
    assert list(record.signals) == ["x"]


@pytest.mark.parametrize(
    ("name", "ticks", "bits"),
    [("time_us", 1e6, 32), ("micros", 1e6, 32), ("time_ms", 1e3, 16), ("millis", 1e3, 32)],
)
def test_a_counter_that_starts_again_runs_on(tmp_path, name, ticks, bits):
    path = tmp_path / "flight.csv"
    written(path, [name, "x"], np.round((TIME - 2) * ticks) % 2**bits, TIME)
    log = gb.read(path)
    np.testing.assert_allclose(log["flight"].time - log["flight"].time[0], TIME, atol=1e-6)
    assert any("starts again after" in finding for finding in log.findings)


def test_a_restart_is_no_counter_that_starts_again(tmp_path):
    path = tmp_path / "flight.csv"
    written(path, ["time_us", "x"], np.r_[TIME + 100, TIME] * 1e6, np.r_[TIME, TIME])
    log = gb.read(path)
    assert "the clock restarted" in log.findings[0]


@pytest.mark.parametrize("day", [46_143.4583, 739_000.25])
@pytest.mark.parametrize(("rate", "count"), [(10, 1000), (50, 300)])
def test_days_of_a_spreadsheet_are_days(tmp_path, day, rate, count):
    path = tmp_path / "flight.csv"
    exact = np.arange(count) / rate
    written(path, ["time", "x"], day + exact / 86_400, exact)
    record, _ = read_or_cured(path, "days")
    # Days have 1e-11 of a day behind the decimal point, 1e-6 s.
    np.testing.assert_allclose(record.time - record.time[0], exact, atol=2e-5)


def test_what_is_stated_must_be_a_unit_of_time(tmp_path):
    path = tmp_path / "flight.csv"
    written(path, ["clock", "x"], TIME, TIME)
    with pytest.raises(ValueError, match="'V', which is no unit of time"):
        gb.read(path, columns={"time": "clock:V"})
    np.testing.assert_allclose(gb.read(path, columns={"time": "clock:s"})["flight"].time, TIME)


def test_a_float_index_does_not_beat_a_column_of_times():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"time": TIME, "x": TIME}, index=1.5 * np.arange(250))
    np.testing.assert_array_equal(gb.Record.from_pandas(frame).time, TIME)
    alone = pandas.DataFrame({"x": TIME}, index=1.5 * np.arange(250))
    assert gb.Record.from_pandas(alone).step == 1.5
    pair = pandas.DataFrame({"sec": np.floor(TIME), "nsec": np.round(TIME % 1 * 1e9), "x": TIME})
    np.testing.assert_allclose(gb.Record.from_pandas(pair).time, TIME, atol=1e-9)
