"""Whether a process is working on a study at this moment."""

import os
import stat
from contextlib import suppress
from pathlib import Path

from greybox.workflows.study.study_lock import LOCK


def is_running(folder: Path) -> bool | None:
    """Return whether a process holds the lock of a study; None if that cannot be seen.

    The operating system releases the lock when its process ends, also by `kill -9`. Nothing in the
    folder is created or changed, and nothing is waited for.
    """
    # What a stranger has put there in place of the file is not followed, and not waited for.
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        file = os.open(folder / LOCK, flags)
    except FileNotFoundError:
        return False
    except OSError:
        return None
    try:
        return _is_locked(file) if stat.S_ISREG(os.fstat(file).st_mode) else None
    finally:
        os.close(file)


def _is_locked(file: int) -> bool | None:
    """Return whether another open file has the lock, as `filelock` takes it; None if unknown."""
    with suppress(ImportError):
        import fcntl  # noqa: PLC0415  (not on Windows)

        try:
            # Shared: two readers do not see each other. A writer that comes now tries again.
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:  # a file system without locks
            return None
        return False

    import msvcrt  # noqa: PLC0415  (on Windows only)

    try:
        getattr(msvcrt, "locking")(file, getattr(msvcrt, "LK_NBLCK"), 1)  # noqa: B009
    except OSError:
        return True
    getattr(msvcrt, "locking")(file, getattr(msvcrt, "LK_UNLCK"), 1)  # noqa: B009
    return False
