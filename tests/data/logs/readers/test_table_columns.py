"""Time columns by name and unit, and what becomes of matrices."""

import numpy as np
import pytest

from greybox.data.logs.readers import read
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


@pytest.mark.parametrize(("key", "first"), [("I", 0), ("instance", 1)])
def test_devices_in_turn_are_records_of_their_own(tmp_path, key, first):
    """Also where one of them misses a row, and their stamps differ a little."""
    rows = [(0.01 * k + 1e-4 * i, first + i, 10 * i + k) for k in range(100) for i in range(2)]
    del rows[51]
    lines = [f"time [s],{key},x", *(f"{t:.4f},{i},{x}" for t, i, x in rows)]
    path = tmp_path / "gyros.csv"
    path.write_text("\n".join(lines))
    for options, name in (({}, "x"), ({"columns": {"y": "x:m"}}, "y")):
        log = read(path, **options)
        assert list(log) == [f"gyros[{first}]", f"gyros[{first + 1}]"]
        np.testing.assert_array_equal(log[f"gyros[{first}]"][name], np.arange(100))
        second = log[f"gyros[{first + 1}]"]
        np.testing.assert_array_equal(second[name], 10 + np.delete(np.arange(100), 25))
        np.testing.assert_allclose(second.time, 1e-4 + 0.01 * np.delete(np.arange(100), 25))


def test_a_current_in_whole_amperes_is_a_signal(tmp_path):
    current = np.random.default_rng(1).integers(0, 2, 300)
    lines = ["time [s],I [A],x", *(f"{0.01 * k:.2f},{i},{k}" for k, i in enumerate(current))]
    path = tmp_path / "motor.csv"
    path.write_text("\n".join(lines))
    np.testing.assert_array_equal(read(path)["motor"]["I"], current)
