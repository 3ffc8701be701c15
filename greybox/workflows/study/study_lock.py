"""The lock of a folder, in which one process writes at a time, and all may read."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from greybox.workflows.study.damage import mend, require_own
from greybox.workflows.study.database import DATABASE, require_plain

LOCK = "lock"
# Seconds to wait for the lock: a worker that was starting when its parent was killed holds the
# parent's files until its own program runs.
PATIENCE = 2.0


@contextmanager
def locked(folder: Path, *, trust: bool = False) -> Iterator[None]:
    """Create the folder if necessary, keep other processes from writing, and mend it.

    A warning names what was damaged, see `mend`. With `trust`, the runs and answers of another user
    become those of this one.

    Raises
    ------
    ValueError
        If another user made some of its runs or answers, without `trust`.
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  (6 ms of the import of greybox)

    lock = FileLock(folder / LOCK, timeout=PATIENCE)
    # A signal may arrive as soon as the lock is held: nothing may stand between it and its release.
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in (LOCK, DATABASE):
                require_plain(folder / name)
            lock.acquire()
        except Timeout:
            raise BlockingIOError(
                f"another process is writing to {folder}: wait until it ends, or give another "
                "folder."
            ) from None
        except OSError as error:
            reason = error.strerror or str(error).rstrip(".")
            raise type(error)(
                f"{folder} cannot be written ({reason}): choose another folder."
            ) from error

        if not trust:
            require_own(folder)
        for text in mend(folder, trust=trust):
            warnings.warn(f"{folder}: {text}; what is missing is computed again.", stacklevel=4)
        yield
    finally:
        # Interrupted inside `acquire`, the lock may be held without being counted.
        lock.release(force=True)
