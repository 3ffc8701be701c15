"""Time columns by name and unit, and what becomes of matrices."""

import numpy as np
import pytest

from greybox.data.logs.readers.table_columns import WIDEST, table
from greybox.data.time_column import seconds

TIME = np.arange(5) * 20.0  # ms


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


def test_without_a_time_the_messages_have_none():
    messages, findings = table("a", {"x": TIME, "Ts": TIME[:2]}, {})
    assert (messages.time, list(messages.columns), findings) == (None, ["x"], ())
    messages, _ = table("a", {"t": TIME}, {"t": "s"})
    assert dict(messages.columns) == {}


def test_a_first_column_that_increases_in_a_unit_of_time_is_the_time():
    for elapsed, is_time in ((TIME, True), (-TIME, False), (0 * TIME, False)):
        messages, _ = table("a", {"Zeit": elapsed, "x": TIME**2}, {"Zeit": "ms", "x": "s"})
        assert (messages.time is not None) == is_time
        assert ("Zeit" in messages.columns) != is_time


def test_a_matrix_of_64_columns_is_signals_and_one_of_65_an_image():
    columns = {
        "t": TIME,
        "m": np.tile(np.arange(64.0), (5, 1)),
        "image": np.zeros((5, 65)),
        "cube": np.zeros((5, 2, 2)),
    }
    messages, findings = table("a", columns, {"t": "s"})
    assert [*messages.columns] == [f"m[{k}]" for k in range(64)]
    assert [column[0] for column in messages.columns.values()] == list(range(64))
    assert (messages.order.tolist(), findings) == (list(range(5)), ())
    np.testing.assert_array_equal(messages.time, TIME)


def test_a_unit_may_say_how_a_signal_runs():
    columns = {"t": TIME, "u": TIME, "x": TIME, "y": TIME, "z": TIME}
    units = {"t": "ms", "u": "1 held", "x": "m/s sampled", "y": "m s", "z": " HELD"}
    messages, _ = table("a", columns, units)
    assert messages.units == {"u": "1", "x": "m/s", "y": "m s", "z": ""}
    assert messages.hold == {"u": np.inf, "x": 0.0, "z": np.inf}


def test_of_two_times_the_first_vector_is_the_time():
    columns = {"time": np.zeros((5, 2)), "seconds": TIME, "timestamp": TIME + 7}
    messages, _ = table("a", columns, {"seconds": "min"})
    np.testing.assert_array_equal(messages.time, 60 * TIME)
    assert [*messages.columns] == ["time[0]", "time[1]", "timestamp"]


@pytest.mark.parametrize(
    ("name", "unit", "tick"),
    [
        ("TimeMS", "", 1e-3),
        ("Time_MS", "", 1e-3),
        ("t_us", "", 1e-6),
        ("tout_sec", "", 1),
        ("t", "h", 3600),
        ("t_h", "", None),
    ],
)
def test_names_of_times_with_their_unit(name, unit, tick):
    assert seconds(name, unit) == (tick or None)
