"""The mark of this user on the runs and answers that a study stores.

A study that arrives by mail may contain runs that nobody made. A mark is a keyed hash of what is
stored. Its key is random, made once, and lies in a folder of the user that no study contains, so
that a stranger cannot make marks. A study that is moved or copied on the same account keeps them.
"""

import os
import secrets
import sys
from contextlib import suppress
from functools import lru_cache
from hashlib import blake2b, sha256
from pathlib import Path

MARK = 16  # bytes: nobody guesses one in 2^128


def mark(*values: bytes | str | float | None) -> bytes:
    """Return the mark of this user on some values of SQLite."""
    whole = blake2b(digest_size=MARK, key=_key(key_path()))
    for value in values:
        data = as_bytes(value)
        # With their lengths, no other values have the same bytes.
        whole.update(b"%d:" % len(data))
        whole.update(data)
    return whole.digest()


def mark_of_files(folder: Path, *others: str | float | None, but: Path) -> str:
    """Return the mark of this user on other values and on all files in a folder `but` one."""
    values: list[bytes | str | float | None] = [*others]
    for path in sorted({*folder.rglob("*")} - {but}):
        if path.is_symlink():
            values += [path.relative_to(folder).as_posix(), os.readlink(path)]
        elif path.is_file():
            values += [path.relative_to(folder).as_posix(), sha256(path.read_bytes()).digest()]
    return mark(*values).hex()


def as_bytes(value: bytes | str | float | None) -> bytes:
    """Return a value of SQLite as bytes."""
    return value if isinstance(value, bytes) else str(value).encode("utf-8", "surrogatepass")


def key_path() -> Path:
    """Return where the key of this user lies, in the folder that the system has for such files."""
    folder = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_STATE_HOME")
    # An account without a home folder has no place for a key.
    home = Path(folder) if folder else Path(os.path.expanduser("~")) / ".local" / "state"
    return home / "greybox" / "key"


@lru_cache(4)
def _key(path: Path) -> bytes:
    """Return the key of this user, made at the first call.

    Where it cannot be stored, as in a container without a home, every process has a key of its own:
    its runs are then to be confirmed when another process continues them.
    """
    new = secrets.token_bytes(32)
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    with suppress(OSError):
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            try:
                descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                with os.fdopen(descriptor, "wb") as file:
                    file.write(new)
                # Two processes may begin at once. The first one wins: a link replaces nothing.
                with suppress(FileExistsError):
                    os.link(temporary, path)
            finally:
                temporary.unlink(missing_ok=True)
        stored = path.read_bytes()
        if len(stored) == len(new):
            return stored
    return new
