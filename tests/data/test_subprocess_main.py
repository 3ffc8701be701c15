"""What the subprocess collects, without the subprocess."""

import io
import json
import sys

import h5py
import numpy as np
import pytest

from greybox.data import subprocess_main
from greybox.data.subprocess_main import LINKS, MOST, SMALL, Collector, RefusedError


def test_arrays_beyond_what_a_file_can_hold_are_refused():
    collector = Collector(SMALL)
    assert collector.reserve(SMALL // 8)
    assert not collector.reserve(1)
    many = Collector(SMALL)
    many.arrays = [np.zeros(0)] * MOST
    assert not many.reserve(1)


def test_what_is_written_is_a_line_of_json_and_the_numbers(monkeypatch):
    class Out:
        buffer = io.BytesIO()

    monkeypatch.setattr(sys, "stdout", Out)
    collector = Collector(SMALL)
    collector.add("ATT/x", np.array([1, 2], dtype=np.int16), unit="deg")
    collector.add("ATT/m", np.eye(2), unit="")
    collector.findings.append("odd")
    collector.write()
    head, _, raw = Out.buffer.getvalue().partition(b"\n")
    assert json.loads(head)["items"] == [{"path": "ATT/x", "unit": "deg"}, {"path": "ATT/m", "unit": ""}]
    assert json.loads(head)["shapes"] == [[2], [2, 2]]
    np.testing.assert_array_equal(np.frombuffer(raw, "<f8"), [1, 2, 1, 0, 0, 1])


def external_link(file):
    file["elsewhere"] = h5py.ExternalLink("secret.h5", "x")


def external_storage(file):
    file.create_dataset("elsewhere", shape=(2,), dtype="f8", external=[("secret.h5", 0, 16)])


def virtual_dataset(file):
    layout = h5py.VirtualLayout(shape=(2,), dtype="f8")
    layout[:] = h5py.VirtualSource("secret.h5", "x", shape=(2,))
    file.create_virtual_dataset("elsewhere", layout)


def many_links(file):
    for k in range(LINKS):
        file[f"{k}"] = h5py.SoftLink("/t")


def deep_groups(file):
    file.create_group("/".join("abcdefghijk"))


@pytest.mark.parametrize(
    ("craft", "words"),
    [
        (external_link, "elsewhere is a link to another file"),
        (external_storage, "the data of elsewhere are stored in another file"),
        (virtual_dataset, "the data of elsewhere are stored in another file"),
        (many_links, "more than 50000 links"),
        (deep_groups, "more than 8 levels of groups"),
    ],
)
@pytest.mark.parametrize("kind", ["hdf5", "sealed"])
def test_files_that_reach_beyond_themselves_are_refused(tmp_path, craft, words, kind):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = [1.0, 2.0]
    with h5py.File(tmp_path / "log.h5", "w", libver="latest") as file:
        file["t"] = [0.0, 1.0]
        craft(file)
    with pytest.raises(RefusedError, match=words):
        getattr(subprocess_main, kind)(str(tmp_path / "log.h5"), Collector(SMALL), [])


def test_an_object_is_read_once_however_many_names_it_has(tmp_path):
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["t"] = [0.0, 1.0]
        file["a/loop"] = file["/"]
        for k in range(10):
            file[f"a/t{k}"] = file["t"]
            file[f"a/soft{k}"] = h5py.SoftLink("/a")
    collector = Collector(SMALL)
    subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
    assert len(collector.arrays) == 1


@pytest.mark.parametrize("options", [{"chunks": (2**22,), "maxshape": (None,)}, {"chunks": None}])
def test_no_more_is_read_than_a_file_can_hold(tmp_path, options):
    """A chunk is read as a whole, however short the dataset; a dataset that was never written takes no room in it."""
    length = 10 if options["chunks"] else 2**22
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("large", shape=(length,), dtype="f8", **options)
    collector = Collector(2**20)
    subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
    assert collector.findings == ["large: it cannot be read, the file is damaged there."]
    with pytest.raises(RefusedError, match="large is larger than the file"):
        subprocess_main.sealed(str(tmp_path / "log.h5"), Collector(2**20), [])


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
    collector = Collector(SMALL)
    subprocess_main._keep_struct("", contents, collector)
    assert [item["path"] for item in collector.items] == names


def test_of_a_table_of_rows_the_columns_of_numbers_are_kept(tmp_path):
    rows = np.array([(1, 2.5, b"a"), (3, 4.5, b"b")], dtype=[("k", "<i4"), ("x", "<f8"), ("name", "S3")])
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["table"] = rows
    collector = Collector(SMALL)
    subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
    assert {item["path"]: values.tolist() for item, values in zip(collector.items, collector.arrays, strict=True)} == {
        "table/k": [1, 3],
        "table/x": [2.5, 4.5],
    }
