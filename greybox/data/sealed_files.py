"""HDF5 files with a checksum, written atomically.

A file is written under a temporary name and renamed when it is complete. Its first 512 bytes are an HDF5 user block,
which every HDF5 reader skips; it holds the kind of the file and the SHA-256 of everything after it. A damaged file is
refused before the HDF5 library, which may loop forever on it, opens it.
"""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from greybox.data.safe_files import replacing

Node = Any  # h5py types every item as "group, dataset or type", which is of no help
BLOCK = 512  # bytes, the smallest user block of HDF5


def write_sealed(path: Path, kind: str, fill: Callable[[Node], None]) -> None:
    """Let `fill` write into a new HDF5 file, seal it, and replace `path` by it."""
    with replacing(path) as temporary:
        with h5py.File(temporary, "w", userblock_size=BLOCK) as file:
            fill(file)
        seal(temporary, kind)


@contextmanager
def open_sealed(path: Path, kind: str) -> Iterator[Node]:
    """Open a sealed file for reading.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is of another kind, or was changed since it was sealed, or cannot be read.
    """
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}.")
    _require_seal(path, kind)
    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, LookupError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} is not a greybox {kind} or is damaged ({error}).") from None


def seal(path: Path, kind: str) -> None:
    """Write kind and checksum into the user block of an HDF5 file."""
    with path.open("r+b") as file:
        file.seek(BLOCK)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0)
        file.write(f"{_title(kind)}{digest}\n".encode().ljust(BLOCK, b"\0"))


def is_sealed(path: Path, kind: str) -> bool:
    """Tell whether a file claims to be a sealed one of this kind."""
    with path.open("rb") as file:
        return file.read(BLOCK).startswith(_title(kind).encode())


def _require_seal(path: Path, kind: str) -> None:
    if not is_sealed(path, kind):
        raise ValueError(f"{path} is not a greybox {kind}: give a file that greybox saved as one.")
    with path.open("rb") as file:
        head = file.read(BLOCK)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if head.rstrip(b"\0").decode(errors="replace") != f"{_title(kind)}{digest}\n":
        raise ValueError(f"{path} is damaged or was changed since it was saved: restore it or make it again.")


def _title(kind: str) -> str:
    return f"greybox {kind}, SHA-256 of what follows this block: "
