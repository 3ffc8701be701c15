"""The choice of the reader, and what damaged files may do."""

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from benchmark_module import benchmark
from synthetic_logs import samples

import greybox as gb
from greybox.data.logs.readers import FORMATS, read

ROOT = Path(__file__).parents[4]


def fuzzer():
    """Load the benchmark that feeds the readers with damaged files."""
    return benchmark("fuzz_readers")


@pytest.mark.parametrize("suffix", samples())
def test_the_contents_decide_not_the_name(tmp_path, suffix):
    path = tmp_path / {".csv": "wrong.bin", ".bin": "nosuffix"}.get(suffix, "wrong.csv")
    path.write_bytes(samples()[suffix][0])
    assert len(read(path))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"^there is no file .*x\.BIN\.$"):
        read(tmp_path / "x.BIN")


def test_a_folder(tmp_path):
    with pytest.raises(OSError, match="is a folder: give a file in it"):
        read(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
def test_a_pipe_is_refused_before_it_blocks(tmp_path):
    path = tmp_path / "log.csv"
    os.mkfifo(path)
    for reader in (read, gb.read_response):
        with pytest.raises(
            OSError, match=r"log\.csv is a pipe or a device: copy its contents to a file"
        ):
            reader(path)


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (b"", "is empty: logging never started"),
        (b"to whom it may concern, greetings\n", "looks like text that starts with .to whom"),
        (
            b"PK\3\4rest",
            "is a zip archive, which greybox does not read: unpack it, unzip thing.xyz",
        ),
        (b"just a few words", "looks like text that starts with 'just a few words', which"),
        (b"\1\2\3\4\5", "looks like binary data that start with 01 02 03 04, which"),
    ],
)
def test_anything_else_is_refused_in_one_sentence(tmp_path, data, match):
    path = tmp_path / "thing.xyz"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=match) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_library_is_loaded_before_it_is_needed():
    libraries = ("pymavlink", "h5py", "scipy", "pyulog")
    code = f"import sys, greybox.data.logs.readers; print([m for m in {libraries} if m in sys.modules])"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert loaded.strip() == "[]"


def test_every_format_has_its_reader():
    for known in FORMATS:
        assert (ROOT / "greybox" / "data" / "logs" / "readers" / f"{known.module}.py").exists()


@pytest.mark.parametrize(
    ("count", "kinds"), [(36, ["bin", "log", "tlog", "csv", "cf"]), (6, ["h5", "mat"])]
)
def test_damaged_files_never_hang_crash_or_print(count, kinds):
    counts, failures, _ = fuzzer().fuzz(read, range(count), seed=2, limit=15, kinds=kinds)
    assert failures == []
    assert sum(counts.values()) == count
    assert sum(n for (_, outcome), n in counts.items() if outcome == "read") > count / 10


@pytest.mark.parametrize("block", [0, 512, 1024, 2048])
def test_hdf5_is_known_behind_a_block_of_the_user(tmp_path, block):
    with h5py.File(tmp_path / "log.dat", "w", userblock_size=block) as file:
        file["time"], file["x"] = np.arange(4) / 10, np.arange(4.0)
    assert len(read(tmp_path / "log.dat")) == 1


STAMP = 1_700_000_000_000_000  # µs since 1970


@pytest.mark.parametrize(
    ("head", "module"),
    [
        (b"time,x\n0,1\n", "csv_table"),
        (b"# a, comment\ntime;x\n0;1\n", "csv_table"),
        (b"% a, comment\n\n time\tx\n0\t1\n", "csv_table"),
        (b"x,y" * 1365 + b"z", "csv_table"),  # a header as long as what is looked at
        (b"x,y" * 1365, ""),
        (b"time,x\n", ""),  # no line below it
        (b"dear all\nI came, I saw\n", ""),  # no separator in the first line
        (b"# a, comment\nI came\nI saw\n", ""),
        (b"time,x\n0,\x001\n", ""),
        (b"time,x\n0,\x0e1\n", ""),
        (b"time,x\n0,\x1f1\n", ""),
        (b"time,x\n0,\x081\n", ""),
        (b"time,x\n\x0c0,1\x0b\r\n", "csv_table"),
        (STAMP.to_bytes(8, "big") + b"\xfd", "telemetry"),
        (STAMP.to_bytes(8, "big") + b"\xfe", "telemetry"),
        (STAMP.to_bytes(8, "big") + b"\xfc", ""),
        (STAMP.to_bytes(8, "big"), ""),
        ((946_684_800_000_001).to_bytes(8, "big") + b"\xfd", "telemetry"),  # 2000-01-01 00:00 UTC
        ((946_684_800_000_000).to_bytes(8, "big") + b"\xfd", ""),
        ((4_102_444_799_999_999).to_bytes(8, "big") + b"\xfd", "telemetry"),  # 2100-01-01
        ((4_102_444_800_000_000).to_bytes(8, "big") + b"\xfd", ""),
        (b"FMT, 128, 89, FMT\n", "dataflash_text"),
        (b"FMT, 128,\x00 89, FMT\n", ""),
        (b"ULog\x01\x12\x35\x01", "ulog"),
        (b"MATLAB 5.0 MAT-file, Platform: GLNXA64", "named_arrays"),
    ],
)
def test_the_first_bytes_tell_the_format(head, module):
    assert next((known.module for known in FORMATS if known.recognizes(head)), "") == module


@pytest.mark.parametrize(
    ("head", "cure"),
    [
        (b"PK\3\4", "a zip archive.*unzip x"),
        (b"PK\3\4..[Content_Types].xml", "a spreadsheet.*read_excel.'x'.*index=False"),
        (b"PK\3\4..time.npy", "arrays of numpy.*numpy.load.'x'"),
        (b"\x1f\x8b\x08", "a gzip archive.*gunzip x"),
        (b'{"time": [0.0, 0.1], "u": [1, 2]}', "JSON.*read_json.'x', lines=False"),
        (b'{"t": 0.0, "u": 1.0}\n{"t": 0.1, "u": 1.0}\n', "JSON.*read_json.'x', lines=True"),
        (b"#ROSBAG V2.0\n", "a ROS bag.*PlotJuggler"),
        (b"%PDF-1.7", "a PDF"),
        (b"\x89PNG\r", "a PNG image"),
    ],
)
def test_files_of_other_programs_are_named_with_what_makes_a_table_of_them(tmp_path, head, cure):
    (tmp_path / "x").write_bytes(head)
    with pytest.raises(ValueError, match=f"is {cure}"):
        read(tmp_path / "x")
