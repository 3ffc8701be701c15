"""A study on disk: a folder in which one process writes at a time, and all may read.

``study.sqlite``  an SQLite database: members and their answers, and every run as it is made.
``001-NAME.h5``   the fit of a member, as `greybox.save` writes it.
``lock``          locked by the process that writes.

A single fit with ``--out`` and a bootstrap keep their runs in such a folder, too, as those of one
member. SQLite commits are atomic: `kill -9` leaves all runs up to the last commit. Runs and answers
are JSON texts with a checksum, so nothing in a folder from a stranger is executed.
"""

import json
import re
import sqlite3
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from greybox.estimate.result import Fit
from greybox.files.arrays import Array
from greybox.files.text_table import counted, one_line, printable
from greybox.solve.interruption import Response, responding
from greybox.solve.kept_runs import KeptRuns, KeptRunsError
from greybox.solve.runs import IMPROVED, POLISHED, SCREENED, Outcome

Status = Literal["done", "failed", "unfinished"]

# Fields of an answer that tell members of a study apart.
FACTORS = ("model", "data", "criterion", "delay", "seed", "fixed", "at")

DATABASE = "study.sqlite"
LOCK = "lock"
APPLICATION = 0x67_72_65_79  # "grey": SQLite files name the program that wrote them
LAYOUT = 1
TABLES = (
    "CREATE TABLE members (id INTEGER PRIMARY KEY, name TEXT UNIQUE, "
    "fingerprint TEXT DEFAULT '', answer TEXT, checksum INTEGER)",
    "CREATE TABLE runs (member INTEGER, number INTEGER, run TEXT, checksum INTEGER, "
    "PRIMARY KEY (member, number))",
    f"PRAGMA application_id = {APPLICATION}",
    f"PRAGMA user_version = {LAYOUT}",
)

MEMBER = "(SELECT id FROM members WHERE name = ?)"

# Largest amount of work, and largest age, of runs that are not on disk yet, s.
UNWRITTEN = 2.0
# Seconds to wait for the lock: a worker that was starting when its parent was killed holds the
# parent's files until its own program runs.
PATIENCE = 2.0


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create the folder if necessary, and keep other processes from writing to it.

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
        yield
    finally:
        lock.release()


