"""A study on disk: a folder in which one process writes at a time, and all may read.

``study.sqlite``  an SQLite database: members with answers and fits, and every run as it is made.
``lock``          locked by the process that writes.

The next process that writes removes what is damaged, and computes it again (`mend`).

A folder may come from a stranger. Reading it writes nothing and follows no journal: SQLite would
delete whatever file a crafted journal names. Where a process was killed in the middle of a commit,
a private copy is rolled back. Writing needs runs and answers with the mark of this user
(`greybox.study.ownership`), or the user's word.

A single fit with ``--out`` and a bootstrap keep their runs in such a folder, too, as those of one
member. SQLite commits are atomic: `kill -9` leaves all runs and answers up to the last commit. Runs
are JSON texts with a checksum, answers and fits are compressed JSON, so nothing in a folder from a
stranger is executed. A commit takes some milliseconds of the disk: the results of small members are
written together.
"""

import atexit
import json
import os
import shutil
import sqlite3
import stat
import tempfile
import time
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

from greybox.estimate.result import Fit
from greybox.estimate.stored_values import read, write
from greybox.files.arrays import Array, Fields, Labels, Named, NamedStrings, Strings, frozen
from greybox.files.escapes import printable
from greybox.files.json_numbers import parsed
from greybox.files.packed import packed, unpacked
from greybox.files.text_table import counted, listed, one_line
from greybox.solve.interruption import Response, responding
from greybox.solve.run_storage import RunStorage, RunStorageError
from greybox.solve.runs import IMPROVED, POLISHED, SCREENED, Outcome
from greybox.study.answer import LONGEST, checked_answer
from greybox.study.ownership import as_bytes, mark

Status = Literal["done", "failed", "unfinished"]

# Fields of an answer that tell members of a study apart.
FACTORS = ("model", "data", "criterion", "delay", "seed", "fixed", "at")

DATABASE = "study.sqlite"
LOCK = "lock"
# SQLite files name the program that wrote them, here with the layout: "gre3".
APPLICATION = 0x67_72_65_33
TABLES = (
    "CREATE TABLE members (id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
    "fingerprint TEXT DEFAULT '', answer BLOB, fit BLOB, checksum INTEGER, mark BLOB)",
    "CREATE TABLE runs (member INTEGER, number INTEGER, run TEXT, checksum INTEGER, mark BLOB, "
    "PRIMARY KEY (member, number))",
    f"PRAGMA application_id = {APPLICATION}",
)

# What a run and an answer are: their contents, and the place where they are stored.
RUN = "CAST(run AS BLOB), CAST(name AS BLOB), number, CAST(fingerprint AS BLOB)"
ANSWER = "CAST(answer AS BLOB), CAST(fit AS BLOB), CAST(name AS BLOB)"

# Rows with wrong checksums: the words for them, and the statement that removes them.
DAMAGED_RUNS = (
    "runs LEFT JOIN members ON id = member WHERE name IS NULL OR "
    f"ifnull(runs.checksum, -1) != crc32({RUN}, runs.mark)"
)
DAMAGED_ANSWERS = (
    f"members WHERE answer IS NOT NULL AND ifnull(checksum, -1) != crc32({ANSWER}, mark)"
)
DAMAGES = {
    "damaged run": (
        DAMAGED_RUNS,
        f"DELETE FROM runs WHERE rowid IN (SELECT runs.rowid FROM {DAMAGED_RUNS})",
    ),
    "damaged answer": (
        DAMAGED_ANSWERS,
        f"UPDATE members SET answer = NULL WHERE id IN (SELECT id FROM {DAMAGED_ANSWERS})",
    ),
}

# What is stored with the mark of this user.
STORE_RUN = (
    f"INSERT OR REPLACE INTO runs SELECT id, number, run, crc32({RUN}, mark), mark FROM "
    f"(SELECT *, mark({RUN}) AS mark FROM (SELECT id, name, fingerprint, "
    ":number AS number, :run AS run FROM members WHERE name = :name))"
)
STORE_ANSWER = "UPDATE members SET answer = :answer, fit = :fit WHERE name = :name"
MARK_RUNS = (
    f"UPDATE runs SET (checksum, mark) = (SELECT crc32({RUN}, mark), mark FROM (SELECT *, "
    f"mark({RUN}) AS mark FROM (SELECT name, fingerprint FROM members WHERE id = member)))"
)
MARK_ANSWERS = (
    f"UPDATE members SET (checksum, mark) = (crc32({ANSWER}, mark({ANSWER})), mark({ANSWER})) "
    "WHERE answer IS NOT NULL"
)
# Whole rows without the mark of this user.
UNMARKED = {
    "run": "SELECT COUNT(*) FROM runs JOIN members ON id = member "
    f"WHERE runs.checksum = crc32({RUN}, runs.mark) AND runs.mark IS NOT mark({RUN})",
    "answer": "SELECT COUNT(*) FROM members WHERE answer IS NOT NULL "
    f"AND checksum = crc32({ANSWER}, mark) AND mark IS NOT mark({ANSWER})",
}

