"""Checksums of names and arrays, by which equal data are recognized."""

import hashlib

from numpy.typing import NDArray


def checksum_of(*items: str | NDArray) -> str:
    """Return the SHA-256 of names and arrays, one after the other."""
    digest = hashlib.sha256()
    for item in items:
        digest.update(item.encode() if isinstance(item, str) else item.tobytes())
    return digest.hexdigest()