@dataclass(frozen=True, eq=False)
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
    """

    folder: Path
    number: int
    name: str
    answer: Mapping[str, Any]
    stored_runs: int

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
    def factors(self) -> dict[str, str]:
        """What members are selected and grouped by: status, model, data and the like, as texts."""
        texts = {"status": str(self.status)}
        for name in FACTORS:
            value = self.answer.get(name)
            if isinstance(value, dict):
                value = ", ".join(f"{key} = {number:g}" for key, number in value.items())
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
    def file(self) -> Path:
        """The file of its fit, once it is done."""
        # The number keeps files apart whose names differ only in characters that are left out.
        short = re.sub(r"[^A-Za-z0-9_.-]+", "-", self.name).strip("-.")[:60]
        return self.folder / f"{self.number:03d}-{short}.h5"

    @property
    def fit(self) -> Fit | None:
        """The whole fit, read from its file; None if there is none, and `reason` says why."""
        if self.status != "done":
            return None
        from greybox.estimate.storage import load  # noqa: PLC0415  (slow import)

        return load(self.file)

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
        raise FileNotFoundError(f"{folder} is not a study: it has no file {DATABASE}.")
    with _database(folder) as database:
        counts = dict(
            database.execute("SELECT member, COUNT(*) FROM runs GROUP BY member").fetchall()
        )
        rows = database.execute("SELECT id, name, answer, checksum FROM members ORDER BY id")
        return [
            StudyMember(
                folder,
                int(number),
                printable(str(name)),
                {} if answer is None else _decoded(folder, answer, checksum),
                counts.get(number, 0),
            )
            for number, name, answer, checksum in rows
        ]


def add_members(folder: Path, names: Sequence[str]) -> dict[str, StudyMember]:
    """Add the names that a study does not have, and return its members by name."""
    with _database(folder, create=True) as database:
        rows = [(name,) for name in names]
        database.executemany("INSERT OR IGNORE INTO members (name) VALUES (?)", rows)
    return {member.name: member for member in read_members(folder)}


def write_answer(folder: Path, name: str, answer: Mapping[str, Any]) -> None:
    """Write the answer of a member, which is then done."""
    text = json.dumps(answer, allow_nan=False)
    with _database(folder) as database:
        database.execute(
            "UPDATE members SET answer = ?, checksum = ? WHERE name = ?",
            (text, zlib.crc32(text.encode()), name),
        )


class StoredRuns(KeptRuns):
    """The runs of one member of a study.

    Attributes
    ----------
    fingerprint : str
        Key of the problem and its solver, once the search has begun.
    trouble : str
        Why the last runs were not written; empty if they were.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._name = name
        self._unwritten: list[tuple[int, Array, Outcome]] = []
        self._written_at = time.monotonic()
        self.fingerprint = ""
        self.trouble = ""

    def known(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return the runs on disk by the number of their start.

        Raises
        ------
        KeptRunsError
            If they were made for another problem, or the database is damaged.
        """
        self.fingerprint = fingerprint
        if not is_study(self._folder):
            return {}
        try:
            with _database(self._folder) as database:
                query = "SELECT fingerprint FROM members WHERE name = ?"
                fingerprints = database.execute(query, (self._name,)).fetchall()
                query = f"SELECT number, run, checksum FROM runs WHERE member = {MEMBER}"
                rows = database.execute(query, (self._name,)).fetchall()
        except ValueError as error:
            raise KeptRunsError(str(error)) from error
        if rows and fingerprints != [(fingerprint,)]:
            raise KeptRunsError(
                f"the runs in {self._folder} belong to another problem, to other options, or to "
                "another version of greybox or CasADi: repeat what the study began with, or begin "
                "another study."
            )
        return _Runs(
            self._folder, {int(number): (text, checksum) for number, text, checksum in rows}
        )

    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Keep a run."""
        self._unwritten.append((number, start, outcome))
        self.look()

    def look(self) -> None:
        """Write the runs if they are older, or took longer, than `UNWRITTEN`."""
        # A commit takes some milliseconds. After every run of a response, which takes no longer,
        # the disk would cost as much time as the solver.
        age = time.monotonic() - self._written_at
        work = sum(outcome.seconds for _, _, outcome in self._unwritten)
        if max(age, work) >= UNWRITTEN:
            with suppress(OSError):  # a full disk: the next run tries again
                self.write()

    def write(self) -> None:
        """Write all runs that are not on disk yet.

        Raises
        ------
        OSError
            If they cannot be written; those on disk remain.
        """
        # The time of the attempt: a full disk is not tried again for every run.
        self._written_at = time.monotonic()
        if not self._unwritten:
            return
        # Serialize before the transaction, which locks the database.
        texts = [(number, _run_text(start, outcome)) for number, start, outcome in self._unwritten]
        rows = [(self._name, number, text, zlib.crc32(text.encode())) for number, text in texts]
        try:
            with _database(self._folder, create=True) as database:
                database.execute("INSERT OR IGNORE INTO members (name) VALUES (?)", (self._name,))
                database.execute(
                    "UPDATE members SET fingerprint = ? WHERE name = ?",
                    (self.fingerprint, self._name),
                )
                database.executemany(
                    f"INSERT OR REPLACE INTO runs VALUES ({MEMBER}, ?, ?, ?)", rows
                )
        except OSError as error:
            self.trouble = str(error)
            raise
        self.trouble = ""
        self._unwritten = []

    @property
    def count(self) -> int:
        """Number of runs on disk."""
        members = read_members(self._folder) if is_study(self._folder) else []
        return sum(member.stored_runs for member in members if member.name == self._name)

    def remove(self) -> None:
        """Remove all runs."""
        self._unwritten = []
        if is_study(self._folder):
            with _database(self._folder) as database:
                database.execute(f"DELETE FROM runs WHERE member = {MEMBER}", (self._name,))


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
            with responding(Response.FINISH), suppress(OSError):
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


@dataclass(frozen=True, eq=False)
class _Runs(Mapping[int, tuple[Array, Outcome]]):
    """Runs by number, decoded when they are used: as texts a hundred thousand take 50 MB."""

    folder: Path
    texts: Mapping[int, tuple[str, int]]

    def __getitem__(self, number: int) -> tuple[Array, Outcome]:
        try:
            return _stored_run(_decoded(self.folder, *self.texts[number]))
        except (ValueError, TypeError, AttributeError) as error:
            raise KeptRunsError(_damaged(self.folder)) from error

    def __iter__(self) -> Iterator[int]:
        return iter(self.texts)

    def __len__(self) -> int:
        return len(self.texts)


def _run_text(start: Array, outcome: Outcome) -> str:
    """Return a run as JSON, in which Python writes floats exactly."""
    fields = {name: getattr(outcome, name) for name in Outcome.__slots__}
    return json.dumps({"start": start, **fields}, default=lambda value: value.tolist())


def _stored_run(fields: dict[str, Any]) -> tuple[Array, Outcome]:
    start = np.array(fields.pop("start"), dtype=float)
    estimate = np.array(fields.pop("estimate"), dtype=float)
    status = printable(fields.pop("status"))
    signature, nodes = fields.pop("signature"), fields.pop("nodes")
    if start.ndim != 1 or estimate.ndim != 1 or fields["stage"] not in STAGES:
        raise ValueError

    return start, Outcome(
        estimate,
        status,
        signature=None if signature is None else np.array(signature, dtype=float),
        nodes=None if nodes is None else tuple(np.array(states, dtype=float) for states in nodes),
        **fields,
    )


STAGES = (SCREENED, IMPROVED, POLISHED)


def _decoded(folder: Path, text: str, checksum: int) -> dict[str, Any]:
    """Return the object in a stored text.

    Raises
    ------
    ValueError
        If it is damaged.
    """
    # The checksum finds damage by accident; what a stranger wrote is checked where it is used.
    try:
        values = json.loads(text) if zlib.crc32(text.encode()) == checksum else None
    except (TypeError, AttributeError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise ValueError(_damaged(folder))
    return values


@contextmanager
def _database(folder: Path, *, create: bool = False) -> Iterator[sqlite3.Connection]:
    """Open the database of a study for one transaction."""
    path = folder / DATABASE
    mode = "rwc" if create else "rw"
    try:
        with (
            closing(
                sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True)
            ) as connection,
            connection,
        ):
            # A database from a stranger could call functions from its schema.
            connection.execute("PRAGMA trusted_schema = OFF")
            _require_layout(connection, path, create=create)
            yield connection
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_ERROR:  # such as a table that does not exist
            raise ValueError(_damaged(folder)) from error
        raise OSError(
            f"{path} cannot be written ({error}): free space or choose another folder."
        ) from error
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise ValueError(_damaged(folder)) from error


def _require_layout(connection: sqlite3.Connection, path: Path, *, create: bool) -> None:
    """Make the tables of a new database; refuse another program's, or one of a later version."""
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    layout = connection.execute("PRAGMA user_version").fetchone()[0]
    if create and application == layout == 0:
        connection.execute("BEGIN")
        for statement in TABLES:
            connection.execute(statement)
        return
    if application != APPLICATION:
        raise ValueError(_damaged(path.parent))
    if layout > LAYOUT:
        raise ValueError(
            f"{path} has layout {layout}, and this version reads layout {LAYOUT}: update greybox."
        )


def _damaged(folder: Path) -> str:
    return f"{folder / DATABASE} is damaged or not a study: restore it, or delete it to begin anew."