# The last bytes of a journal that names another file, which SQLite deletes once it has rolled back.
# No journal of a single database ends so: https://www.sqlite.org/fileformat2.html, section 3.
NAMES_A_FILE = bytes.fromhex("d9d505f920a163d7")

# Largest amount of work, and largest age, of runs that are not on disk yet, s.
UNWRITTEN = 2.0
# Seconds to wait for the lock: a worker that was starting when its parent was killed holds the
# parent's files until its own program runs.
PATIENCE = 2.0


class DamagedStudyError(ValueError):
    """The database of a study cannot be read, or is not one."""

    def __init__(self, folder: Path) -> None:
        super().__init__(
            f"{folder / DATABASE} is damaged or not a study: restore it, or run the batch again, "
            "which repeats what cannot be read."
        )


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
                _require_plain(folder / name)
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


@frozen
class StudyMember:
    """One fit of a study.

    Attributes
    ----------
    folder : Path
        The folder of the study.
    number : int
    name : str
    answer : mapping
        The numbers of the fit, as ``greybox fit --json`` prints them; empty without an answer.
    stored_runs : int
        Number of runs on disk.
    models : sequence
        Models of one's own, as in `greybox.load`.
    """

    folder: Path
    number: int
    name: str
    answer: Named
    stored_runs: int
    models: Sequence[Any] = ()

    @property
    def error(self) -> str:
        """Why the member failed; empty if it did not."""
        return str(self.answer.get("error", ""))

    @property
    def reason(self) -> str:
        """Why there is no fit, with the cure; empty if there is one."""
        if self.status == "unfinished":
            return "not fitted yet: the same batch continues"
        return self.error

    @property
    def factors(self) -> NamedStrings:
        """What members are selected and grouped by: status, model, data and the like, as texts."""
        texts = {"status": str(self.status)}
        for name in FACTORS:
            value = self.answer.get(name)
            if isinstance(value, dict):
                value = ", ".join(f"{key} = {number:g}" for key, number in value.items())
                if name == "fixed":  # a structure with all parameters free is one, too
                    value = value or "nothing fixed"
            elif isinstance(value, list):
                value = ", ".join(value)
            if value not in (None, ""):
                texts[name] = str(value)
        return texts

    @property
    def status(self) -> Status:
        """Return "done" with a usable answer, "failed" with an error, or "unfinished"."""
        if not self.answer:
            return "unfinished"
        return "failed" if self.error else "done"

    @property
    def runs(self) -> int:
        """Number of runs on disk, or of the answer."""
        return int(self.answer["starts"]) if self.status == "done" else self.stored_runs

    @property
    def fit(self) -> Fit | None:
        """The whole fit, read from the study; None if there is none, and `reason` says why."""
        if self.status != "done":
            return None
        from greybox.estimate.storage import from_bytes  # noqa: PLC0415  (slow import)

        query = "SELECT checksum, answer, fit, name, mark FROM members WHERE id = ?"
        with _reading(self.folder) as database:
            row = database.execute(query, (self.number,)).fetchone()
        if row is None:
            raise DamagedStudyError(self.folder)
        _require_whole(self.folder, *row)
        place = f"the fit of {self.name!r} in {self.folder / DATABASE}"
        try:
            text = unpacked(row[2], unpacked(row[1]))
        except ValueError as error:
            raise ValueError(f"{place} is damaged ({error}).") from None
        fit = from_bytes(text, self.models, place, stored=len(row[2]))
        # The tables show the answer, the figures the fit.
        if (fit.checksum, *fit.standard_error) != (
            self.answer["checksum"],
            *self.answer["standard_error"],
        ):
            raise ValueError(f"{place} is damaged (it is not that of the answer).")
        return fit

    def __repr__(self) -> str:
        return one_line(self, self.name, self.status, counted(self.runs, "run"))


