"""HDF5 and MATLAB files: their groups are records."""

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from synthetic_logs import hdf5, matlab

from greybox.data.logs.readers import read

T = 0.01 * np.arange(200)


@pytest.fixture
def saved(tmp_path):
    def write_and_read(data, name="flight.h5", **options):
        path = tmp_path / name
        path.write_bytes(data)
        return read(path, **options)

    return write_and_read


@pytest.fixture
def made(tmp_path):
    """Open a new HDF5 file."""

    def open_file(name="made.h5", **options):
        return h5py.File(tmp_path / name, "w", **options)

    return open_file


@pytest.mark.parametrize(
    "options", [{}, {"libver": "latest"}, {"packed": True}, {"userblock_size": 512}]
)
def test_groups_with_a_time_are_records(saved, options):
    recording = saved(hdf5(**options))
    assert list(recording) == ["flight", "flight/ATT"]
    attitude = recording["flight/ATT"]
    np.testing.assert_array_equal(attitude["Pitch"], np.sin(0.01 * np.arange(500)))
    assert attitude.units == {"Pitch": "deg", "P": "deg/s"}
    assert recording.findings == ()
    assert len(recording.checksum) == 64
    assert list(saved(hdf5(), messages=("flight/ATT", "x"))) == ["flight/ATT"]


def test_times_in_other_units_tables_and_matrices(made, tmp_path):
    with made() as file:
        file["a/t"], file["a/xy"], file["a/odd"] = T * 1e3, np.stack([T, -T], axis=1), T[:7]
        file["a/t"].attrs["units"] = "ms"
        file["b"] = np.rec.fromarrays([T, T**2], names="timestamp,z")
        file["words"], file["scalar"], file["c/x"] = "text", 3.0, T
    recording = read(tmp_path / "made.h5")
    np.testing.assert_allclose(recording["a"].time, T)
    np.testing.assert_array_equal(recording["a"]["xy[1]"], -T)
    np.testing.assert_array_equal(recording["b"]["z"], T**2)
    assert recording.findings == (
        "a: left out, because their length is not that of the time: odd.",
        "c: its 200 messages have no time and were left out.",
    )


def test_a_matlab_7_3_file_is_read_as_matlab_shows_it(made, tmp_path):
    with made("new.mat", userblock_size=512) as file:
        file["s/time"], file["s/x"] = T[None, :], T[:, None]
        file["s/xy"] = np.stack([T, -T])  # 200 by 2 in MATLAB, which stores columns first
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])
    record = read(path)["s"]
    np.testing.assert_array_equal(record["x"], T)
    np.testing.assert_array_equal(record["xy[1]"], -T)


@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"oned_as": "column"}])
def test_structs_with_a_time_are_records(saved, options):
    recording = saved(matlab(**options), "flight.mat")
    assert list(recording) == ["flight", "att", "att/inner"]
    np.testing.assert_array_equal(recording["att"]["Pitch"], np.sin(0.01 * np.arange(500)))
    np.testing.assert_array_equal(recording["flight"]["xy[1]"], 0.01 * np.arange(500))
    assert list(recording["att"].signals) == ["Pitch", "Yaw"]


def test_an_old_matlab_file(tmp_path):
    savemat(tmp_path / "old.mat", {"t": T, "u": T**2}, format="4")
    np.testing.assert_array_equal(read(tmp_path / "old.mat")["old"]["u"], T**2)


def test_simulinks_structure_with_time(tmp_path):
    signals = np.array(
        [{"values": T, "label": "pitch"}, {"values": np.stack([T, -T], axis=1), "label": ""}]
    )
    savemat(tmp_path / "sim.mat", {"out": {"time": T, "signals": signals}})
    assert list(read(tmp_path / "sim.mat")["out"].signals) == ["pitch", "signal2[0]", "signal2[1]"]
    odd = np.array(
        [{"values": T, "label": "pitch"}, "no signal", {"label": "without values"}], dtype=object
    )
    savemat(tmp_path / "odd.mat", {"out": {"time": T, "signals": odd}})
    assert list(read(tmp_path / "odd.mat")["out"].signals) == ["pitch"]


@pytest.mark.parametrize(("write", "name"), [(hdf5, "x.h5"), (matlab, "x.mat")])
def test_truncated_files_are_refused_in_a_sentence(saved, write, name):
    data = write()
    with pytest.raises(
        ValueError,
        match=rf"{name} is damaged or of another format \(.*\): export or copy it again\.$",
    ):
        saved(data[: len(data) // 2], name)


def test_a_file_without_time_names_what_it_holds(made, tmp_path):
    with made() as file:
        file["a/x"], file["b/x"] = T, T
    with pytest.raises(ValueError, match=r"has no group with a vector 'time' .*; it holds a, b\."):
        read(tmp_path / "made.h5")


def test_an_array_too_large_to_be_true_is_not_read(made, tmp_path):
    with made() as file:
        file["time"], file["x"] = T, T
        file.create_dataset("huge", shape=(10**12,), dtype="f8", chunks=(10**6,))
    recording = read(tmp_path / "made.h5")
    assert recording.findings == ("huge: it cannot be read, the file is damaged there.",)
    np.testing.assert_array_equal(recording["made"]["x"], T)


def test_groups_that_are_asked_for_are_read_alone(made, tmp_path):
    with made() as file:
        for k, name in enumerate(("a", "b", "c")):
            file[f"{name}/time"], file[f"{name}/x"] = T, T + k
    recording = read(tmp_path / "made.h5", messages=("c", "a", "d"))
    assert [*recording] == ["a", "c"]
    assert recording.findings == ("there is no group d.",)
    np.testing.assert_array_equal(recording["c"]["x"], T + 2)
