"""Lines of long records, held against all their samples."""

import numpy as np
import pytest

from greybox.reporting.plotting.long_lines import COLUMNS, drawn_line


def test_short_lines_are_drawn_whole_with_a_break_at_each_gap():
    time = np.arange(6.0)
    t, x = drawn_line(time, time**2, [np.array([0, 1]), np.array([3, 4, 5])])
    np.testing.assert_array_equal(t, [0, 1, np.nan, 3, 4, 5])
    np.testing.assert_array_equal(x, [0, 1, np.nan, 9, 16, 25])


@pytest.mark.parametrize("count", [2 * COLUMNS, 7 * COLUMNS + 3, 100_000])
def test_of_long_lines_the_extremes_of_every_column_are_drawn(count):
    random = np.random.default_rng(0)
    time = np.arange(count, dtype=float)
    values = random.normal(size=count)
    values[random.integers(count, size=50)] = np.nan
    t, x = drawn_line(time, values, [np.arange(count)])
    assert t.size <= max(2 * COLUMNS + 2, count * (count <= 2 * COLUMNS))
    assert (t[0], t[-1]) == (0, count - 1)
    size = -(-count // COLUMNS)
    for first in range(0, count - size + 1, size):
        column = values[first : first + size]
        if not np.isfinite(column).any():
            continue
        drawn = x[(t >= first) & (t < first + size)]
        assert np.nanmax(drawn) == np.nanmax(column)
        assert np.nanmin(drawn) == np.nanmin(column)


def test_an_output_of_a_slower_sensor_is_a_line_that_ends_at_its_gap():
    time = np.arange(60.0)
    values = np.where(time % 5 == 0, time, np.nan)
    values[20:40] = np.nan
    t, x = drawn_line(time, values, [np.arange(60)])
    np.testing.assert_array_equal(t, [0, 5, 10, 15, np.nan, 40, 45, 50, 55])
    np.testing.assert_array_equal(x, t)
