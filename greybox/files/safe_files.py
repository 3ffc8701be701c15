"""Atomic file writes, and what counts as a file to read."""

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:  # Windows, where what killed runs left behind stays
    fcntl = None

# Characters of a file's own name in that of its temporary file: with the rest, below 255 bytes in
# UTF-8.
LONGEST = 48
REST = re.compile(
    r".*\.\d+(-[0-9a-f]{8})?\.part"
)  # after that: the number of the process and a random one


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, which replaces `path` if no exception occurs.

    Every call has a temporary file of its own, so that threads and processes may write to one path:
    the last one wins. What killed runs left of theirs is removed first.

    Raises
    ------
    OSError
        If the file cannot be written, for example on a full disk; nothing is left of it, and `path`
        is as it was.
    """
    try:
        _remove_abandoned(path)
        temporary, lock = _locked_beside(path)
        with closing(lock):
            try:
                yield temporary
                if not lock.closed:
                    os.fsync(lock)  # some file systems say only now that they are full
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or str(error).rstrip(".")
        raise type(error)(
            f"{path} cannot be written ({reason}): free space or choose another folder."
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def require_file(path: Path) -> None:
    """Refuse what is not a file that can be read from its beginning to its end, more than once.

    Raises
    ------
    OSError
        For a path where nothing is (`FileNotFoundError`), a folder, and a pipe, which would block.
    """
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}.")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: give a file in it.")
    if not path.is_file():
        raise OSError(f"{path} is a pipe or a device: copy what it gives to a file, and give that.")


def _locked_beside(path: Path) -> tuple[Path, BinaryIO]:
    """Make a temporary file beside `path`, locked as long as it is open: the sign that its run is alive."""
    while True:
        temporary = path.with_name(
            f".{path.name[:LONGEST]}.{os.getpid()}-{secrets.token_hex(4)}.part"
        )
        lock = temporary.open("xb")
        if fcntl is None:
            lock.close()  # Windows does not rename a file that is open
            return temporary, lock
        with suppress(
            OSError
        ):  # where a file system has no locks, nobody can take the file for abandoned
            fcntl.flock(lock, fcntl.LOCK_EX)
        if temporary.exists():
            return temporary, lock
        lock.close()  # another run took it for abandoned before it was locked


def _remove_abandoned(path: Path) -> None:
    """Remove temporary files of `path` that no run holds: a lock ends with its process, however that ends."""
    if fcntl is None:
        return
    for left in path.parent.glob(f".{escape(path.name[:LONGEST])}.*.part"):
        if not REST.fullmatch(left.name) or left.is_symlink() or not left.is_file():
            continue
        with suppress(OSError), left.open("rb") as file:  # another user's, held, or gone by now
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            left.unlink()
