"""Libraries that are kept: nobody else can put one there, and a damaged one is built anew."""

import os
import shutil
import sys

import pytest

from greybox.compiled.library_cache import keep_library, kept_library

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="about owners and modes of POSIX")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "greybox"


def test_what_was_kept_is_found_where_only_the_user_can_write(folder):
    before = os.umask(0)
    try:
        assert kept_library("key") is None
        path = keep_library("key", b"library")
    finally:
        os.umask(before)
    assert kept_library("key") == path
    assert kept_library("other") is None
    assert path.read_bytes() == b"library"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert [p.name for p in folder.iterdir()] == [path.name]


@pytest.mark.parametrize(
    "damage",
    [
        lambda path: path.write_bytes(b"librarx"),
        lambda path: path.write_bytes(b""),
        lambda path: path.rename(path.with_name("key-" + 64 * "0" + ".so")),
    ],
)
def test_a_damaged_library_is_removed(folder, damage):
    damage(keep_library("key", b"library"))
    assert kept_library("key") is None
    assert list(folder.iterdir()) == []
    assert keep_library("key", b"library") == kept_library("key")


def test_a_link_to_another_library_is_not_followed(folder, tmp_path):
    path = keep_library("key", b"library")
    (tmp_path / "elsewhere.so").write_bytes(b"library")
    path.unlink()
    path.symlink_to(tmp_path / "elsewhere.so")
    assert kept_library("key") is None
    assert (tmp_path / "elsewhere.so").exists()


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o755])
def test_what_lay_where_others_could_write_is_not_used(folder, mode):
    path = keep_library("key", b"library")
    folder.chmod(mode)
    assert kept_library("key") is None
    assert not path.exists()
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_folder_of_somebody_else_is_refused(folder, tmp_path, monkeypatch):
    keep_library("key", b"library")
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    for use in (kept_library, lambda key: keep_library(key, b"library")):
        with pytest.raises(
            RuntimeError,
            match=r"does not belong to you, .* set XDG_CACHE_HOME to a folder of your own",
        ):
            use("key")


def test_a_link_in_the_place_of_the_folder_is_refused(folder, tmp_path):
    keep_library("key", b"library")
    shutil.move(folder, tmp_path / "theirs")
    folder.symlink_to(tmp_path / "theirs")
    with pytest.raises(RuntimeError, match="does not belong to you"):
        kept_library("key")
