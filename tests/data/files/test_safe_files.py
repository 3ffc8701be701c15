import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from greybox.data.files import safe_files
from greybox.data.files.safe_files import replacing, write_text

# Without the rest of greybox, whose import takes longer than the test.
ALONE = {**os.environ, "PYTHONPATH": str(Path(safe_files.__file__).parent)}


def test_a_text_is_written_whole(tmp_path):
    path = tmp_path / "a.csv"
    write_text(path, "ω, °\n")
    assert path.read_bytes() == "ω, °\n".encode()
    write_text(path, "new")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.parametrize("before", ["old", None])
def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path, before):
    path = tmp_path / "a.csv"
    if before is not None:
        path.write_text(before)

    def fail(temporary):
        temporary.write_text("half of")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), replacing(path) as temporary:
        fail(temporary)
    assert [p.read_text() for p in tmp_path.iterdir()] == ([] if before is None else [before])


def test_nobody_sees_a_file_that_is_not_complete(tmp_path):
    path = tmp_path / "a.csv"
    with replacing(path) as temporary:
        temporary.write_text("half of")
        assert not path.exists()
        assert temporary.parent == path.parent  # a rename is atomic only within a file system
    assert path.read_text() == "half of"


def test_threads_that_write_to_one_path_leave_one_whole_file(tmp_path):
    path = tmp_path / "a.csv"
    texts = [letter * 200_000 for letter in "abcd"]
    failed = []

    def write(text):
        try:
            for _ in range(10):
                write_text(path, text)
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failed == []
    assert path.read_text() in texts
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no limit of file sizes")
@pytest.mark.parametrize("before", ["old", None])
def test_a_full_disk_is_a_sentence_and_nothing_is_left(tmp_path, before):
    path = tmp_path / "a.csv"
    if before is not None:
        path.write_text(before)
    code = """
import resource, sys
from pathlib import Path
from safe_files import write_text
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write_text(Path(sys.argv[1]), "x" * 5000)
except OSError as error:
    print(error)
"""
    command = [sys.executable, "-c", code, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=ALONE)
    expected = f"{path} cannot be written (File too large): free space or choose another folder."
    assert done.stdout.strip() == expected
    assert [p.read_text() for p in tmp_path.iterdir()] == ([] if before is None else [before])


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"none.a\.csv cannot be written .*: free space or choose another"
    ):
        write_text(tmp_path / "none" / "a.csv", "x")


@pytest.mark.parametrize("name", ["x" * 251 + ".csv", "ω" * 120 + ".h5", "[a]*?.csv"])
def test_any_name_of_a_file_serves(tmp_path, name):
    write_text(tmp_path / name, "x")
    assert [p.name for p in tmp_path.iterdir()] == [name]
