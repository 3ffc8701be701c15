"""What the subprocess collects, without the subprocess."""

import importlib.util
import io
import json
import struct
import sys

import h5py
import numpy as np
import pytest
from synthetic_logs import ulog

from greybox.data.files import subprocess_main
from greybox.data.files.subprocess_main import MOST, SMALL, Collector, RefusedError


def test_arrays_beyond_what_a_file_can_hold_are_refused():
    collector = Collector(SMALL)
    collector.reserve(SMALL // 8)
    many = Collector(SMALL)
    many.arrays = [np.zeros(0)] * MOST
    for full in (collector, many):
        with pytest.raises(ValueError, match="too large for the size of the file"):
            full.reserve(1)


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
    assert json.loads(head)["items"] == [
        {"path": "ATT/x", "unit": "deg", "shape": [2]},
        {"path": "ATT/m", "unit": "", "shape": [2, 2]},
    ]
    np.testing.assert_array_equal(np.frombuffer(raw, "<f8"), [1, 2, 1, 0, 0, 1])


def external_link(file):
    file["elsewhere"] = h5py.ExternalLink("secret.h5", "x")


def external_storage(file):
    file.create_dataset("elsewhere", shape=(2,), dtype="f8", external=[("secret.h5", 0, 16)])


def virtual_dataset(file):
    layout = h5py.VirtualLayout(shape=(2,), dtype="f8")
    layout[:] = h5py.VirtualSource("secret.h5", "x", shape=(2,))
    file.create_virtual_dataset("elsewhere", layout)


def deep_groups(file):
    file.create_group("/".join("abcdefghijk"))


@pytest.mark.parametrize(
    ("craft", "words"),
    [
        (external_link, "elsewhere is a link to another file"),
        (external_storage, "the data of elsewhere are stored in another file"),
        (virtual_dataset, "the data of elsewhere are stored in another file"),
        (deep_groups, "more than 8 levels of groups"),
    ],
)
def test_files_that_reach_beyond_themselves_are_refused(tmp_path, craft, words):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = [1.0, 2.0]
    with h5py.File(tmp_path / "log.h5", "w", libver="latest") as file:
        file["t"] = [0.0, 1.0]
        craft(file)
    with pytest.raises(RefusedError, match=words):
        subprocess_main.hdf5(str(tmp_path / "log.h5"), Collector(SMALL), [])


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


@pytest.mark.parametrize(
    ("contents", "names"),
    [
        ({"time": np.arange(3.0), "signals": {"values": np.ones(3), "label": "u"}}, ["time", "u"]),
        (
            {"time": np.arange(3.0), "signals": [{"values": np.ones(3), "label": ""}]},
            ["time", "signal1"],
        ),
        ({"a": {"b": {"c": np.ones(2)}}}, ["a/b/c"]),
        ({"__header__": np.ones(2), "word": "x", "scalar": 1.0}, []),
    ],
)
def test_structs_and_simulinks_structure_with_time(contents, names):
    collector = Collector(SMALL)
    subprocess_main.keep_struct("", contents, collector)
    assert [item["path"] for item in collector.items] == names


def test_of_a_table_of_rows_the_columns_of_numbers_are_kept(tmp_path):
    rows = np.array(
        [(1, 2.5, b"a"), (3, 4.5, b"b")], dtype=[("k", "<i4"), ("x", "<f8"), ("name", "S3")]
    )
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["table"] = rows
    collector = Collector(SMALL)
    subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
    assert {
        item["path"]: values.tolist()
        for item, values in zip(collector.items, collector.arrays, strict=True)
    } == {
        "table/k": [1, 3],
        "table/x": [2.5, 4.5],
    }


def test_room_is_taken_by_what_fits_alone():
    """8 bytes a number."""
    collector = Collector(100)
    for numbers, room in ((5, 60), (8, None), (7, 4), (1, None)):
        if room is None:
            with pytest.raises(ValueError, match="too large for the size of the file"):
                collector.reserve(numbers)
        else:
            collector.reserve(numbers)
            assert collector.room == room
    assert collector.room == 4
    few = Collector(SMALL)
    few.arrays = [np.zeros(0)] * (MOST - 1)
    few.reserve(1)
    assert few.room == SMALL - 8


@pytest.fixture
def h5(tmp_path):
    """Write an HDF5 file and return what `subprocess_main` collects of it."""

    def collected(write, **limits):
        with h5py.File(tmp_path / "log.h5", "w") as file:
            write(file)
        collector = Collector(SMALL)
        for name, value in limits.items():
            setattr(collector, name, value)
        subprocess_main.hdf5(str(tmp_path / "log.h5"), collector, [])
        return collector

    return collected


def test_links_of_all_groups_count(h5):
    """Soft ones as well, which are not followed."""

    def write(file):
        file["a/x"] = [1.0]
        file["a/soft"] = h5py.SoftLink("/a/x")
        file["b/y"] = [2.0]

    assert h5(write, links=5).links == 0
    with pytest.raises(RefusedError, match="more than 50000 links"):
        h5(write, links=4)


@pytest.mark.parametrize(("levels", "fits"), [(9, True), (10, False)])
def test_groups_may_be_nested_to_eight_levels(h5, levels, fits):
    def write(file):
        file["/".join("abcdefghijkl"[:levels])] = [1.0]

    if fits:
        assert len(h5(write).arrays) == 1
    else:
        with pytest.raises(RefusedError, match="more than 8 levels"):
            h5(write)


def test_vectors_and_matrices_of_numbers_are_kept_with_their_units(h5):
    def write(file):
        file["x"] = np.arange(3.0)
        file["x"].attrs["unit"], file["x"].attrs["units"] = "m", "ft"
        file["y"] = np.arange(3, dtype="i2")
        file["y"].attrs["units"] = np.array([b"deg"])
        file["flags"] = [True, False]
        file["m"] = np.arange(6.0).reshape(2, 3)
        file["m"].attrs["unit"] = 7
        file["scalar"], file["cube"], file["word"], file["none"] = (
            1.0,
            np.zeros((1, 1, 2)),
            "word",
            h5py.Empty("f8"),
        )
        file["empty"], file["complex"] = np.zeros(0), np.zeros(2, complex)

    found = h5(write)
    assert {item["path"]: item["unit"] for item in found.items} == {
        "x": "m",
        "y": "deg",
        "flags": "",
        "m": "",
    }
    assert [values.tolist() for values in found.arrays] == [
        [1, 0],
        [[0, 1, 2], [3, 4, 5]],
        [0, 1, 2],
        [0, 1, 2],
    ]
    assert found.findings == []
    assert found.room == SMALL - 8 * (2 + 6 + 3 + 3)  # written as 8 bytes each, whatever their type


def test_the_room_of_a_table_is_that_of_its_columns_or_of_its_bytes(h5):
    def write(file):
        file["short"] = np.zeros(10, dtype=[("a", "i1"), ("b", "i1"), ("c", "i1")])
        file["long"] = np.zeros(10, dtype=[("a", "f8"), ("text", "S32")])

    assert h5(write).room == SMALL - 8 * (10 * 3 + 10 * 5)


def nested(levels):
    """Structs in one another, the innermost with a vector."""
    contents = {"x": np.ones(2)}
    for _ in range(levels):
        contents = {"s": contents}
    return contents


def test_structs_are_followed_to_eight_levels_and_matrices_are_kept():
    for levels, kept in ((8, 1), (9, 0)):
        collector = Collector(SMALL)
        subprocess_main.keep_struct("", nested(levels), collector)
        assert len(collector.items) == kept
    collector = Collector(SMALL)
    contents = {
        "m": np.ones((2, 3)),
        "c": np.ones((1, 2, 3)),
        "e": np.zeros(0),
        "z": np.ones(2, complex),
    }
    subprocess_main.keep_struct(
        "g/", contents | {"n": np.array(1.0), "b": np.array([True])}, collector
    )
    assert [item["path"] for item in collector.items] == ["g/m", "g/b"]
    assert collector.room == SMALL - 8 * 7
    with pytest.raises(ValueError, match="its arrays are too large for the size of the file"):
        subprocess_main.keep_struct("", {"x": np.ones(3)}, Collector(16))
    opaque = type("MatlabOpaque", (), {})()
    subprocess_main.keep_struct("", {"flown": opaque}, collector)
    assert collector.unread == ["flown"]


@pytest.mark.parametrize(
    ("signals", "names"),
    [
        (
            [{"values": np.ones(3), "label": ""}, {"values": np.ones(3), "label": 7}],
            ["time", "signal1", "signal2"],
        ),
        ([{"label": "u"}, "odd", {"values": np.ones(3), "label": "y"}], ["time", "y"]),
        ("odd", ["time", "signals"]),
    ],
)
def test_signals_of_simulink_have_their_labels_or_numbers(signals, names):
    collector = Collector(SMALL)
    contents = {"time": np.arange(3.0), "signals": signals}
    subprocess_main.keep_struct("", contents, collector)
    assert [item["path"] for item in collector.items] == [
        name for name in names if name != "signals"
    ]


@pytest.mark.skipif(
    importlib.util.find_spec("pyulog") is None, reason="the extra px4 is not installed"
)
def test_what_a_px4_log_lost_is_said(tmp_path):
    """Two dropouts of 250 and 1500 ms, and bytes that are no message."""

    def put(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    path = tmp_path / "log.ulg"
    path.write_bytes(
        ulog(0.5) + put("O", struct.pack("<H", 250)) + put("O", struct.pack("<H", 1500))
    )
    found = Collector(SMALL)
    subprocess_main.ulog(str(path), found, [])
    assert found.findings == ["the logger lost data 2 times, 1.75 s in total."]
    assert found.about["texts"] == [(2_100_000, "[commander] Takeoff detected")]
    assert found.about["initial"] == {"MC_PITCH_P": 6.5, "CBRK_IO": 4}
    assert [change[1:] for change in found.about["changes"]] == [("MC_PITCH_P", 7.0)]
    units = {item["path"]: item["unit"] for item in found.items}
    assert units["vehicle_attitude/timestamp"] == "us"
    assert units["sensor_accel[1]/x"] == units["vehicle_attitude/q[0]"] == ""
    few = Collector(SMALL)
    subprocess_main.ulog(str(path), few, ["vehicle_status"])
    assert {item["path"].partition("/")[0] for item in few.items} == {"vehicle_status"}
    with pytest.raises(ValueError, match="its arrays are too large for the size of the file"):
        subprocess_main.ulog(str(path), Collector(100), [])
