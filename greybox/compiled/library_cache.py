"""Compiled libraries, kept for the next time where only the user can write.

A library runs in this process with all rights of the user as soon as it is loaded. So the folder is
the user's own and closed to all others, and the name of every library holds the SHA-256 of its
contents, by which a damaged one is found.
"""

import hashlib
import os
import stat
from pathlib import Path

from greybox.files.safe_files import replacing

SUFFIX = ".so"


def kept_library(key: str) -> Path | None:
    """Return the library that was kept under this key; None if there is none. Damaged ones are removed.

    Raises
    ------
    RuntimeError
        If the folder belongs to somebody else.
    """
    for path in _folder().glob(f"{key}-*{SUFFIX}"):
        if path.is_file() and not path.is_symlink() and path.name == _name(key, path.read_bytes()):
            return path
        path.unlink(missing_ok=True)
    return None


def keep_library(key: str, contents: bytes) -> Path:
    """Keep a library under a key, and return its path.

    Raises
    ------
    RuntimeError
        If the folder belongs to somebody else.
    OSError
        If it cannot be written.
    """
    path = _folder() / _name(key, contents)
    with replacing(path) as temporary:
        temporary.write_bytes(contents)
    return path


def _name(key: str, contents: bytes) -> str:
    return f"{key}-{hashlib.sha256(contents).hexdigest()}{SUFFIX}"


def _folder() -> Path:
    """Return the cache, made where there is none; what it held while others could write there is removed."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "greybox"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not hasattr(os, "getuid"):
        return folder  # Windows, where the folder is in the user's profile
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise RuntimeError(
            f"{folder} does not belong to you, and code in it would run under your account: set XDG_CACHE_HOME to a "
            "folder of your own, or leave out compile=True."
        )
    if stat.S_IMODE(found.st_mode) & 0o077:
        folder.chmod(0o700)
        for path in folder.glob(f"*{SUFFIX}"):
            path.unlink(missing_ok=True)
    return folder
