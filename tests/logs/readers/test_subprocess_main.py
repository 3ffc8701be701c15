"""What the subprocess collects, without the subprocess."""

import io
import json
import sys

import h5py
import numpy as np
import pytest

from greybox.logs.readers import subprocess_main
from greybox.logs.readers.subprocess_main import MOST, SMALL, Collector


def test_arrays_beyond_what_a_file_can_hold_are_refused():
    collector = Collector(size=10)
    assert collector.reserve(SMALL // 8)
    assert not collector.reserve(1)
    many = Collector(size=10)
    many.items = [{}] * MOST
    assert not many.reserve(1)


def test_what_is_written_is_a_line_of_json_and_the_numbers(monkeypatch):
    class Out:
        buffer = io.BytesIO()

    monkeypatch.setattr(sys, "stdout", Out)
    collector = Collector(size=1000)
    collector.add("ATT/x", np.array([1, 2], dtype=np.int16), "deg")
    collector.add("ATT/m", np.eye(2))
    collector.findings.append("odd")
    collector.write()
    head, _, raw = Out.buffer.getvalue().partition(b"\n")
    assert json.loads(head)["items"] == [
        {"path": "ATT/x", "shape": [2], "unit": "deg"},
        {"path": "ATT/m", "shape": [2, 2], "unit": ""},
    ]
    np.testing.assert_array_equal(np.frombuffer(raw, "<f8"), [1, 2, 1, 0, 0, 1])


def test_links_to_other_files_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = [1.0, 2.0]
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"] = [0.0, 1.0]
        file["elsewhere"] = h5py.ExternalLink("secret.h5", "x")
    collector = Collector(size=10_000)
    subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
    assert [item["path"] for item in collector.items] == ["t"]


@pytest.mark.parametrize(
    ("contents", "names"),
    [
        ({"time": np.arange(3.0), "signals": {"values": np.ones(3), "label": "u"}}, ["time", "u"]),
        ({"time": np.arange(3.0), "signals": [{"values": np.ones(3), "label": ""}]}, ["time", "signal1"]),
        ({"a": {"b": {"c": np.ones(2)}}}, ["a/b/c"]),
        ({"__header__": np.ones(2), "word": "x", "scalar": 1.0}, []),
    ],
)
def test_structs_and_simulinks_structure_with_time(contents, names):
    collector = Collector(size=10_000)
    subprocess_main._keep_struct("", contents, collector)
    assert [item["path"] for item in collector.items] == names
