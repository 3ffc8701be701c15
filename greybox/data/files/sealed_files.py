"""HDF5 files of one text with a checksum, written atomically and read without the HDF5 library.

A file is made in memory and written in one piece under a temporary name, since the HDF5 library
crashes when a disk is full. Its first 512 bytes are an HDF5 user block, which every HDF5 reader
skips; it has the kind of the file, the SHA-256 of everything after it, and where the text begins
and ends.

The checksum detects damage. It is not a signature: whoever changes a file can seal it again.
Damaged and crafted files can crash the HDF5 library, so only the bytes of the text are read.
"""

import hashlib
import io
import re
from pathlib import Path

import numpy as np

from greybox.data.files.safe_files import replacing, require_file

BLOCK = 512  # bytes, the smallest user block of HDF5
TITLE = "greybox fit, SHA-256 of what follows this block, and place of its text: "


def write_sealed(path: Path, text: bytes) -> None:
    """Write a text to a new HDF5 file, in the dataset ``/fit``, and replace `path` by it.

    Raises
    ------
    OSError
        If it cannot be written; `path` is then unchanged.
    """
    import h5py  # noqa: PLC0415  (reading does not need it)

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=BLOCK) as file:
        start = file.create_dataset("fit", data=np.bytes_(text)).id.get_offset()
    # A view of the bytes, without another copy of what may be large. A view of the buffer itself
    # would be held by a traceback, and crash Python 3.12 at its end.
    body = memoryview(buffer.getvalue())[BLOCK:]
    head = f"{TITLE}{hashlib.sha256(body).hexdigest()} {start} {start + len(text)}\n"
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head.encode().ljust(BLOCK, b"\0"))
        file.write(body)


def read_sealed(path: str | Path) -> bytes:
    """Return the text of a sealed file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is another file, or was changed after it was sealed.
    """
    raw = require_file(path).read_bytes()
    title = TITLE.encode()
    if not raw.startswith(title):
        raise ValueError(
            f"{path} is not a greybox fit: give a file that greybox 0.3 or later saved."
        )
    seal = re.match(rb"(\w+) (\d+) (\d+)\n", raw[len(title) : BLOCK])
    if seal is None or seal[1].decode() != hashlib.sha256(raw[BLOCK:]).hexdigest():
        raise ValueError(
            f"{path} is damaged or was changed since it was saved, or an earlier version of "
            "greybox saved it: restore it or make it again."
        )

    return raw[int(seal[2]) : int(seal[3])]
