import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from greybox.data.logs.readers import time_stamps


def test_a_steady_clock_is_left_alone():
    stamps = np.arange(1000) / 100
    shifted, findings = time_stamps.one_clock(stamps)
    np.testing.assert_array_equal(shifted, stamps)
    assert findings == ()


def test_three_boots_follow_each_other():
    stamps = np.concatenate(
        [np.arange(100, 200, 0.1), np.arange(5, 60, 0.1), np.arange(2, 30, 0.1)]
    )
    shifted, findings = time_stamps.one_clock(stamps)
    assert len(findings) == 2
    assert np.all(np.diff(shifted) > 0)
    assert np.diff(shifted).max() == pytest.approx(time_stamps.PAUSE)


def test_each_boot_continues_ten_seconds_after_the_last_stamp_of_the_previous_one():
    boots = [np.arange(100, 200, 0.25), np.arange(5, 60, 0.25), np.arange(-3, 30, 0.25)]
    stamps = np.concatenate(boots)
    assert time_stamps.restarts(stamps) == (400, 620)
    shifted, findings = time_stamps.one_clock(stamps)
    expected = np.concatenate([boots[0], boots[1] + 204.75, boots[2] + 277.5])
    np.testing.assert_array_equal(shifted, expected)
    assert findings == tuple(
        f"the clock restarted at {end} s (another boot): later times were shifted by {shift} s, to 10 s after it; the "
        "real pause is not known."
        for end, shift in ((199.8, "+204.8"), (264.5, "+277.5"))
    )
    missing = np.insert(stamps, [3, 500], np.nan)
    again, said = time_stamps.one_clock(missing)
    np.testing.assert_array_equal(again, np.insert(expected, [3, 500], np.nan))
    assert said == findings


@pytest.mark.parametrize(("back", "found"), [(1.1, True), (0.9, False)])
def test_a_clock_that_restarts_falls_by_more_than_a_second(back, found):
    """After hours as well: the stamps just before it count, not those since the start."""
    before = np.arange(0, 2000, 0.01 if back < 1 else 10.0)
    step = before[1]
    after = before[-1] - back - (0 if back < 1 else 600) + step * np.arange(300)
    assert time_stamps.restarts(np.concatenate([before, after])) == (
        (before.size,) if found else ()
    )


@pytest.mark.parametrize(("damaged", "found"), [(23, ()), (27, (1000,))])
def test_a_restart_is_told_by_the_median_of_fifty_stamps_after(damaged, found):
    """Fewer than half of them from before are damage."""
    stamps = 1000 + np.arange(2000) / 10
    stamps[1000 : 1000 + damaged] -= 500
    assert time_stamps.restarts(stamps) == found


@pytest.mark.parametrize(("uneven", "beyond", "plausible"), [
    (False, 599.7, True), (False, 600.3, False), (True, 597.0, True), (True, 603.0, False),
])  # fmt: skip
def test_a_stamp_is_plausible_up_to_ten_minutes_beyond_the_ends(uneven, beyond, plausible):
    """The ends by half of the fifty stamps beside them: slower at the far side, where these are uneven."""
    steps = np.ones(400)
    if uneven:
        steps[:25], steps[-24:] = 3.0, 3.0
    stamps = np.cumsum(steps) - steps[0]
    for stamp, at in ((-beyond, 200), (stamps[-1] + beyond, 200)):
        damaged = stamps.copy()
        damaged[at] = stamp
        expected = [] if plausible else [at]
        assert np.flatnonzero(np.isnan(time_stamps.one_clock(damaged)[0])).tolist() == expected


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
@settings(max_examples=80, deadline=None)
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
