"""Whether a process is working on a study: seen without touching the folder."""

import os
import sys

import pytest
from filelock import FileLock

from greybox.workflows.study.running import is_running
from greybox.workflows.study.study_lock import locked


def test_the_lock_is_seen_as_long_as_it_is_held(tmp_path):
    folder = tmp_path / "study"
    with locked(folder):
        assert is_running(folder) is True
        assert is_running(folder) is True  # the look did not take it
    assert is_running(folder) is False
    with locked(folder):  # nor is it left held
        pass


def test_a_look_creates_and_changes_nothing(tmp_path):
    assert is_running(tmp_path) is False
    assert [*tmp_path.iterdir()] == []
    assert is_running(tmp_path / "none") is False
    lock = tmp_path / "lock"
    lock.write_text("as it was")
    before = lock.stat()
    assert is_running(tmp_path) is False
    assert lock.read_text() == "as it was"
    assert lock.stat().st_mtime_ns == before.st_mtime_ns


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and links are those of Unix")
@pytest.mark.parametrize("kind", ["pipe", "link", "folder"])
def test_what_is_not_a_file_is_neither_followed_nor_waited_for(tmp_path, kind):
    lock, victim = tmp_path / "lock", tmp_path / "victim"
    victim.write_text("mine")
    make = {
        "pipe": lambda: os.mkfifo(lock),
        "link": lambda: lock.symlink_to(victim),
        "folder": lock.mkdir,
    }
    make[kind]()
    assert is_running(tmp_path) is None
    assert victim.read_text() == "mine"


def test_a_signal_in_the_moment_of_locking_leaves_no_lock(tmp_path, monkeypatch):
    acquire = FileLock.acquire

    def interrupted(lock, *args, **options):
        acquire(lock, *args, **options)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(FileLock, "acquire", interrupted)
        # The error refers to the lock, which would release itself if it were forgotten.
        with pytest.raises(KeyboardInterrupt) as error, locked(tmp_path):
            raise AssertionError("the block has run")

    assert error.tb is not None
    with locked(tmp_path):
        pass
