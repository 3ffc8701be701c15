import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from greybox.logs.readers import time_stamps


def test_a_steady_clock_is_left_alone():
    stamps = np.arange(1000) / 100
    shifted, findings = time_stamps.one_clock(stamps)
    np.testing.assert_array_equal(shifted, stamps)
    assert findings == ()


def test_three_boots_follow_each_other():
    stamps = np.concatenate([np.arange(100, 200, 0.1), np.arange(5, 60, 0.1), np.arange(2, 30, 0.1)])
    shifted, findings = time_stamps.one_clock(stamps)
    assert len(findings) == 2
    assert np.all(np.diff(shifted) > 0)
    assert np.diff(shifted).max() == pytest.approx(time_stamps.PAUSE)


def test_jitter_and_single_outliers_are_no_restart():
    stamps = np.arange(1000) / 10
    stamps[500], stamps[700], stamps[800] = 0.0, 1e12, stamps[800] - 0.9
    assert time_stamps.restarts(stamps) == ()
    shifted, _ = time_stamps.one_clock(stamps)
    assert np.flatnonzero(np.isnan(shifted)).tolist() == [700]


def test_a_slow_log_keeps_its_first_and_last_samples():
    stamps = np.arange(200) * 60.0
    np.testing.assert_array_equal(time_stamps.one_clock(stamps)[0], stamps)


@given(st.lists(st.integers(0, 30), min_size=1, max_size=60))
@settings(max_examples=200, deadline=None)
def test_as_many_samples_as_possible_are_kept(values):
    time = np.array(values, dtype=float)
    rows = time_stamps.increasing(time)
    assert np.all(np.diff(rows) > 0)
    assert np.all(np.diff(time[rows]) > 0)
    best = [1] * len(values)
    for i in range(len(values)):
        best[i] = 1 + max((best[j] for j in range(i) if values[j] < values[i]), default=0)
    assert len(rows) == max(best)


def test_times_that_are_not_finite_are_dropped():
    assert time_stamps.increasing(np.array([np.nan, 1.0, np.inf, 2.0, 2.0])).tolist() == [1, 3]
    assert time_stamps.increasing(np.array([np.nan])).size == 0


def test_gaps_of_a_regular_message_only():
    time = np.arange(100) * 0.04
    time[50:] += 1.0
    assert str(time_stamps.gaps(time)) == "a gap 1.04 s at 2.0 s (its usual interval is 0.04 s)."
    assert time_stamps.gaps(np.arange(100) / 23.6) is None
    assert time_stamps.gaps(np.cumsum(np.random.default_rng(0).exponential(size=100))) is None


def test_a_stretch_that_was_logged_slowly_has_no_gaps():
    time = np.concatenate([np.arange(0, 10, 0.1), np.arange(10, 30, 0.005)])
    assert time_stamps.gaps(time) is None
    assert time_stamps.gaps(np.delete(time, np.s_[2000:2200])).number == 1


def test_gaps_of_a_whole_log_are_one_line():
    found = {f"M{k}": time_stamps.Gaps(2, 0.5 + k, 3.0, 0.1) for k in range(79)}
    assert time_stamps.all_gaps(found) == (
        "79 messages have gaps, up to 2; the longest lasts 78.5 s, at 3.0 s in M78.",
    )
    assert len(time_stamps.all_gaps({name: found[name] for name in ("M0", "M1")})) == 2


def test_up_to_three_messages_with_gaps_are_told_one_by_one():
    found = {f"M{k}": time_stamps.Gaps(1, 1.0 + k, 3.0, 0.1) for k in range(4)}
    few = {name: found[name] for name in ("M0", "M1", "M2")}
    assert [said.partition(":")[0] for said in time_stamps.all_gaps(few)] == ["M0", "M1", "M2"]
    assert len(time_stamps.all_gaps(found)) == 1


@pytest.mark.parametrize(("samples", "known"), [(20, False), (21, True)])
def test_twenty_intervals_are_needed_to_know_the_usual_one(samples, known):
    time = np.arange(float(samples))
    time[samples // 2 :] += 9
    assert (time_stamps.gaps(time) is not None) == known
