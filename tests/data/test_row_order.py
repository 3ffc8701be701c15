"""Rows in the order of their times: sorted, late, stored twice, in coarse stamps; runs and devices stay apart."""

import numpy as np
import pytest

import greybox as gb
from greybox.data.row_order import ordered_rows

TIME = 0.02 * np.arange(300)
X = np.sin(TIME)


def read(tmp_path, time, *columns, header="time [s],x"):
    path = tmp_path / "flight.csv"
    table = np.column_stack([time, *columns])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
    log = gb.read(path)
    return log["flight"], log.findings


@pytest.mark.parametrize(
    "order",
    [
        np.arange(300)[::-1],
        np.random.default_rng(2).permutation(300),
        np.r_[np.arange(100), 101, 102, 100, np.arange(103, 300)],  # one row is late
    ],
)
def test_rows_out_of_order_are_sorted(tmp_path, order):
    record, findings = read(tmp_path, TIME[order], X[order])
    np.testing.assert_allclose(record.time, TIME, atol=1e-8)
    np.testing.assert_allclose(record["x"], X, atol=1e-7)
    assert "the rows were sorted by it" in findings[0]


@pytest.mark.parametrize(("at", "damaged"), [(50, 777.0), (50, 2.013), (200, 0.0)])
def test_a_row_with_a_damaged_time_is_not_put_elsewhere(tmp_path, at, damaged):
    time = TIME.copy()
    time[at] = damaged
    record, findings = read(tmp_path, time, X)
    np.testing.assert_allclose(record["x"], np.delete(X, at), atol=1e-7)
    assert "1 of 300 samples dropped" in findings[0]


def test_runs_that_begin_again_are_not_merged(tmp_path):
    record, findings = read(tmp_path, np.tile(TIME, 3), np.tile(X, 3))
    np.testing.assert_allclose(record["x"], np.tile(X, 3), atol=1e-7)
    assert [len(piece) for piece in record.pieces] == [300, 300, 300]
    assert "the clock restarted" in findings[0]


@pytest.mark.parametrize(("tick", "rate"), [(1.0, 20.0), (0.1, 37.0), (0.01, 250.0), (0.016, 100)])
@pytest.mark.parametrize("rounding", [np.floor, np.round])
def test_rows_in_coarse_stamps_are_those_of_a_uniform_clock(tmp_path, tick, rate, rounding):
    exact = np.arange(3000) / rate
    stamps = tick * rounding(np.round(exact / tick, 6))
    record, _ = read(tmp_path, stamps, np.sin(exact))
    assert len(record) == 3000
    assert record.step == pytest.approx(1 / rate, rel=2e-3)
    times = gb.prepare(record, {"x": "x"}).time
    np.testing.assert_allclose(np.diff(times), 1 / rate, rtol=2e-3)


def test_bursts_in_coarse_stamps_are_spread_over_them():
    stamps = np.repeat([0.0, 1.0, 2.0, 3.0, 4.0], [1, 9, 2, 9, 1])
    time, rows, (text,) = ordered_rows(stamps)
    assert np.all(np.diff(time) > 0)
    assert np.all((time >= stamps) & (time < stamps + 1))
    assert "were spread over it" in text
    assert rows.tolist() == list(range(22))


def test_rows_that_are_stored_twice_are_used_once(tmp_path):
    record, findings = read(tmp_path, np.repeat(TIME, 2), np.repeat(X, 2))
    np.testing.assert_allclose(record.time, TIME, atol=1e-8)
    assert "300 rows stored twice" in findings[0]


def test_devices_in_turn_are_not_mixed(tmp_path):
    device = np.tile([0.0, 1.0], 300)
    both = np.repeat(X, 2) + 5 * device
    record, findings = read(tmp_path, np.repeat(TIME, 2), device, both, header="time [s],id,x")
    np.testing.assert_allclose(record["x"], X, atol=1e-7)
    assert "several devices" in findings[0]


def test_the_rows_of_a_data_frame_are_sorted_too():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"x": X[::-1]}, index=pandas.Index(TIME[::-1], name="time"))
    record = gb.Record.from_pandas(frame)
    np.testing.assert_array_equal(record["x"], X)
    np.testing.assert_array_equal(record.time, TIME)
