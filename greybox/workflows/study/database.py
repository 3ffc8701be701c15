"""The SQLite database of a study, opened so that files from strangers can do no harm.

``study.sqlite`` contains the members with their answers and fits, and all runs. SQLite commits are
atomic: after `kill -9`, all runs and answers up to the last commit remain.

A folder may come from a stranger:

- Reading writes nothing and follows no journal: SQLite would delete any file that a crafted journal
  names. If a process was killed in the middle of a commit, a private copy is rolled back.
- A batch continues only with runs and answers that have the mark of this user
  (`greybox.workflows.study.ownership`), unless the user trusts the others.
- Runs are JSON texts with a checksum, answers and fits are compressed JSON. Nothing is executed.
"""

import atexit
import os
import shutil
import sqlite3
import stat
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from greybox.workflows.study.ownership import as_bytes, mark

DATABASE = "study.sqlite"
# SQLite files name the program that wrote them. Here the name includes the version of the tables:
# "gre3".
APPLICATION = 0x67_72_65_33

TABLES = (
    "CREATE TABLE members (id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
    "fingerprint TEXT DEFAULT '', answer BLOB, fit BLOB, checksum INTEGER, mark BLOB)",
    "CREATE TABLE runs (member INTEGER, number INTEGER, run TEXT, checksum INTEGER, mark BLOB, "
    "PRIMARY KEY (member, number))",
    f"PRAGMA application_id = {APPLICATION}",
)

# Columns from which checksums and marks of runs and answers are computed: their contents, and the
# place where they are stored.
RUN = "CAST(run AS BLOB), CAST(name AS BLOB), number, CAST(fingerprint AS BLOB)"
ANSWER = "CAST(answer AS BLOB), CAST(fit AS BLOB), CAST(name AS BLOB)"

# Gives all answers the mark of this user.
MARK_ANSWERS = (
    f"UPDATE members SET (checksum, mark) = (crc32({ANSWER}, mark({ANSWER})), mark({ANSWER})) "
    "WHERE answer IS NOT NULL"
)

# The last bytes of a journal that names another file, which SQLite deletes after rolling back. The
# journal of a single database has no such end: https://www.sqlite.org/fileformat2.html, section 3.
NAMES_A_FILE = bytes.fromhex("d9d505f920a163d7")


class DamagedStudyError(ValueError):
    """Raised if the database of a study is damaged, or a file is no such database."""

    def __init__(self, folder: Path) -> None:
        super().__init__(
            f"{folder / DATABASE} is damaged or not a study: restore it, or run the batch again, "
            "which repeats what cannot be read."
        )


def is_study(folder: Path) -> bool:
    """Return whether the folder has a study."""
    # A full disk leaves an empty file, which contains nothing that could be lost.
    path = folder / DATABASE
    return path.is_file() and path.stat().st_size > 0


def require_undamaged(folder: Path, checksum: int, *values: Any) -> None:
    """Raise ValueError if stored values do not match their checksum.

    The last values say where they are stored, see `RUN` and `ANSWER`.
    """
    # The checksum detects accidental damage. Values from strangers are checked where they are used.
    if checksum != _checksum(*values):
        raise DamagedStudyError(folder)


def _checksum(*values: bytes | str | float | None) -> int:
    """Return the checksum of values of SQLite."""
    return zlib.crc32(b"\n".join(map(as_bytes, values)))


@contextmanager
def writing(folder: Path, *, create: bool = False) -> Iterator[sqlite3.Connection]:
    """Open the database of a study for one transaction that writes.

    Raises ValueError for the database of another program, and OSError if it cannot be written.
    """
    path = folder / DATABASE
    require_safe(path)
    if ends_with_a_name(journal_of(path)):
        raise ValueError(
            f"{journal_of(path)} names another file, which SQLite would delete: no journal of a "
            "study does so. Do not use this folder."
        )
    with (
        _sentences(folder, "written", "free space or choose another folder"),
        opened(path, "rwc" if create else "rw") as connection,
        connection,
    ):
        if create and not tables_of(connection):
            # A small member would fill one and a half of the usual pages of 4096 bytes.
            connection.execute("PRAGMA page_size = 1024")
            connection.execute("BEGIN")
            for statement in TABLES:
                connection.execute(statement)
        _require_study(folder, connection)
        yield connection


@contextmanager
def reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the database of a study, possibly of a stranger, without writing anything."""
    path = folder / DATABASE
    require_safe(path)
    with _sentences(folder, "read", "try again once nobody writes to it"):
        try:
            # If a process that was killed has left a journal, SQLite refuses to read before it has
            # rolled back.
            with opened(path, "ro") as connection:
                connection.execute("SELECT 1 FROM sqlite_master").fetchone()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            # Without a journal, another writer has rolled back by now.
            with suppress(FileNotFoundError):
                path = _rolled_back(path, _stamp(path), _stamp(journal_of(path)))
        with opened(path, "ro") as connection:
            _require_study(folder, connection)
            yield connection


def journal_of(path: Path) -> Path:
    """Return the path of a database's journal."""
    return path.with_name(f"{path.name}-journal")


