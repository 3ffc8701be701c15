"""The subprocess in which files are read: what ends it, and what it may not do."""

import tracemalloc

import h5py
import numpy as np
import pytest

from greybox.data.files import subprocess_main, subprocess_reader
from greybox.data.files.subprocess_reader import read_in_subprocess


@pytest.fixture
def reading(tmp_path, monkeypatch):
    """Read a file with a subprocess that does something else."""
    path = tmp_path / "bad.h5"
    path.write_bytes(b"contents")

    def read(code):
        script = tmp_path / "script.py"
        script.write_text(code)
        monkeypatch.setattr(subprocess_reader, "SCRIPT", script)
        return read_in_subprocess("hdf5", path)

    return read


def test_a_slow_reading_is_no_damage(reading):
    """However long a process waits, as on a busy machine or after Ctrl-Z."""
    code = "import json, time; time.sleep(0.3); print(json.dumps({'items': []}))"
    assert reading(code) == {"items": []}


def test_a_reading_that_crashes_is_a_sentence(reading):
    with pytest.raises(ValueError, match="the library that reads it crashed"):
        reading("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")


LIMITED = f"""
import sys
sys.path.insert(0, {str(subprocess_main.__file__).rpartition("/")[0]!r})
import subprocess_main
subprocess_main.limit_resources(1000, 1000)
"""


@pytest.mark.skipif(
    not subprocess_reader.TOO_LONG, reason="the system has no limit of processor time"
)
def test_a_reading_that_computes_without_end_is_ended_by_its_processor_time(reading):
    with pytest.raises(ValueError, match="reading it takes too long for its size"):
        reading(LIMITED + "while True: pass")


@pytest.mark.skipif(not subprocess_reader.TOO_LONG, reason="the system has no limit of memory")
def test_a_reading_that_takes_memory_without_end_is_ended(reading):
    with pytest.raises(ValueError, match="is damaged"):
        reading(LIMITED + "kept = bytearray(300_000_000)")


def test_a_reason_is_printed_without_what_a_terminal_obeys(reading):
    with pytest.raises(ValueError, match="damaged or of another format") as caught:
        reading(r"import sys; sys.exit('\x1b[2J \x9b31m no')")
    assert caught.value.args[0].isprintable()


def test_numbers_come_back_exactly(tmp_path):
    values = np.array([[0.1, -0.0, np.nan], [np.inf, 5e-324, 1.7e308]])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = values
        file["y"] = np.arange(4, dtype="i2")
    x, y = read_in_subprocess("hdf5", tmp_path / "a.h5")["items"]
    assert (x["path"], y["path"]) == ("x", "y")
    assert x["values"].tobytes() == values.tobytes()
    assert y["values"].tolist() == [0, 1, 2, 3]


def test_what_is_read_is_in_memory_once(tmp_path):
    path = tmp_path / "long.h5"
    with h5py.File(path, "w") as file:
        for name in "abcd":
            file[name] = np.arange(2e5)
    tracemalloc.start()
    arrays = [item["values"] for item in read_in_subprocess("hdf5", path)["items"]]
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1.2 * sum(array.nbytes for array in arrays)
    for values in arrays:
        np.testing.assert_array_equal(values, np.arange(2e5))
