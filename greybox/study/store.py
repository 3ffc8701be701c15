"""A study on disk: a folder in which one process writes at a time, and all may read.

``study.sqlite``  an SQLite database: members with answers and fits, and every run as it is made.
``lock``          locked by the process that writes.

The next process that writes removes what is damaged, and computes it again (`mend`).

A single fit with ``--out`` and a bootstrap keep their runs in such a folder, too, as those of one
member. SQLite commits are atomic: `kill -9` leaves all runs and answers up to the last commit. Runs
are JSON texts with a checksum, answers and fits are compressed JSON, so nothing in a folder from a
stranger is executed. A commit takes some milliseconds of the disk: the results of small members are
written together.
"""

import json
import sqlite3
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
from greybox.files.packed import packed, unpacked
from greybox.files.text_table import counted, one_line, printable
from greybox.solve.interruption import Response, responding
from greybox.solve.runs import IMPROVED, POLISHED, SCREENED, Outcome, RunStorage, RunStorageError

Status = Literal["done", "failed", "unfinished"]

# Fields of an answer that tell members of a study apart.
FACTORS = ("model", "data", "criterion", "delay", "seed", "fixed", "at")

DATABASE = "study.sqlite"
LOCK = "lock"
# SQLite files name the program that wrote them, here with the layout: "gre2".
APPLICATION = 0x67_72_65_32
TABLES = (
    "CREATE TABLE members (id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
    "fingerprint TEXT DEFAULT '', answer BLOB, fit BLOB, checksum INTEGER)",
    "CREATE TABLE runs (member INTEGER, number INTEGER, run TEXT, checksum INTEGER, "
    "PRIMARY KEY (member, number))",
    f"PRAGMA application_id = {APPLICATION}",
)

# Rows with wrong checksums: the words for them, and the statement that removes them.
DAMAGED_RUNS = (
    "runs LEFT JOIN members ON id = member WHERE name IS NULL OR "
    "ifnull(runs.checksum, -1) != "
    "crc32(CAST(run AS BLOB), CAST(name AS BLOB), number, CAST(fingerprint AS BLOB))"
)
DAMAGED_ANSWERS = (
    "members WHERE answer IS NOT NULL AND "
    "checksum != crc32(CAST(answer AS BLOB), CAST(fit AS BLOB), CAST(name AS BLOB))"
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

MEMBER = "(SELECT id FROM members WHERE name = ?)"

# Largest amount of work, and largest age, of runs that are not on disk yet, s.
UNWRITTEN = 2.0
# Seconds to wait for the lock: a worker that was starting when its parent was killed holds the
# parent's files until its own program runs.
PATIENCE = 2.0


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create the folder if necessary, keep other processes from writing, and mend it.

    A warning names what was damaged, see `mend`.

    Raises
    ------
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  (6 ms of the import of greybox)

    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK, timeout=PATIENCE)
        lock.acquire()
    except Timeout:
        raise BlockingIOError(
            f"another process is writing to {folder}: wait until it ends, or give another folder."
        ) from None
    except OSError as error:
        reason = error.strerror or str(error).rstrip(".")
        raise type(error)(
            f"{folder} cannot be written ({reason}): choose another folder."
        ) from error
    try:
        for text in mend(folder):
            warnings.warn(f"{folder}: {text}; what is missing is computed again.", stacklevel=4)
        yield
    finally:
        lock.release()


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

        query = "SELECT checksum, answer, fit, name FROM members WHERE id = ?"
        with _database(self.folder) as database:
            row = database.execute(query, (self.number,)).fetchone()
        _require_whole(self.folder, *row)
        return from_bytes(unpacked(row[2], unpacked(row[1])), self.models)

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
    with _database(folder) as database:
        rows = database.execute(
            "SELECT id, name, answer, fit, checksum, "
            "(SELECT COUNT(*) FROM runs WHERE member = id) FROM members ORDER BY id"
        )
        return [
            StudyMember(
                folder,
                number,
                printable(str(name)),
                {} if answer is None else _StoredAnswer(folder, checksum, answer, fit, name),
                count,
            )
            for number, name, answer, fit, checksum, count in rows
        ]


class _StoredAnswer(Named):
    """An answer that is unpacked when it is read: as values ten thousand take 300 MB."""

    def __init__(self, folder: Path, checksum: int, answer: Any, *others: Any) -> None:
        _require_whole(folder, checksum, answer, *others)
        self._packed = answer

    def __getitem__(self, key: str) -> Any:
        return _values(self._packed)[key]

    def __iter__(self) -> Iterator[str]:
        return iter(_values(self._packed))

    def __len__(self) -> int:
        return len(_values(self._packed))