def _stamp(path: Path) -> tuple[int, ...]:
    """Return numbers of a file that differ after it was changed."""
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns


# Cached, because the fits of a study are read one by one.
@lru_cache(1)
def _rolled_back(path: Path, *stamps: tuple[int, ...]) -> Path:
    """Return a temporary copy of a database, rolled back after its last writer was killed.

    If the journal names another file, it is no journal of a study, and the copy is not rolled back.
    `stamps` are those of the database and of its journal, see `_stamp`.
    """
    folder = tempfile.mkdtemp(prefix="greybox-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    copy = Path(folder) / DATABASE
    shutil.copyfile(path, copy)
    names_a_file = ends_with_a_name(journal_of(path))
    if not names_a_file:
        shutil.copyfile(journal_of(path), journal_of(copy))
    if (_stamp(path), _stamp(journal_of(path))) != stamps:
        raise BlockingIOError(f"another process began to write to {path}: read it again.")
    if not names_a_file:
        with opened(copy) as connection:
            connection.execute("SELECT 1 FROM sqlite_master").fetchone()
    # A crafted journal may ask for a file of any size.
    if copy.stat().st_size > sum(size for _, size, _ in stamps):
        raise DamagedStudyError(path.parent)
    return copy


def require_plain(path: Path) -> None:
    """Raise ValueError for a link, a pipe or the like, but not if there is no file."""
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(path.lstat().st_mode):
            raise ValueError(f"{path} is a link, or no file: no study has such a thing.")


def require_safe(path: Path) -> None:
    """Raise ValueError if SQLite would follow other files than the database and its journal.

    One such file is a write-ahead log, to which SQLite writes even when it reads. No study has one.
    """
    require_plain(path)
    require_plain(journal_of(path))
    for ending in ("-wal", "-shm"):
        other = path.with_name(f"{path.name}{ending}")
        if os.path.lexists(other):
            raise ValueError(f"{other} is not a file of a study: do not use this folder.")
    if has_write_ahead_log(path):
        raise DamagedStudyError(path.parent)


def has_write_ahead_log(path: Path) -> bool:
    """Return whether the header of a database asks for a write-ahead log."""
    if not path.exists():
        return False
    # The bytes 18 and 19 are the versions for writing and reading; 2 means a write-ahead log.
    with path.open("rb") as file:
        return 2 in file.read(20)[18:]


def ends_with_a_name(journal: Path) -> bool:
    """Return whether a journal names another file, as no journal of a study does."""
    if not journal.exists():
        return False
    with journal.open("rb") as file:
        file.seek(max(journal.stat().st_size - len(NAMES_A_FILE), 0))
        return file.read() == NAMES_A_FILE


@contextmanager
def _sentences(folder: Path, what: str, cure: str) -> Iterator[None]:
    """Turn errors of SQLite into an error whose message says what happened and what to do."""
    try:
        yield
    except sqlite3.Error as error:
        if is_damage(error):
            raise DamagedStudyError(folder) from error
        raise OSError(f"{folder / DATABASE} cannot be {what} ({error}): {cure}.") from error


def _require_study(folder: Path, connection: sqlite3.Connection) -> None:
    """Raise ValueError for the database of another program or version, or without its tables."""
    if tables_of(connection) == TABLES[:2]:
        return
    if is_ours(connection):
        raise DamagedStudyError(folder)
    raise ValueError(
        f"{folder / DATABASE} is not a study, or was made by another version of greybox: update "
        "greybox, or begin another study."
    )


def require_tree(folder: Path, connection: sqlite3.Connection) -> None:
    """Raise ValueError for a database that uses a page twice."""
    # In a crafted database, many rows could share the same pages, or pages could refer to each
    # other in a circle. Reading it could take any time and memory. SQLite's check visits each page
    # once.
    if connection.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
        raise DamagedStudyError(folder)


@contextmanager
def opened(path: Path, mode: str = "rw") -> Iterator[sqlite3.Connection]:
    """Open a database without trusting the functions that its schema calls.

    `mode` is that of SQLite: "ro", "rw" or "rwc".
    """
    # A process that reads a large study makes the writer wait for a while.
    with closing(
        sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", timeout=30, uri=True)
    ) as connection:
        # The schema of a stranger's database could call functions with side effects.
        connection.execute("PRAGMA trusted_schema = OFF")
        # Damaged letters are no error here: the checksum of the text detects them.
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")
        connection.create_function("crc32", -1, _checksum, deterministic=True)
        connection.create_function("mark", -1, mark, deterministic=True)
        yield connection


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether an error is due to the contents, and not to the disk or another process."""
    # SQLITE_ERROR means, for example, that a table does not exist.
    return (
        not isinstance(error, sqlite3.OperationalError)
        or error.sqlite_errorcode == sqlite3.SQLITE_ERROR
    )


def is_ours(connection: sqlite3.Connection) -> bool:
    """Return whether greybox made a database, with tables of this version."""
    return connection.execute("PRAGMA application_id").fetchone() == (APPLICATION,)


def tables_of(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Return the SQL statements that define the tables of a database."""
    query = "SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rootpage"
    return tuple(sql for (sql,) in connection.execute(query))
