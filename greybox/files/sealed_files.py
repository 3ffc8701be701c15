"""HDF5 files with a checksum, written atomically and read in a subprocess.

A file is made in memory and written in one piece under a temporary name, since the HDF5 library
crashes when a disk is full. Its first 512 bytes are an HDF5 user block, which every HDF5 reader
skips; it has the kind of the file and the SHA-256 of everything after it.

The checksum finds damage. It is not a signature: whoever changes a file can seal it again. So the
HDF5 library reads the file in a subprocess, see `subprocess_reader`, which returns plain numbers
and texts.
"""

import hashlib
import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from greybox.files.safe_files import replacing, require_file
from greybox.files.subprocess_reader import read_in_subprocess
from greybox.files.text_table import printable

Node = Any  # h5py types every item as "group, dataset or type", which is of no help
BLOCK = 512  # bytes, the smallest user block of HDF5
DAMAGES = (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError)


@dataclass(frozen=True)
class Stored:
    """A group or dataset of a sealed file, with the part of h5py's interface that reading needs."""

    attrs: Mapping[str, Any]
    values: Any = None
    members: dict[str, "Stored"] = field(default_factory=dict)

    def __getitem__(self, place: str | tuple[()]) -> Any:
        """Return the values of a dataset for ``()``, or else the group or dataset at a path."""
        if isinstance(place, tuple):
            return self.values
        item = self
        for name in place.split("/"):
            item = item.members[name]
        return item

    def __contains__(self, name: str) -> bool:
        return name in self.members

    def __len__(self) -> int:
        return len(self.members)

    def items(self) -> Iterator[tuple[str, "Stored"]]:
        """Yield names and members in the order in which they were written."""
        yield from self.members.items()


def write_sealed(path: Path, kind: str, fill: Callable[[Node], None]) -> None:
    """Let `fill` write into a new HDF5 file, seal it, and replace `path` by it.

    Raises
    ------
    OSError
        If it cannot be written; `path` is then unchanged.
    """
    import h5py  # noqa: PLC0415  (reading needs it in the subprocess only)

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=BLOCK) as file:
        fill(file)
    # A view of the bytes, without another copy of what may be large. A view of the buffer itself
    # would be held by a traceback, and crash Python 3.12 at its end.
    body = memoryview(buffer.getvalue())[BLOCK:]
    head = _block(kind, hashlib.sha256(body).hexdigest())
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head)
        file.write(body)


@contextmanager
def open_sealed(path: Path, kind: str) -> Iterator[Stored]:
    """Open a sealed file for reading.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is of another kind, was changed after it was sealed, or cannot be read.
    """
    require_file(path)
    # The checksum comes before the HDF5 library, which damage could crash.
    _require_seal(path, kind)
    head, arrays = read_in_subprocess("sealed", path)
    try:
        yield _tree(head["items"], iter(arrays))
    except DAMAGES as error:
        raise ValueError(
            f"{path} is not a greybox {kind} or is damaged ({printable(str(error))})."
        ) from None


def _tree(items: list[dict[str, Any]], arrays: Iterator[Any]) -> Stored:
    """Return the root of the file from its items, in which every group precedes its members."""
    root = Stored({})
    for item in items:
        values = next(arrays) if item["holds"] == "numbers" else item.get("texts")
        stored = Stored(item["attributes"], values)
        group, _, name = item["path"].rpartition("/")
        if not item["path"]:
            root = stored
        else:
            (root[group] if group else root).members[name] = stored

    return root


def _require_seal(path: Path, kind: str) -> None:
    with path.open("rb") as file:
        head = file.read(BLOCK)
        if not head.startswith(_title(kind).encode()):
            raise ValueError(
                f"{path} is not a greybox {kind}: give a file that greybox saved as one."
            )
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if head != _block(kind, digest):
        raise ValueError(
            f"{path} is damaged or was changed since it was saved: restore it or make it again."
        )


def _block(kind: str, digest: str) -> bytes:
    return f"{_title(kind)}{digest}\n".encode().ljust(BLOCK, b"\0")


def _title(kind: str) -> str:
    return f"greybox {kind}, SHA-256 of what follows this block: "
