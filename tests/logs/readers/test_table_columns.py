"""Headings with units, time columns by name and unit, and what becomes of matrices."""

import numpy as np
import pytest

from greybox.data.heading import Heading, heading
from greybox.logs.readers.table_columns import WIDEST, seconds, table

TIME = np.arange(5) * 20.0  # ms


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("pitch [deg]", Heading("pitch", "deg")),
        (" pitch (deg/s) ", Heading("pitch", "deg/s")),
        ("pitch", Heading("pitch", "")),
        ("q[0]", Heading("q[0]", "")),
        ("a []", Heading("a", "")),
        ("[deg]", Heading("[deg]", "")),
    ],
)
def test_units_in_headings(cell, expected):
    assert heading(cell) == expected


@pytest.mark.parametrize(
    ("name", "unit", "tick"),
    [
        ("time", "", 1.0),
        ("T", "ms", 1e-3),
        ("TimeUS", "", 1e-6),
        ("timestamp_ns", "", 1e-9),
        ("tout", "min", 60.0),
        ("time", "deg", None),
        ("flight_time", "", None),
        ("pitch_s", "", None),
    ],
)
def test_time_columns(name, unit, tick):
    assert seconds(name, unit) == tick


def test_a_table_has_a_time_signals_and_a_word_on_what_was_left_out():
    columns = {"x": TIME**2, "t": TIME, "m": np.stack([TIME, -TIME], axis=1), "short": TIME[:2]}
    columns["wide"] = np.zeros((5, WIDEST + 1))
    messages, findings = table("flight", columns, {"t": "ms", "x": "m", "m": "rad"})
    np.testing.assert_allclose(messages.time, TIME / 1e3)
    assert list(messages.columns) == ["x", "m[0]", "m[1]"]
    np.testing.assert_array_equal(messages.columns["m[1]"], -TIME)
    assert messages.units == {"x": "m", "m[0]": "rad", "m[1]": "rad"}
    assert findings == ("flight: left out, because their length is not that of the time: short.",)


def test_without_a_time_or_without_anything_else_there_is_no_table():
    assert table("a", {"x": TIME}, {}) == (None, ("a: 1 variables without a time were left out.",))
    assert table("a", {"t": TIME}, {}) == (None, ())