def is_study(folder: Path) -> bool:
    """Return whether the folder has a study."""
    # A full disk leaves an empty file, which contains nothing that could be lost.
    path = folder / DATABASE
    return path.is_file() and path.stat().st_size > 0


def read_members(folder: Path) -> list[StudyMember]:
    """Return the members of a study in their order.

    Raises
    ------
    FileNotFoundError
        If there is no study in the folder.
    ValueError
        If its database is damaged, or was written by a later version.
    """
    if not is_study(folder):
        raise FileNotFoundError(
            f"{folder} is not a study, since it has no file {DATABASE}: give the folder that a "
            "batch wrote."
        )
    with _reading(folder) as database:
        _require_tree(folder, database)
        rows = database.execute(
            "SELECT id, name, answer, fit, checksum, mark, "
            "(SELECT COUNT(*) FROM runs WHERE member = id) FROM members ORDER BY id"
        )
        return [_member(folder, row) for row in rows]


def _member(folder: Path, row: Any) -> StudyMember:
    """Return the member of a row, in which a stranger may have stored any kinds of values."""
    number, name, answer, fit, checksum, marked, count = row
    has_answer = answer is not None
    kinds = ((name, str), (answer, bytes), (fit, bytes)) if has_answer else ((name, str),)
    if not all(isinstance(value, kind) for value, kind in kinds) or len(name) > LONGEST:
        raise DamagedStudyError(folder)
    shown = printable(name)
    stored: Named = {}
    if has_answer:
        _require_whole(folder, checksum, answer, fit, name, marked)
        stored = _StoredAnswer(answer, f"the answer of {shown!r} in {folder / DATABASE}")
    return StudyMember(folder, number, shown, stored, count)


class _StoredAnswer(Named):
    """An answer that is unpacked when it is read: as values ten thousand take 300 MB."""

    def __init__(self, answer: bytes, place: str) -> None:
        self._packed, self._place, self._is_checked = answer, place, False

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def _values(self) -> Fields:
        # To check it takes five times as long as to unpack it, which tables do again and again.
        if not self._is_checked:
            try:
                values = parsed(unpacked(self._packed), len(self._packed))
                checked = checked_answer(values)
            except ValueError as error:
                raise ValueError(
                    f"{self._place} is damaged ({error}): restore the folder, or begin another "
                    "study."
                ) from None
            if checked != values:
                # Not compressed: `unpacked` would refuse what expands too far.
                self._packed = zlib.compress(json.dumps(checked).encode(), 0)
            self._is_checked = True
        return _unpacked_values(self._packed)


@lru_cache(16)  # a table reads several numbers of a member, then those of the next
def _unpacked_values(answer: bytes) -> Fields:
    return dict(json.loads(unpacked(answer)))


def add_members(folder: Path, names: Labels) -> dict[str, StudyMember]:
    """Add the names that a study does not have, and return its members by name."""
    with _database(folder, create=True) as database:
        rows = [(name,) for name in names]
        database.executemany("INSERT OR IGNORE INTO members (name) VALUES (?)", rows)
    return {member.name: member for member in read_members(folder)}


