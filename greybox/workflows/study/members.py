"""The members of a study on disk, with their answers and fits.

`greybox.workflows.study.database` describes the folder, in which ``study.sqlite`` has what is
stored, and ``lock`` is locked by the process that writes.
"""

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from greybox.assessment.result import Fit
from greybox.data.files.bounded_json import parsed
from greybox.data.files.control_characters import printable
from greybox.data.files.frozen_values import frozen
from greybox.data.files.packed import unpacked
from greybox.data.files.printed import one_line
from greybox.data.files.public import public
from greybox.data.files.wording import counted
from greybox.workflows.study.answer import LONGEST, checked_answer
from greybox.workflows.study.database import (
    DATABASE,
    DamagedStudyError,
    is_study,
    reading,
    require_tree,
    require_undamaged,
    writing,
)

Status = Literal["done", "failed", "unfinished"]

# Fields of an answer that tell members of a study apart.
FACTORS = ("model", "data", "criterion", "delay", "seed", "fixed", "at")


@public
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
    answer: Mapping[str, Any]
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
    def factors(self) -> Mapping[str, str]:
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
        from greybox.assessment.storage import from_bytes  # noqa: PLC0415  (slow import)

        query = "SELECT checksum, answer, fit, name, mark FROM members WHERE id = ?"
        with reading(self.folder) as database:
            row = database.execute(query, (self.number,)).fetchone()
        if row is None:
            raise DamagedStudyError(self.folder)
        require_undamaged(self.folder, *row)
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
    with reading(folder) as database:
        require_tree(folder, database)
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
    stored: Mapping[str, Any] = {}
    if has_answer:
        require_undamaged(folder, checksum, answer, fit, name, marked)
        stored = _StoredAnswer(answer, f"the answer of {shown!r} in {folder / DATABASE}")
    return StudyMember(folder, number, shown, stored, count)


class _StoredAnswer(Mapping[str, Any]):
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
    def _values(self) -> dict[str, Any]:
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
def _unpacked_values(answer: bytes) -> dict[str, Any]:
    return dict(json.loads(unpacked(answer)))


def add_members(folder: Path, names: Sequence[str]) -> dict[str, StudyMember]:
    """Add the names that a study does not have, and return its members by name."""
    with writing(folder, create=True) as database:
        rows = [(name,) for name in names]
        database.executemany("INSERT OR IGNORE INTO members (name) VALUES (?)", rows)
    return {member.name: member for member in read_members(folder)}
