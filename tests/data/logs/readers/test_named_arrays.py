"""HDF5 and MATLAB files: their groups are records."""

import re

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from synthetic_logs import hdf5, matlab

from greybox.data.logs.readers import read
from greybox.data.response_file import read_response

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


def test_mission_planners_matrices_have_names_for_their_columns(tmp_path):
    """Mission Planner writes a matrix for each message, and a cell of labels beside it."""
    number = np.arange(200.0)
    attitude = np.stack([number, 1e6 * (5 + T), np.sin(T)], axis=1)
    rows = np.repeat(number, 2)
    gyro = np.stack([rows, 1e6 * (5 + np.repeat(T, 2)), np.tile([0.0, 1.0], 200), rows], axis=1)

    def labels(*names):
        return np.array(names, dtype=object)[:, None]

    contents = {
        "ATT": attitude,
        "ATT_label": labels("LineNo", "TimeUS", "Pitch"),
        "IMU": gyro,
        "IMU_label": labels("LineNo", "TimeUS", "I", "GyrX"),
    }
    savemat(tmp_path / "flight.mat", contents)
    log = read(tmp_path / "flight.mat")
    assert list(log) == ["ATT", "IMU[0]", "IMU[1]"]
    np.testing.assert_allclose(log["ATT"].time, 5 + T)
    np.testing.assert_array_equal(log["ATT"]["Pitch"], np.sin(T))
    np.testing.assert_array_equal(log["IMU[1]"]["GyrX"], number)


def test_the_time_of_simulinks_to_file_is_in_the_first_row(tmp_path):
    savemat(tmp_path / "run.mat", {"ans": np.stack([T, np.sin(T), np.cos(T)])})
    log = read(tmp_path / "run.mat")
    np.testing.assert_array_equal(log["ans"].time, T)
    np.testing.assert_array_equal(log["ans"]["ans[1]"], np.cos(T))
    assert log.findings == (
        "ans: its first row was taken as the time in s, as by Simulink's To File.",
    )


def test_a_column_of_a_matrix_can_be_named(tmp_path):
    """By the name that the list of columns has for it."""
    savemat(tmp_path / "flight.mat", {"t": T, "y": np.stack([T, np.sin(T)], axis=1)})
    record = read(tmp_path / "flight.mat", columns={"angle": "y[1]:deg"})["flight"]
    np.testing.assert_allclose(record["angle"], np.radians(np.sin(T)))

    savemat(tmp_path / "plain.mat", {"data": np.stack([T, -T, np.sin(T)], axis=1)})
    record = read(tmp_path / "plain.mat", columns={"time": "data[0]", "y": "data[2]"})["plain"]
    np.testing.assert_array_equal(record.time, T)
    np.testing.assert_array_equal(record["y"], np.sin(T))


def test_numbers_beside_cells_and_texts_of_matlab_7_3_are_read(made, tmp_path):
    """The contents of 5000 cells are no data; one remark names all that is left out."""
    with made("new.mat", userblock_size=512) as file:
        for name, values in (("t", T), ("u", np.sin(T))):
            file[name] = values[None, :]
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        references = np.empty((5000, 1), dtype=h5py.ref_dtype)
        for k in range(5000):
            file[f"#refs#/{k}"] = np.arange(40.0)[None, :]
            references[k, 0] = file[f"#refs#/{k}"].ref
        file["runs"] = references
        file["runs"].attrs["MATLAB_class"] = np.bytes_("cell")
        file["note"] = np.array([[104], [105]], dtype="u2")
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["table"] = np.array([[1, 2, 3]], dtype="u4")
        file["table"].attrs["MATLAB_class"] = np.bytes_("timetable")
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512) + path.read_bytes()[512:])
    log = read(path)
    assert list(log) == ["new"]
    assert list(log["new"].signals) == ["u"]
    np.testing.assert_array_equal(log["new"]["u"], np.sin(T))
    (finding,) = log.findings
    assert finding.startswith("not read: note, runs, table. Cells, texts and MATLAB's objects")


def test_packed_numbers_are_unpacked(made, tmp_path):
    """By the attributes of netCDF: value = packed * scale_factor + add_offset."""
    packed = np.round(1000 * np.sin(T)).astype("i2")
    packed[5] = -32768
    with made() as file:
        file["time"] = T
        file["pitch"] = packed
        file["pitch"].attrs.update(scale_factor=0.01, add_offset=2.0, units="deg")
        file["pitch"].attrs["_FillValue"] = np.array([-32768], dtype="i2")
        file["rate"] = np.where(np.arange(200) == 7, -9999.0, T)
        file["rate"].attrs["missing_value"] = -9999.0
    record = read(tmp_path / "made.h5")["made"]
    expected = 2.0 + 0.01 * packed
    expected[5] = np.nan
    np.testing.assert_allclose(record["pitch"], expected)
    np.testing.assert_array_equal(record["rate"], np.where(np.arange(200) == 7, np.nan, T))


@pytest.mark.parametrize("stamped", [False, True])
def test_the_fields_of_an_iddata_object_are_signals(tmp_path, stamped):
    """As ``get(data)`` returns them in MATLAB."""
    fields = {
        "Domain": "Time",
        "OutputData": np.stack([np.sin(T), np.cos(T)], axis=1),
        "OutputName": np.array(["pitch", "q"], dtype=object)[:, None],
        "OutputUnit": np.array(["deg", "deg/s"], dtype=object)[:, None],
        "InputData": np.sign(np.sin(T))[:, None],
        "InputName": np.array(["elevator"], dtype=object)[:, None],
        "InputUnit": np.array([""], dtype=object)[:, None],
        "InterSample": "zoh",
        "Ts": np.zeros((0, 0)) if stamped else 10.0,
        "SamplingInstants": 1e3 * T[:, None] if stamped else np.zeros((0, 0)),
        "TimeUnit": "milliseconds",
    }
    savemat(tmp_path / "flight.mat", {"data": fields})
    record = read(tmp_path / "flight.mat")["data"]
    np.testing.assert_allclose(record.time, T)
    assert list(record.signals) == ["elevator", "pitch", "q"]
    np.testing.assert_array_equal(record["q"], np.cos(T))
    assert record.units == {"elevator": "", "pitch": "deg", "q": "deg/s"}
    assert dict(record.hold) == {"elevator": np.inf}


def test_a_frequency_response_of_matlab_is_refused_with_the_way_out(tmp_path):
    omega = np.array([1.0, 2.0, 5.0])
    fields = {
        "ResponseData": (1 / (1 + 1j * omega))[None, None, :],
        "Frequency": omega[:, None],
        "FrequencyUnit": "rad/TimeUnit",
        "Ts": 0.0,
    }
    savemat(tmp_path / "G.mat", {"G": fields})
    with pytest.raises(ValueError, match=r"G is a frequency response .*writetable") as refused:
        read(tmp_path / "G.mat")
    header = re.search(r"\{'(.*?)', '(.*?)', '(.*?)'\}", str(refused.value)).groups()

    # What MATLAB would write then is a response.
    path = tmp_path / "G.csv"
    response = 1 / (1 + 1j * omega)
    columns = np.stack([omega, response.real, response.imag], axis=1)
    np.savetxt(path, columns, delimiter=",", header=",".join(header), comments="")
    np.testing.assert_allclose(read_response(path).response, response)