@lru_cache(16)  # a table reads several numbers of a member, then those of the next
def _values(answer: bytes) -> Fields:
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
        self.changes: list[tuple[str, tuple[Any, ...]]] = []
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
            "SELECT number, run, runs.checksum, fingerprint FROM runs, members "
            "WHERE member = id AND name = ?"
        )
        try:
            with _database(self._folder) as database:
                rows = database.execute(query, (self._name,)).fetchall()
            runs = {}
            for number, text, checksum, key in rows:
                _require_whole(self._folder, checksum, text, self._name, number, key)
                start, outcome = read(json.loads(text), tuple[Array, Outcome])
                is_sound = outcome.stage in (SCREENED, IMPROVED, POLISHED)
                if not (is_sound and start.ndim == outcome.estimate.ndim == 1):
                    raise ValueError
                runs[int(number)] = start, outcome
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            raise RunStorageError(_damaged(self._folder)) from error
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
            self._change("INSERT OR IGNORE INTO members (name) VALUES (?)", name)
            statement = "UPDATE members SET fingerprint = ? WHERE name = ?"
            self._change(statement, self.fingerprint, name)
        text = json.dumps(write((start, outcome)))
        row = name, number, text, _checksum(text, name, number, self.fingerprint)
        self._change(f"INSERT OR REPLACE INTO runs VALUES ({MEMBER}, ?, ?, ?)", *row)
        self._work += outcome.seconds
        self.write_due()

    def finish(self, answer: Named, fit: bytes = b"") -> None:
        """Store the answer of the member, which is then done, and its fit."""
        text = json.dumps(answer, allow_nan=False).encode()
        values = packed(text), packed(fit, text)
        statement = "UPDATE members SET answer = ?, fit = ?, checksum = ? WHERE name = ?"
        self._change(statement, *values, _checksum(*values, self._name), self._name)

    def _change(self, statement: str, *values: Any) -> None:
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
                for change in self.changes:
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
def runs_beside(path: Path) -> Iterator[StoredRuns]:
    """Keep the runs of a fit in a folder beside its file until they are removed.

    Raises
    ------
    OSError
        If the folder cannot be written, or another process writes to it.
    """
    folder = folder_beside(path)
    with locked(folder):
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
        raise ValueError(_damaged(folder))


def _checksum(*values: bytes | str | float | None) -> int:
    """Return the checksum of values of SQLite."""
    texts = (v if isinstance(v, bytes) else str(v).encode() for v in values)
    return zlib.crc32(b"\n".join(texts))


@contextmanager
def _database(folder: Path, *, create: bool = False) -> Iterator[sqlite3.Connection]:
    """Open the database of a study for one transaction; refuse that of another program."""
    path = folder / DATABASE
    try:
        with _opened(path, "rwc" if create else "rw") as connection, connection:
            tables = _tables(connection)
            if create and not tables:
                # A small member fills one and a half of the usual pages; the rest would be empty.
                connection.execute("PRAGMA page_size = 1024")
                connection.execute("BEGIN")
                for statement in TABLES:
                    connection.execute(statement)
            elif tables != TABLES[:2]:
                raise ValueError(
                    _damaged(folder)
                    if _is_ours(connection)
                    else f"{path} is not a study, or was made by another version of greybox: "
                    "update greybox, or begin another study."
                )
            yield connection
    except sqlite3.Error as error:
        if _is_damage(error):
            raise ValueError(_damaged(folder)) from error
        raise OSError(
            f"{path} cannot be written ({error}): free space or choose another folder."
        ) from error


@contextmanager
def _opened(path: Path, mode: str = "rw") -> Iterator[sqlite3.Connection]:
    with closing(
        sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True)
    ) as connection:
        # A database from a stranger could call functions from its schema.
        connection.execute("PRAGMA trusted_schema = OFF")
        # Damaged letters are found by the checksum of their text, not by SQLite.
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")
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


def _damaged(folder: Path) -> str:
    return (
        f"{folder / DATABASE} is damaged or not a study: restore it, or run the batch again, which "
        "repeats what cannot be read."
    )


# --- damage


def mend(folder: Path) -> list[str]:
    """Remove what is damaged in a study that is locked, and return it as texts.

    A database that SQLite finds damaged is renamed. In others, runs and answers with wrong
    checksums are deleted.
    """
    if not is_study(folder):
        return []
    damage: list[str] = []
    path = folder / DATABASE
    if not _is_sound(path):
        damaged = path.with_suffix(".damaged")
        path.replace(damaged)
        # SQLite would apply the journal of the damaged database to the new one.
        path.with_name(f"{DATABASE}-journal").unlink(missing_ok=True)
        return [f"the database was damaged and is kept as {damaged.name}"]

    with _database(folder) as database:
        database.create_function("crc32", -1, _checksum)
        for what, (rows, cure) in DAMAGES.items():
            counts = database.execute(f"SELECT name, COUNT(*) FROM {rows} GROUP BY name")
            damage += [f"{name}: removed {counted(count, what)}" for name, count in counts]
            database.execute(cure)
    return [*map(printable, damage)]


def _is_sound(path: Path) -> bool:
    """Return whether SQLite can read all of a database, and all tables of a study are there."""
    try:
        with _opened(path) as database:
            whole = database.execute("PRAGMA integrity_check(1)").fetchone() == ("ok",)
            # Others belong to another program, or to a later version: they are refused, not mended.
            return whole and (not _is_ours(database) or _tables(database) == TABLES[:2])
    except sqlite3.Error as error:
        return not _is_damage(error)
