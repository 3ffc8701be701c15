"""The runs of a member of a study, stored as they are made.

A single fit with ``--out`` and a bootstrap keep their runs in a folder, too, as those of one
member. A commit takes some milliseconds of the disk: the results of small members are written
together.
"""

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from greybox.assessment.stored_values import read, write
from greybox.data.files.arrays import Array
from greybox.data.files.bounded_json import parsed
from greybox.data.files.packed import packed
from greybox.engine.solve.interruption import Response, responding
from greybox.engine.solve.run_storage import RunStorage, RunStorageError
from greybox.engine.solve.runs import IMPROVED, POLISHED, SCREENED, Outcome
from greybox.workflows.study.database import (
    DATABASE,
    MARK_ANSWERS,
    RUN,
    DamagedStudyError,
    is_study,
    reading,
    require_undamaged,
    writing,
)
from greybox.workflows.study.members import read_members
from greybox.workflows.study.study_lock import LOCK, locked

# What is stored with the mark of this user.
STORE_RUN = (
    f"INSERT OR REPLACE INTO runs SELECT id, number, run, crc32({RUN}, mark), mark FROM "
    f"(SELECT *, mark({RUN}) AS mark FROM (SELECT id, name, fingerprint, "
    ":number AS number, :run AS run FROM members WHERE name = :name))"
)
STORE_ANSWER = "UPDATE members SET answer = :answer, fit = :fit WHERE name = :name"

# Largest amount of work, and largest age, of runs that are not on disk yet, s.
UNWRITTEN = 2.0


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
        self.changes: list[tuple[str, dict[str, Any]]] = []
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
            with reading(self._folder) as database:
                rows = database.execute(query, (self._name,)).fetchall()
            runs = {}
            for number, text, checksum, marked, key in rows:
                require_undamaged(self._folder, checksum, text, self._name, number, key, marked)
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

    def finish(self, answer: Mapping[str, Any], fit: bytes = b"") -> None:
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
            with responding(Response.FINISH), writing(self._folder, create=True) as database:
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
