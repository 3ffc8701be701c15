"""Windows of a record, against loops over its samples."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import greybox as gb
from greybox.assessment.simulation.prediction import cut, default_length, sample_data, seconds


def record(count=60, step=0.1, missing=(), unmeasured=()):
    time = step * np.arange(count)
    u = np.sin(time)
    y = np.cos(time)
    u[list(missing)] = np.nan
    y[list(unmeasured)] = np.nan
    return gb.Record(time, {"u": u, "y": y}, name="r")


def by_hand(data, first, after):
    """Windows written out.

    From the first sample of every run of inputs, one horizon after another.
    """
    rows, begin = [], 0
    known = np.isfinite(data["u"])
    while begin < len(data):
        if not known[begin]:
            begin += 1
            continue
        end = begin
        while end < len(data) and known[end]:
            end += 1
        start = begin
        while start + first + after <= end:
            window = np.arange(start, start + first + after)
            measured = np.isfinite(data["y"][window])
            if measured[:first].any() and measured[first:].any():
                rows.append(window)
            start += after
        begin = end
    return np.array(rows)


@given(
    first=st.integers(1, 9),
    after=st.integers(1, 9),
    missing=st.sets(st.integers(0, 59), max_size=3),
    unmeasured=st.sets(st.integers(0, 59), max_size=40),
)
def test_windows_are_those_of_a_loop(first, after, missing, unmeasured):
    data = record(missing=missing, unmeasured=unmeasured)
    wanted = by_hand(data, first, after)
    if not len(wanted):
        return
    windows = cut(data, ["u"], ["y"], lead=0.1 * first, horizon=0.1 * after)
    assert_array_equal(windows.rows, wanted)
    assert (windows.lead, windows.horizon, len(windows)) == (first, after, len(wanted))


def test_lengths_are_rounded_half_down():
    windows = cut(record(), ["u"], ["y"], lead=0.55, horizon=0.56)
    assert (windows.lead, windows.horizon) == (5, 6)


def test_default_lengths_cover_ten_samples_and_twice_the_delay():
    fast, slow = record(400, step=0.01), record(step=0.2)
    assert default_length([fast], 0.5) == 0.5
    assert_allclose(default_length([fast, slow], 0.5), 2.0)
    assert default_length([fast], 0.5, delay=0.4) == 0.8
    assert default_length([gb.Record(np.zeros(1), {"u": np.zeros(1)})], 0.5) == 0.5


def test_a_short_record_at_a_high_rate_has_room_for_several_windows_of_default_length():
    drive = record(150, step=0.001)  # 0.15 s
    window, lead = default_length([drive], 1.0), default_length([drive], 0.5)
    assert len(cut(drive, ["u"], ["y"], lead=lead, horizon=window)) >= 6


def test_seconds_have_three_digits():
    assert [seconds(v) for v in (0.12345, 12.3456, 123.456, 1234.5, 86400, 1.5e6)] == [
        "0.123",
        "12.3",
        "123",
        "1234",
        "86400",
        "1.5e+06",
    ]


@pytest.mark.parametrize(
    ("lengths", "sentence"),
    [
        (
            {"lead": 0.05, "horizon": 1.0},
            r"lead=0\.05 s is shorter than a sample of r, 0\.1 s: give several samples",
        ),
        (
            {"lead": 4.0, "horizon": 3.0},
            r"no room for lead=4 and horizon=3 s .* lasts 6 s; give a shorter lead",
        ),
    ],
)
def test_lengths_that_cannot_be_are_refused(lengths, sentence):
    with pytest.raises(ValueError, match=sentence):
        cut(record(), ["u"], ["y"], **lengths)


def test_the_input_must_be_there():
    with pytest.raises(
        ValueError,
        match="the record has no signal 'F', an input of the model; it has u, y: name it",
    ):
        cut(record(), ["F"], ["y"], lead=1.0, horizon=1.0)


def test_the_data_of_a_window_are_those_of_its_stretch():
    data = record(missing=[30])
    windows = cut(data, ["u"], ["y"], lead=0.5, horizon=1.0)
    whole, *around, measured, present, step = sample_data(windows, ("u",), np.array([0.2]))
    assert_allclose(step, 0.1)
    assert_allclose(whole, 2)
    # whole samples of the delay, and the inputs before, at and after the delayed one; held before a
    # stretch
    first = np.where(windows.rows < 30, 0, 31)
    for row, shift in enumerate((-3, -2, -1)):
        assert_allclose(around[row], data["u"][np.maximum(windows.rows + shift, first)])
    late = windows.rows - first < 2  # where the delayed input is that of before the stretch
    assert_array_equal(present == 0, late)
    assert_allclose(measured[~late], data["y"][windows.rows][~late])


def test_of_rows_without_a_time_each_that_has_its_inputs_and_some_output_is_a_window():
    lost = np.nan
    signals = {
        "u": np.array([1.0, 2.0, lost, 4.0, 5.0, 6.0]),
        "y": np.array([1.0, lost, 3.0, lost, 5.0, lost]),
        "z": np.array([lost, lost, 3.0, 4.0, 5.0, 6.0]),
    }
    rows = gb.Record(np.arange(6.0), signals, name="rows", has_time=False)
    windows = cut(rows, ["u"], ["y", "z"], lead=1.0, horizon=1.0)
    assert_array_equal(windows.rows, [[0], [3], [4], [5]])
    assert (windows.lead, windows.horizon, len(windows)) == (0, 1, 4)
    with pytest.raises(ValueError, match="rows has no row with all inputs and an output"):
        cut(rows.rows(np.array([1, 2])), ["u"], ["y", "z"], lead=1.0, horizon=1.0)


def test_a_length_may_fall_short_of_a_sample_by_rounding_alone():
    for lengths in (
        {"lead": 0.1 * (1 - 5e-7), "horizon": 0.3},
        {"lead": 0.3, "horizon": 0.1 * (1 - 5e-7)},
    ):
        windows = cut(record(), ["u"], ["y"], **lengths)
        assert {windows.lead, windows.horizon} == {1, 3}
    sentence = r"lead=0\.1 s is shorter than a sample of r, 0\.1 s: give several samples, e\.g\. lead=1, or omit it\."
    with pytest.raises(ValueError, match=sentence):
        cut(record(), ["u"], ["y"], lead=0.1 * (1 - 2e-6), horizon=0.3)
    unnamed = gb.Record(0.2 * np.arange(9), {"u": np.ones(9), "y": np.ones(9)})
    with pytest.raises(
        ValueError,
        match=r"step=0\.05 s is shorter than a sample of the record, 0\.2 s: .* step=2, or",
    ):
        cut(unnamed, ["u"], ["y"], lead=0.4, horizon=0.05, called="step")


def test_a_window_may_take_the_whole_of_a_stretch_and_no_more():
    data = record(count=12)
    assert cut(data, ["u"], ["y"], lead=0.5, horizon=0.7).rows.tolist() == [list(range(12))]
    with pytest.raises(
        ValueError,
        match=r"r has no room for lead=0\.5 and horizon=0\.8 s with .* lasts 1\.2 s; give",
    ):
        cut(data, ["u"], ["y"], lead=0.5, horizon=0.8)
