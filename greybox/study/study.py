"""The results of a study so far: its members, each with its answer or its failure.

Begin with `read_study`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from greybox.files.text_table import counted, number, one_line, printable, text_table, with_error
from greybox.study.store import Status, StudyMember, read_members


@dataclass(frozen=True, eq=False)
class Study:
    """All members of a study, in their order; printed, it is a table that compares them."""

    folder: Path
    members: tuple[StudyMember, ...]

    def __getitem__(self, name: str) -> StudyMember:
        for member in self.members:
            if member.name == name:
                return member
        raise KeyError(
            f"the study has no member {name!r}; it has {', '.join(m.name for m in self.members)}."
        )

    def count(self, status: Status) -> int:
        """Return the number of members with this status."""
        return sum(member.status == status for member in self.members)

    def __repr__(self) -> str:
        return one_line(self, str(self.folder), self._state())

    def _state(self) -> str:
        statuses: tuple[Status, ...] = ("done", "failed", "unfinished")
        counts = [f"{self.count(status)} {status}" for status in statuses if self.count(status)]
        return f"{counted(len(self.members), 'member')}: {', '.join(counts) or 'none'}"

    def __str__(self) -> str:
        blocks = [f"Study {printable(str(self.folder))}, {self._state()}", _overview(self.members)]
        groups: dict[tuple[str, ...], list[StudyMember]] = {}
        for member in self.members:
            if member.status == "done":
                groups.setdefault(tuple(member.answer["standard_error"]), []).append(member)
        blocks += [_estimates(names, members) for names, members in groups.items()]
        failed = [
            f"{member.name}: {member.error}" for member in self.members if member.status == "failed"
        ]
        if failed:
            blocks.append("\n".join(["Failed:", *(f"  {printable(text)}" for text in failed)]))
        return "\n\n".join(blocks)


def read_study(folder: str | Path) -> Study:
    """Read a study, also while it runs.

    Raises
    ------
    FileNotFoundError
        If there is no study in the folder.
    ValueError
        If the study is damaged.
    """
    members = tuple(read_members(Path(folder)))
    for member in members:
        _require_readable(member)
    return Study(Path(folder), members)


def _require_readable(member: StudyMember) -> None:
    # Do now what printing will do: a damaged answer must be refused when it is read.
    try:
        _row(member)
        if member.status == "done":
            _cells(member.answer)
            _require_labels(member.answer)
    except (LookupError, TypeError, ValueError, AttributeError):
        raise ValueError(
            f"the answer of {member.name!r} in {member.folder} is damaged: restore the folder, or "
            "begin another study."
        ) from None


def _require_labels(answer: Mapping[str, Any]) -> None:
    """Raise TypeError if a label for a report is not a text."""
    # The database may come from a stranger, and a page joins these texts with others.
    texts = [answer["criterion"], answer["rule"], answer["checksum"], answer["verdict"]["grade"]]
    if not all(isinstance(text, str) for text in (*texts, *answer["model"], *answer["data"])):
        raise TypeError


def _overview(members: tuple[StudyMember, ...]) -> str:
    header = [
        "member",
        "status",
        "criterion",
        "delay",
        "runs",
        "converged",
        "agreeing",
        "minima",
        "cost",
        "warnings",
    ]
    return text_table(header, [_row(member) for member in members], left=(0, 1, 2, 3))


def _row(member: StudyMember) -> list[str]:
    if member.status != "done":
        return [member.name, member.status, "", "", str(member.runs), *[""] * 5]
    answer = member.answer
    counts = [str(int(answer[name])) for name in ("starts", "converged", "agreeing", "minima")]
    cost = "-" if answer["cost"] is None else number(answer["cost"], 6)
    texts = [str(answer[name]) for name in ("criterion", "delay")]
    return [member.name, member.status, *texts, *counts, cost, str(len(answer["warnings"]))]


def _estimates(names: tuple[str, ...], members: list[StudyMember]) -> str:
    return text_table(
        ["member", *names], [[member.name, *_cells(member.answer)] for member in members]
    )


def _cells(answer: Mapping[str, Any]) -> list[str]:
    values = {**answer["derived"], **answer["estimate"]}
    cells = []
    for name, error in answer["standard_error"].items():
        value = values[name]
        if value is None or not error:  # unknown, or a constant
            cells.append("-" if value is None else number(value))
        else:
            cells.append(" ± ".join(with_error(value, error)))
    return cells