class StoredRuns(RunStorage):
    """The runs of a member of a study; those of the members of a batch are written together.

    Attributes
    ----------
    fingerprint : str
        Key of the problem and its solver, once the search has begun.
    trouble : str
        Why the last changes were not written; empty if they were.
    """

    def __init__(self, folder: Path, name: str = "") -> None:
        self._folder = folder
        self.fingerprint = self.trouble = ""
        self.changes: list[tuple[str, Fields]] = []
        self._work, self._written_at = 0.0, time.monotonic()
        self.begin(name)

    def begin(self, name: str, *, is_new: bool = False) -> None:
        """Switch to a member; a new one has no runs on disk."""
        self._name, self._is_new, self._has_begun = name, is_new, False

    def stored(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return the runs on disk by the number of their start.

        Raises
        ------
        RunStorageError
            If they were made for another problem, or the database is damaged.
        """
        self.fingerprint = fingerprint
        if self._is_new or not is_study(self._folder):
            return {}
        query = (
            "SELECT number, run, runs.checksum, runs.mark, fingerprint FROM runs, members "
            "WHERE member = id AND name = ?"
        )
        try:
            with _reading(self._folder) as database:
                rows = database.execute(query, (self._name,)).fetchall()
            runs = {}
            for number, text, checksum, marked, key in rows:
                _require_whole(self._folder, checksum, text, self._name, number, key, marked)
                start, outcome = read(parsed(text.encode(), len(text)), tuple[Array, Outcome])
                is_sound = outcome.stage in (SCREENED, IMPROVED, POLISHED)
                if not (is_sound and start.ndim == outcome.estimate.ndim == 1):
                    raise ValueError
                runs[int(number)] = start, outcome
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            raise RunStorageError(str(DamagedStudyError(self._folder))) from error
        if any(row[-1] != fingerprint for row in rows):
            raise RunStorageError(
                f"the runs in {self._folder} belong to another problem, to other options, or to "
                "another version of greybox or CasADi: repeat what the study began with, or begin "
                "another study."
            )
        return runs

    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Store a run."""
        name = self._name
        if not self._has_begun:
            self._has_begun = True
            self._change("INSERT OR IGNORE INTO members (name) VALUES (:name)", name=name)
            statement = "UPDATE members SET fingerprint = :key WHERE name = :name"
            self._change(statement, key=self.fingerprint, name=name)
        self._change(STORE_RUN, name=name, number=number, run=json.dumps(write((start, outcome))))
        self._work += outcome.seconds
        self.write_due()

    def finish(self, answer: Named, fit: bytes = b"") -> None:
        """Store the answer of the member, which is then done, and its fit."""
        text = json.dumps(answer, allow_nan=False).encode()
        values = {"answer": packed(text), "fit": packed(fit, text), "name": self._name}
        self._change(STORE_ANSWER, **values)
        self._change(f"{MARK_ANSWERS} AND name = :name", name=self._name)

    def _change(self, statement: str, **values: Any) -> None:
        self.changes.append((statement, values))

    def write_due(self) -> None:
        """Write runs that are older, or took longer, than `UNWRITTEN`."""
        # A commit takes some milliseconds. After every run of a response, which takes no longer,
        # the disk would cost as much time as the solver.
        age = time.monotonic() - self._written_at
        if max(age, self._work) >= UNWRITTEN:
            with suppress(OSError):  # a full disk: the next run tries again
                self.write()

    def write(self) -> None:
        """Write all that is not on disk yet, also after Ctrl-C.

        Raises
        ------
        OSError
            If it cannot be written; what is on disk remains.
        """
        # The time of the attempt: a full disk is not tried again for every run.
        self._written_at = time.monotonic()
        if not self.changes:
            return
        try:
            with responding(Response.FINISH), _database(self._folder, create=True) as database:
                for change in self.changes:  # marked here: in a worker the user is another
                    database.execute(*change)
        except OSError as error:
            self.trouble = str(error)
            raise
        self.trouble, self.changes, self._work = "", [], 0.0

    @property
    def count(self) -> int:
        """Number of runs on disk."""
        members = read_members(self._folder) if is_study(self._folder) else []
        return sum(member.stored_runs for member in members if member.name == self._name)

    def remove(self) -> None:
        """Remove all runs."""
        self.changes = []
        (self._folder / DATABASE).unlink(missing_ok=True)


@contextmanager
def runs_beside(path: Path, *, trust: bool = False) -> Iterator[StoredRuns]:
    """Keep the runs of a fit in a folder beside its file until they are removed.

    Raises
    ------
    ValueError
        If another user made runs in this folder, without `trust`.
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    folder = folder_beside(path)
    with locked(folder, trust=trust):
        runs = StoredRuns(folder, "fit")
        try:
            yield runs
        except BaseException:
            with suppress(OSError):
                runs.write()
            raise
        finally:
            if not runs.count:
                (folder / DATABASE).unlink(missing_ok=True)
    with suppress(OSError):  # the folder is not empty if another process has begun there
        if not is_study(folder):
            (folder / LOCK).unlink(missing_ok=True)
            folder.rmdir()


def folder_beside(path: Path) -> Path:
    """Return the folder of the runs of a fit that is saved to this file."""
    return path.with_name(f"{path.name}.runs")


def _require_whole(folder: Path, checksum: int, *values: Any) -> None:
    """Raise ValueError if values are damaged, which end with the place where they are stored."""
    # The checksum finds damage by accident; what a stranger wrote is checked where it is used.
    if checksum != _checksum(*values):
        raise DamagedStudyError(folder)


def _checksum(*values: bytes | str | float | None) -> int:
    """Return the checksum of values of SQLite."""
    return zlib.crc32(b"\n".join(map(as_bytes, values)))


@contextmanager
def _database(folder: Path, *, create: bool = False) -> Iterator[sqlite3.Connection]:
    """Open the database of a study to write one transaction; refuse that of another program."""
    path = folder / DATABASE
    _require_safe(path)
    if _names_a_file(_journal(path)):
        raise ValueError(
            f"{_journal(path)} names another file, which SQLite would delete: no journal of a "
            "study does so. Do not use this folder."
        )
    with (
        _sentences(folder, "written", "free space or choose another folder"),
        _opened(path, "rwc" if create else "rw") as connection,
        connection,
    ):
        if create and not _tables(connection):
            # A small member fills one and a half of the usual pages; the rest would be empty.
            connection.execute("PRAGMA page_size = 1024")
            connection.execute("BEGIN")
            for statement in TABLES:
                connection.execute(statement)
        _require_study(folder, connection)
        yield connection


@contextmanager
def _reading(folder: Path) -> Iterator[sqlite3.Connection]:
    """Open the database of a study, possibly of a stranger, without writing anything."""
    path = folder / DATABASE
    _require_safe(path)
    with _sentences(folder, "read", "try again once nobody writes to it"):
        try:
            # SQLite looks whether a journal is that of a process which writes now, and refuses to
            # read before it has rolled back that of one which was killed.
            with _opened(path, "ro") as connection:
                connection.execute("SELECT 1 FROM sqlite_master").fetchone()
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
            with suppress(FileNotFoundError):  # the next writer has rolled it back by now
                path = _rolled_back(path, _stamp(path), _stamp(_journal(path)))
        with _opened(path, "ro") as connection:
            _require_study(folder, connection)
            yield connection


def _journal(path: Path) -> Path:
    return path.with_name(f"{path.name}-journal")


def _stamp(path: Path) -> tuple[int, ...]:
    """Return what changes when a file does."""
    about = path.stat()
    return about.st_ino, about.st_size, about.st_mtime_ns


@lru_cache(1)  # the fits of a study are read one by one
def _rolled_back(path: Path, *stamps: tuple[int, ...]) -> Path:
    """Return a temporary copy of a database whose last writer was killed, as it was before.

    A journal that names another file is none of a study: the copy is then the database as it is.
    """
    folder = tempfile.mkdtemp(prefix="greybox-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    copy = Path(folder) / DATABASE
    shutil.copyfile(path, copy)
    names_a_file = _names_a_file(_journal(path))
    if not names_a_file:
        shutil.copyfile(_journal(path), _journal(copy))
    if (_stamp(path), _stamp(_journal(path))) != stamps:
        raise BlockingIOError(f"another process began to write to {path}: read it again.")
    if not names_a_file:
        with _opened(copy) as connection:
            connection.execute("SELECT 1 FROM sqlite_master").fetchone()
    # The journal of a stranger may ask for a file of any size.
    if copy.stat().st_size > sum(size for _, size, _ in stamps):
        raise DamagedStudyError(path.parent)
    return copy


def _require_plain(path: Path) -> None:
    """Raise ValueError for a link, a pipe or the like; what does not exist is fine."""
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(path.lstat().st_mode):
            raise ValueError(f"{path} is a link, or no file: no study has such a thing.")


def _require_safe(path: Path) -> None:
    """Raise ValueError for a database beside which something lies that SQLite would follow.

    A write-ahead log is one: SQLite would write to it even to read, and studies have none.
    """
    _require_plain(path)
    _require_plain(_journal(path))
    for ending in ("-wal", "-shm"):
        other = path.with_name(f"{path.name}{ending}")
        if os.path.lexists(other):
            raise ValueError(f"{other} is not a file of a study: do not use this folder.")
    if _has_write_ahead_log(path):
        raise DamagedStudyError(path.parent)


def _has_write_ahead_log(path: Path) -> bool:
    """Return whether the header of a database asks for a write-ahead log."""
    if not path.exists():
        return False
    with path.open("rb") as file:
        return 2 in file.read(20)[18:]


def _names_a_file(journal: Path) -> bool:
    """Return whether a journal ends with the name of another one, as no journal of ours does."""
    if not journal.exists():
        return False
    with journal.open("rb") as file:
        file.seek(max(journal.stat().st_size - len(NAMES_A_FILE), 0))
        return file.read() == NAMES_A_FILE


@contextmanager
def _sentences(folder: Path, what: str, cure: str) -> Iterator[None]:
    """Raise errors of SQLite as sentences."""
    try:
        yield
    except sqlite3.Error as error:
        if _is_damage(error):
            raise DamagedStudyError(folder) from error
        raise OSError(f"{folder / DATABASE} cannot be {what} ({error}): {cure}.") from error


def _require_study(folder: Path, connection: sqlite3.Connection) -> None:
    """Raise ValueError for the database of another program or version, or without its tables."""
    if _tables(connection) == TABLES[:2]:
        return
    if _is_ours(connection):
        raise DamagedStudyError(folder)
    raise ValueError(
        f"{folder / DATABASE} is not a study, or was made by another version of greybox: update "
        "greybox, or begin another study."
    )


def _require_tree(folder: Path, connection: sqlite3.Connection) -> None:
    """Raise ValueError for a database of which a page is used twice."""
    # In a crafted database, many rows could share the same pages, and pages lead in circles:
    # whoever reads it would need any time and memory. Here, SQLite looks at every page once.
    if connection.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
        raise DamagedStudyError(folder)


@contextmanager
def _opened(path: Path, mode: str = "rw") -> Iterator[sqlite3.Connection]:
    # Whoever reads a large study lets the writer wait.
    with closing(
        sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", timeout=30, uri=True)
    ) as connection:
        # A database from a stranger could call functions from its schema.
        connection.execute("PRAGMA trusted_schema = OFF")
        # Damaged letters are found by the checksum of their text, not by SQLite.
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")
        connection.create_function("crc32", -1, _checksum, deterministic=True)
        connection.create_function("mark", -1, mark, deterministic=True)
        yield connection


def _is_damage(error: sqlite3.Error) -> bool:
    """Return whether the contents are at fault, and not the disk or another process."""
    # SQLITE_ERROR is, for example, a table that does not exist.
    return (
        not isinstance(error, sqlite3.OperationalError)
        or error.sqlite_errorcode == sqlite3.SQLITE_ERROR
    )


def _is_ours(connection: sqlite3.Connection) -> bool:
    return connection.execute("PRAGMA application_id").fetchone() == (APPLICATION,)


def _tables(connection: sqlite3.Connection) -> Strings:
    """Return the statements that made the tables of a database."""
    query = "SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rootpage"
    return tuple(sql for (sql,) in connection.execute(query))


# --- damage


def require_own(folder: Path) -> None:
    """Raise ValueError for a study with runs or answers that this user has not made."""
    if not is_study(folder) or _has_write_ahead_log(folder / DATABASE):
        return
    try:
        with _reading(folder) as database:
            _require_tree(folder, database)
            rows = [(what, database.execute(query).fetchone()) for what, query in UNMARKED.items()]
    except DamagedStudyError:
        return  # `mend` sets it aside
    foreign = [counted(count, what) for what, (count,) in rows if count]
    if foreign:
        raise ValueError(
            f"{folder} has {listed(foreign)} that were not made here by you: give another folder, "
            "or trust=True if you vouch for whoever made them."
        )


def mend(folder: Path, *, trust: bool = False) -> list[str]:
    """Remove what is damaged in a study that is locked, and return it as texts.

    A database that SQLite finds damaged is renamed. In others, runs and answers with wrong
    checksums are deleted. With `trust`, the others get the mark of this user.
    """
    if not is_study(folder):
        return []
    damage: list[str] = []
    path = folder / DATABASE
    if not _is_sound(path):
        damaged = path.with_suffix(".damaged")
        path.replace(damaged)
        # SQLite would apply the journal of the damaged database to the new one.
        _journal(path).unlink(missing_ok=True)
        return [f"the database was damaged and is kept as {damaged.name}"]

    with _database(folder) as database:
        for what, (rows, cure) in DAMAGES.items():
            counts = database.execute(f"SELECT name, COUNT(*) FROM {rows} GROUP BY name")
            damage += [f"{name}: removed {counted(count, what)}" for name, count in counts]
            database.execute(cure)
        for statement in (MARK_RUNS, MARK_ANSWERS) if trust else ():
            database.execute(statement)
    return [*map(printable, damage)]


def _is_sound(path: Path) -> bool:
    """Return whether SQLite can read all of a database, and all tables of a study are there."""
    if _has_write_ahead_log(path):
        return False
    _require_safe(path)
    if _names_a_file(_journal(path)):
        return True  # whoever writes refuses it
    try:
        with _opened(path) as database:
            whole = database.execute("PRAGMA integrity_check(1)").fetchone() == ("ok",)
            # Others belong to another program, or to a later version: they are refused, not mended.
            return whole and (not _is_ours(database) or _tables(database) == TABLES[:2])
    except sqlite3.Error as error:
        return not _is_damage(error)
