"""Atomic file writes, and what counts as a file to read."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, which replaces `path` if no exception occurs."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


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
