"""A disk on which files stay small."""

import resource
from contextlib import contextmanager


@contextmanager
def limited_files(size):
    """Let this process write no file of more bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
