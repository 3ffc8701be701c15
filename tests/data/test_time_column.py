"""Times of tables: recognized by name, their clock by size, and what cannot be told is asked for."""

import numpy as np
import pytest

from greybox.data.time_column import times_in_seconds

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
    ],
)
def test_the_clock_is_told_by_name_and_size(name, unit, start, ticks, word):
    times, findings = times_in_seconds(name, unit, start + np.round(ticks * TIME, 9))
    np.testing.assert_allclose(np.diff(times), 0.02, atol=1e-6)
    assert [word in text for text in findings] == [True] * bool(word)


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
