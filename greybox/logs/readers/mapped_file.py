"""Log files that are mapped into memory, piece by piece."""

import mmap

Bytes = bytes | mmap.mmap


def release(data: Bytes, start: int, end: int) -> None:
    """Let go of the pages of a mapped file: what was read of it counts as memory of this process until then."""
    if isinstance(data, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        first = max(start, 0) // mmap.PAGESIZE * mmap.PAGESIZE
        if end > first:
            data.madvise(mmap.MADV_DONTNEED, first, end - first)
