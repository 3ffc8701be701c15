"""The members of a study on disk, with their answers and fits.

`greybox.workflows.study.database` describes ``study.sqlite``, which contains them. The process that
writes to it locks the file ``lock`` in the same folder.
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

# Fields of an answer that distinguish the members of a study.
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
        Its key in the database.
    name : str
    answer : mapping
        The numbers of the fit, as ``greybox fit --json`` prints them; empty without an answer.
    stored_runs : int
        Number of runs on disk.
    models : sequence
        The user's own models, as in `greybox.load`.
    """

    folder: Path
    number: int
    name: str
    answer: Mapping[str, Any]
    stored_runs: int
    models: Sequence[Any] = ()

    @property
    def error(self) -> str:
        """The reason why the member failed; empty if it did not."""
        return str(self.answer.get("error", ""))

    @property
    def reason(self) -> str:
        """The reason why there is no fit, with the cure; empty if there is one."""
        if self.status == "unfinished":
            return "not fitted yet: the same batch continues"
        return self.error

    @property
    def factors(self) -> Mapping[str, str]:
        """Status, model, data and the like as texts, by which members are selected and grouped."""
        texts = {"status": str(self.status)}
        for name in FACTORS:
            value = self.answer.get(name)
            if isinstance(value, dict):
                value = ", ".join(f"{key} = {number:g}" for key, number in value.items())
                # A structure in which all parameters are free is a value of its own.
                if name == "fixed" and not value:
                    value = "nothing fixed"
            elif isinstance(value, list):
                value = ", ".join(value)
            if value not in (None, ""):
                texts[name] = str(value)
        return texts

    @property
    def status(self) -> Status:
        """Either "done" with a usable answer, "failed" with an error, or "unfinished"."""
        if not self.answer:
            return "unfinished"
        return "failed" if self.error else "done"

    @property
    def runs(self) -> int:
        """Number of runs of the answer, or of those on disk if it is not done."""
        return int(self.answer["starts"]) if self.status == "done" else self.stored_runs

    @property
    def fit(self) -> Fit | None:
        """The whole fit, which is read from the study; None if there is none, see `reason`."""
        if self.status != "done":
            return None
        from greybox.assessment.storage import from_bytes  # noqa: PLC0415  (slow import)

        query = "SELECT checksum, answer, fit, name, mark FROM members WHERE id = ?"
        with reading(self.folder) as database:
            row = database.execute(query, (self.number,)).fetchone()
        if row is None:
            raise DamagedStudyError(self.folder)
        require_undamaged(self.folder, *row)
        _, answer, packed_fit, *_ = row
        place = f"the fit of {self.name!r} in {self.folder / DATABASE}"
        try:
            # The text of the answer is the dictionary for the compression of the fit.
            text = unpacked(packed_fit, unpacked(answer))
        except ValueError as error:
            raise ValueError(f"{place} is damaged ({error}).") from None
        fit = from_bytes(text, self.models, place, stored=len(packed_fit))
        # Tables show the answer and figures the fit: they must belong together.
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
    """Return the member of a row of the database.

    Raises ValueError if the row is damaged: a stranger may have stored values of any type.
    """
    number, name, answer, fit, checksum, marked, count = row
    has_answer = answer is not None
    if not isinstance(name, str) or len(name) > LONGEST:
        raise DamagedStudyError(folder)
    if has_answer and not (isinstance(answer, bytes) and isinstance(fit, bytes)):
        raise DamagedStudyError(folder)
    shown = printable(name)
    stored: Mapping[str, Any] = {}
    if has_answer:
        require_undamaged(folder, checksum, answer, fit, name, marked)
        stored = _StoredAnswer(answer, f"the answer of {shown!r} in {folder / DATABASE}")
    return StudyMember(folder, number, shown, stored, count)


class _StoredAnswer(Mapping[str, Any]):
    """An answer that is unpacked whenever it is read.

    Ten thousand unpacked answers would take 300 MB.
    """

    def __init__(self, answer: bytes, place: str) -> None:
        self._packed = answer
        self._place = place
        self._is_checked = False

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def _values(self) -> dict[str, Any]:
        """The values by name, checked at the first time.

        Checking takes five times as long as unpacking, and tables read an answer again and again.
        """
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
                # At level 0 nothing is compressed: `unpacked` refuses data that expand too much.
                self._packed = zlib.compress(json.dumps(checked).encode(), 0)
            self._is_checked = True
        return _unpacked_values(self._packed)


# Cached, because a table reads several numbers of a member, and then those of the next.
@lru_cache(16)
def _unpacked_values(answer: bytes) -> dict[str, Any]:
    """Return the values of a packed answer."""
    return dict(json.loads(unpacked(answer)))


def add_members(folder: Path, names: Sequence[str]) -> dict[str, StudyMember]:
    """Add members with these names, unless the study has them; return all members by name."""
    with writing(folder, create=True) as database:
        rows = [(name,) for name in names]
        database.executemany("INSERT OR IGNORE INTO members (name) VALUES (?)", rows)
    return {member.name: member for member in read_members(folder)}
