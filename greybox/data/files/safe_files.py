"""Atomic file writes, and checks of files to be read."""

import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from greybox.data.files.argument_checks import require_kind

HDF5 = (".h5", ".hdf5")  # suffixes


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to, which replaces `path` if no exception occurs.

    Every call has its own temporary file, so threads and processes may write to the same path: the
    last one wins.

    Raises
    ------
    OSError
        If the file cannot be written, for example on a full disk. The temporary file is removed,
        and `path` is unchanged.
    """
    # In the same folder, since a rename is atomic within a file system only. With 48 characters of
    # the name, the whole stays below the limit of 255 bytes in UTF-8.
    temporary = path.with_name(f".{path.name[:48]}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        try:
            yield temporary
            with temporary.open("r+b") as file:
                # Some file systems report only now that they are full.
                os.fsync(file.fileno())
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


def require_file(path: str | os.PathLike[str]) -> Path:
    """Return the path of a file that can be read several times.

    Raises
    ------
    TypeError
        For anything but a path.
    OSError
        For a path that does not exist (`FileNotFoundError`), a folder, and a pipe, which would
        block.
    """
    require_kind("path", path, str | os.PathLike, "the name of a file")
    path = Path(path)
    # A study copies what it reads, see `cli/batch_command.py`.
    sys.audit("greybox.read", str(path))
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}.")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: give a file in it.")
    if not path.is_file():
        raise OSError(f"{path} is a pipe or a device: copy its contents to a file, and give that.")
    return path
