"""Records and responses as pandas data frames, and back."""

import numpy as np
import pytest
from declared_models import TWO_LAGS_OMEGA, Lag, measured

import greybox as gb

TIME = np.arange(6) * 0.1
SIGNALS = {"u": np.arange(6.0), "y": np.array([1, 2, np.nan, 4, 5, 6])}
RECORD = gb.Record(TIME, SIGNALS, {"u": "1", "y": "rad"}, name="flight", hold={"u": np.inf})


@pytest.fixture(scope="module")
def pd():
    return pytest.importorskip("pandas")


def test_a_record_comes_back_as_it_was(pd):
    frame = RECORD.to_pandas()
    assert frame.index.name == "time"
    assert frame.loc[0.05:0.35, "u"].tolist() == [1, 2, 3]
    again = gb.Record.from_pandas(frame)
    for name, values in SIGNALS.items():
        np.testing.assert_array_equal(again[name], values)
    assert (again.units, again.hold, again.name) == (RECORD.units, RECORD.hold, "flight")
    assert again.checksum == gb.Record(TIME, SIGNALS).checksum


def test_names_with_brackets_come_back(pd):
    signals = {"V (N)": TIME, "x (column 2)": TIME, "Pitch (deg)": TIME}
    record = gb.Record(TIME, signals, {"V (N)": "m/s", "x (column 2)": "", "Pitch (deg)": "rad"})
    again = gb.Record.from_pandas(record.to_pandas())
    assert ([*again.signals], again.units) == ([*record.signals], record.units)


def test_frames_of_ones_own(pd):
    plain = {"t": [0.0, 0.5, 1.0], "x": pd.array([1, None, 3], dtype="Int64")}
    record = gb.Record.from_pandas(pd.DataFrame(plain), time="t", units={"x": "m"}, name="mine")
    assert list(record.time) == [0, 0.5, 1]
    np.testing.assert_array_equal(record["x"], [1, np.nan, 3])
    assert (record.units, record.name, list(record.signals)) == ({"x": "m"}, "mine", ["x"])
    dates = pd.date_range("2026-11-21 08:00", periods=3, freq="20ms")
    for index in (dates, dates.tz_localize("Europe/Prague"), dates - dates[0]):
        assert gb.Record.from_pandas(
            pd.DataFrame({"x": [1, 2, 3]}, index=index)
        ).time == pytest.approx([0, 0.02, 0.04])
    assert not gb.Record.from_pandas(pd.DataFrame({"x": [1, 2]}), has_time=False).has_time


def test_a_frame_of_columns_is_a_mapping_of_signals(pd):
    assert gb.Record(TIME, pd.DataFrame(SIGNALS)).checksum == gb.Record(TIME, SIGNALS).checksum


@pytest.mark.parametrize("name", ["time", "t", "timestamp", "Time (s)", "time_ms", "Time [ms]"])
def test_a_column_of_times_is_the_time(pd, name):
    """Not the number of the row, which would be taken for seconds."""
    ticks = TIME * (1e3 if "ms" in name else 1)
    record = gb.Record.from_pandas(pd.DataFrame({name: ticks, "x": SIGNALS["u"]}))
    np.testing.assert_allclose(record.time, TIME)
    assert list(record.signals) == ["x"]
    for times in (pd.to_datetime(TIME, unit="s"), pd.to_timedelta(TIME, unit="s")):
        dated = gb.Record.from_pandas(pd.DataFrame({"when": times, "x": ticks}), time="when")
        np.testing.assert_allclose(dated.time, TIME, atol=1e-9)


def test_what_is_no_table_of_numbers_is_refused(pd):
    dates = pd.to_datetime([0.0, 1.0], unit="s")
    for values in (["a", "b"], np.array([1.0, 2.0], dtype=object), [1j, 2j], dates):
        frame = pd.DataFrame({"t": [0.0, 0.1], "x": values})
        with pytest.raises(ValueError, match=r"the column 'x' of .* does not contain numbers"):
            gb.Record.from_pandas(frame)
    with pytest.raises(ValueError, match="the data frame has no column 't'; it has x"):
        gb.Record.from_pandas(pd.DataFrame({"x": [1.0, 2.0]}), time="t")
    for index in (["first", "second"], [3, 5], None):
        with pytest.raises(ValueError, match="the data frame has no time"):
            gb.Record.from_pandas(pd.DataFrame({"x": [1.0, 2.0]}, index=index))
    with pytest.raises(TypeError, match=r"give a pandas\.DataFrame"):
        gb.Record.from_pandas([1, 2, 3])


def test_a_response_and_a_fit_are_tables(pd):
    data = measured(
        Lag(),
        TWO_LAGS_OMEGA,
        {"K": 2.0},
        noise=0.05,
        columns={"coherence": np.full(len(TWO_LAGS_OMEGA), 0.9)},
    )
    frame = data.to_pandas()
    assert list(frame.columns) == ["alpha", "beta", "coherence"]
    np.testing.assert_array_equal(frame["alpha"] + 1j * frame["beta"], data.response)
    np.testing.assert_array_equal(frame.index, data.omega)

    fit = gb.fit(gb.Problem(Lag(), data), starts=4, progress=False)
    table = fit.to_pandas(level=0.9)
    assert table["value"].to_dict() == {**fit.estimate, **fit.derived}
    assert (table.loc["K", "low"], table.loc["K", "high"]) == fit.interval(0.9)["K"]
    assert tuple(table.loc["T", ["lower_bound", "upper_bound"]]) == Lag.parameters["T"].bounds
    assert table["kind"].tolist() == ["free", "free", "derived", "derived"]


def test_without_pandas_the_sentence_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(
        ModuleNotFoundError, match=r"to_pandas\(\) needs pandas: pip install 'greybox-id\[pandas\]'"
    ):
        RECORD.to_pandas()
