"""The results of a study so far: its members, each with its answer or its failure.

Begin with `read_study`.
"""

import csv
import io
import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from greybox.assessment.validation.comparison import Comparison
from greybox.data.files.escapes import csv_cell, in_sentences, latex_text, sentence, terminal_text
from greybox.data.files.frozen_values import frozen
from greybox.data.files.grouping import grouped, unique
from greybox.data.files.numbers_in_text import number, with_error
from greybox.data.files.optional_package import required
from greybox.data.files.printed import Printed, one_line
from greybox.data.files.public import public
from greybox.data.files.text_table import text_table
from greybox.data.files.wording import counted, some
from greybox.data.pandas_frames import Frame
from greybox.modeling.model import require_known
from greybox.workflows.study.answer import Misfit
from greybox.workflows.study.latex import latex_number, latex_symbol, latex_table
from greybox.workflows.study.members import FACTORS, Status, StudyMember, read_members
from greybox.workflows.study.ranking import Result, ranking

# Columns of the table of failures.
FAILURES = ("failed", "members", "reason and cure")
# Fits of a structure that agree in these fields can be compared by their costs.
COMPARABLE = ("data", "checksum", "criterion", "bounds")
# Columns of the table of members.
OVERVIEW = (
    "member",
    "explains",
    "status",
    "criterion",
    "delay",
    "starts",
    "converged",
    "agreeing",
    "minima",
    "cost",
    "warnings",
)
# Last members from which the time that the others take is estimated.
RECENT = 20


@public
@frozen
class Study(Printed):
    """Members of a study, in their order; printed, it is a table that compares them."""

    folder: Path
    members: tuple[StudyMember, ...]

    def __getitem__(self, name: str) -> StudyMember:
        for member in self.members:
            if member.name == name:
                return member
        names = ", ".join(member.name for member in self.members)
        raise KeyError(sentence(f"the study has no member {name!r}; it has {names}."))

    def count(self, status: Status) -> int:
        """Return the number of members with this status."""
        return sum(member.status == status for member in self.members)

    @property
    def done(self) -> tuple[StudyMember, ...]:
        """The members with an estimate."""
        return tuple(member for member in self.members if member.status == "done")

    def select(self, **factors: Any) -> "Study":
        """Return the members with these values of factors: ``select(model=["A", "B"], seed=0)``.

        The factors are ``status, model, data, criterion, delay, seed, fixed`` and those that a grid
        varied; `StudyMember.factors` has them.

        Raises
        ------
        ValueError
            For a factor or a value that no member has. A status that no member has is no error.
        """
        members = self.members
        for name, values in factors.items():
            chosen = set(map(str, values if isinstance(values, list | tuple) else [values]))
            present = self._values(name)
            if present and name != "status":
                require_known(chosen, present, f"member whose {name} is", "the study")
            members = tuple(m for m in members if m.factors.get(name) in chosen)
        return replace(self, members=members)

    def groups(self, by: str) -> dict[str, "Study"]:
        """Return the members by the value of a factor; those without one are left out."""
        return {value: self.select(**{by: value}) for value in self._values(by)}

    def _values(self, name: str) -> tuple[str, ...]:
        """Return the different values of a factor; ValueError if no member has it."""
        if self.members:
            names = (key for member in self.members for key in member.factors)
            require_known([name], names, "factor", "the study")
        return unique(m.factors[name] for m in self.members if name in m.factors)

    @property
    def table(self) -> list[dict[str, Any]]:
        """A row for every member and quantity as plain values; `to_pandas` has the columns."""
        return [row for member in self.members for row in _rows(member)]

    def to_pandas(self) -> Frame:
        """Return a row for every member and quantity as a pandas data frame.

        In this long form, members of different structures share a table. A column for each
        parameter is ``pivot(index="member", columns="parameter", values="value")``. The
        columns are ``member``, the factors, ``grade, cost, converged, agreeing, minima, held_out``
        (the error of held-out predictions in percent), ``explains`` (whether the model explains
        the data; None if it does only where errors drift, are correlated, or are large),
        ``starts, warnings, reason``, then
        ``parameter, value, standard_error``, the ends ``low, high`` of the 95 % interval, and
        ``unit``. A member without an estimate has one row without a parameter.

        Raises
        ------
        ModuleNotFoundError
            Without pandas, ``pip install 'greybox-id[pandas]'``.
        """
        return required("pandas", "pandas", "to_pandas()").DataFrame(self.table)

    def to_csv(self) -> str:
        """Return the rows of `to_pandas` as comma-separated values."""
        text = io.StringIO()
        rows = self.table
        names = unique(name for row in rows for name in row)
        writer = csv.writer(text)
        writer.writerow(map(csv_cell, names))
        writer.writerows(map(csv_cell, map(row.get, names)) for row in rows)
        return text.getvalue()

    def to_latex(self) -> str:
        r"""Return the estimates with standard errors as LaTeX, for ``\usepackage{booktabs}``.

        A table for every group of members that estimate the same quantities. Its rows are named by
        the factors in which they differ.
        """
        return "\n\n".join(map(_latex, _alike(self.done)))

    @property
    def structures(self) -> str:
        """The factor of structures: ``model``, or ``fixed`` where all members have one model."""
        models = {member.factors.get("model") for member in self.members}
        return "model" if len(models) > 1 else "fixed"

    def ranking(self, *by: str) -> Comparison:
        """Compare structures, or another factor, over the data sets; ``gb.compare(study)``.

        For every data set the table has BIC less the least: of each structure that of its best
        member. Criteria that are not likelihoods are put on the scale of one, as in
        `greybox.compare`; over records, structures with and without a delay are compared by the
        samples that all of them fit. The statements count the data sets in which each structure is
        the best; the verdict adds up BIC over the data sets that all structures have in common.
        Data that the members held out have the last word: they support the smallest structure whose
        errors, by their geometric mean over the data sets, are within 5 % of the least.

        Parameters
        ----------
        *by : str
            The factors whose values are compared, see `select`; by default `structures`. The values
            of several, such as ``ranking("model", "fixed")``, are compared in all combinations.
        """
        by = by or (self.structures,)
        for factor in by:
            self._values(factor)
        structures = self._structure_names(by)
        # Among members that differ in their seeds or delays, only the best counts: reading a fit
        # takes longer than comparing it.
        best: dict[tuple[str, ...], StudyMember] = {}
        for structure, member in zip(structures, self.done, strict=True):
            key = (structure, *(str(member.answer.get(name)) for name in COMPARABLE))
            if structure and _cost(member) <= _cost(best.get(key, member)):
                best[key] = member
        named = [(structure, member) for (structure, *_), member in best.items()]

        def fits() -> Iterator[Result]:
            # A fit is read when its turn comes: those of a large study do not fit into memory.
            for of_data in grouped(named, lambda item: item[1].factors["data"]):
                for structure, member in of_data:
                    fit = member.fit
                    if fit:
                        data = member.factors["data"]
                        yield Result(structure, data, fit, member.answer.get("held_out"))

        return ranking(fits())

    def _structure_names(self, by: Sequence[str]) -> list[str]:
        """Return a name for each of the `done` members, from the factors in which they differ."""
        columns = [_differences([m.factors.get(factor, "") for m in self.done]) for factor in by]
        names = []
        for texts in zip(*columns, strict=True):
            names.append(": ".join(text for text in texts if text))
        return names

    @property
    def failures(self) -> str:
        """The members without an estimate by reason, with the cure; empty if none failed."""
        return text_table(FAILURES, self.failed, (1, 2)) if self.failed else ""

    @property
    def failed(self) -> list[list[str]]:
        """The rows of `failures`: how many members, their names, the reason and cure."""
        failed = [member for member in self.members if member.status == "failed"]
        rows = []
        # Reasons that differ only in their numbers are one row, with those of the first member.
        for members in grouped(failed, lambda member: re.sub(r"[-\d.]+", "", member.reason)):
            names = some([member.name for member in members])
            rows.append([str(len(members)), names, members[0].reason])
        return rows

    def __repr__(self) -> str:
        return one_line(self, str(self.folder), self.state)

    @property
    def state(self) -> str:
        """How many members are done, failed and unfinished."""
        statuses = ("done", "failed", "unfinished")
        counts = [f"{self.count(status)} {status}" for status in statuses if self.count(status)]
        return f"{counted(len(self.members), 'member')}: {', '.join(counts) or 'none'}"

    def __str__(self) -> str:
        title = f"Study {self.folder}, {self.state}"
        blocks = [title, _overview(self.members), *map(_estimates, _alike(self.done))]
        return terminal_text("\n\n".join(filter(None, [*blocks, self.failures])))


@public
@in_sentences
def read_study(folder: str | Path, models: Sequence[Any] = ()) -> Study:
    """Read a study, also while it runs; `models` of one's own are given as in `greybox.load`.

    Raises
    ------
    FileNotFoundError
        If there is no study in the folder.
    ValueError
        If the study is damaged.
    """
    members = tuple(replace(member, models=models) for member in read_members(Path(folder)))
    for member in members:
        len(member.answer)  # a damaged answer must be refused when it is read
    return Study(Path(folder), members)


def _cost(member: StudyMember) -> float:
    """Return the cost of a member, infinite if it is not known."""
    cost = member.answer["cost"]
    return math.inf if cost is None else cost


def progress(study: Study) -> str:
    """Return how far a study is: the counts, the time left, and the failures so far."""
    times = [float(member.answer.get("finished", 0.0)) for member in study.members]
    ends = sorted(end for end in times if end)[-RECENT:]
    unfinished = study.count("unfinished")
    lines = [study.state]
    if unfinished and len(ends) > 2:
        # The last members show how long the others take; the longest interval may be a pause.
        seconds = float(np.mean(np.sort(np.diff(ends))[:-1]))
        lines.append(
            f"about {number(unfinished * seconds / 60, 2)} min left, at {number(seconds, 2)} s a "
            f"member; the last one ended {number(time.time() - ends[-1], 2)} s ago."
        )
    return "\n\n".join(filter(None, [*lines, study.failures]))


def _overview(members: Sequence[StudyMember]) -> str:
    """Return the table of members."""
    rows = []
    for member in members:
        row = next(_rows(member))
        row["cost"] = number(row["cost"], 6) if member.status == "done" else None
        rows.append(["" if row[name] is None else str(row[name]) for name in OVERVIEW])
    return text_table(OVERVIEW, rows, left=(0, 1, 2, 3, 4))


def _rows(member: StudyMember) -> Iterator[dict[str, Any]]:
    """Yield the rows of a member in the long table: one for each quantity, at least one."""
    answer = member.answer
    is_done = member.status == "done"
    numbers = ("cost", "converged", "agreeing", "minima", "held_out")
    common = {
        "member": member.name,
        **dict.fromkeys(FACTORS),
        **member.factors,
        "grade": answer["verdict"]["grade"] if is_done else "",
        **{name: answer.get(name) for name in numbers},
        "explains": _explains(answer.get("misfit") or {}),
        "starts": member.runs,
        "warnings": len(answer["warnings"]) if is_done else None,
        "reason": member.reason,
    }

    values = {**answer.get("derived", {}), **answer.get("estimate", {})}
    intervals = answer.get("interval", {})
    units = answer.get("unit", {})
    # A member without an estimate has one row without a parameter.
    errors = answer["standard_error"] if is_done else {"": None}
    for name, error in errors.items():
        low, high = intervals.get(name, (None, None))
        row = {"parameter": name, "value": values.get(name), "standard_error": error}
        yield {**common, **row, "low": low, "high": high, "unit": units.get(name, "")}


def _explains(misfit: Misfit) -> bool | None:
    """Return whether a model explains its data; None if it does on a condition, or nobody knows."""
    return None if misfit.get("is_conditional") else misfit.get("explains")


def _alike(members: Sequence[StudyMember]) -> list[list[StudyMember]]:
    """Return the members in groups that have the same quantities."""
    return grouped(members, lambda member: tuple(member.answer["standard_error"]))


def _estimates(members: Sequence[StudyMember]) -> str:
    """Return the table of estimates of members that have the same quantities."""
    header = ["member", *members[0].answer["standard_error"]]
    return text_table(header, [[m.name, *_cells(m, shown)] for m in members])


def _latex(members: Sequence[StudyMember]) -> str:
    """Return a table of members that have the same quantities."""
    answer = members[0].answer
    models = unique(member.factors.get("model", "") for member in members)
    units = answer.get("unit", {})
    labels = names_by_difference(members)
    symbols = [latex_symbol(name, units.get(name, "")) for name in answer["standard_error"]]
    rows = [
        [*map(latex_text, label.values()), *_cells(member, latex_number)]
        for label, member in zip(labels, members, strict=True)
    ]
    table = latex_table([*map(latex_text, labels[0]), *symbols], rows, len(labels[0]))
    return f"% {latex_text('; '.join(models))}\n{table}"


def names_by_difference(members: Sequence[StudyMember]) -> list[dict[str, str]]:
    """Return the factors in which members differ; their names if the factors are not unique."""
    factors = [member.factors for member in members]
    names = unique(name for values in factors for name in values)
    varied = [name for name in names if len({values.get(name) for values in factors}) > 1]
    labels = [{name: values.get(name, "") for name in varied} for values in factors]
    if len({*map(str, labels)}) == len(members) > 1:
        return labels
    return [{"member": member.name} for member in members]


def _differences(texts: Sequence[str]) -> list[str]:
    """Return texts without the values, such as ``a = 1``, that all of them have."""
    values_of_texts = [text.split(", ") for text in texts]
    common: set[str] = set()
    if len({*texts}) > 1:
        common = set.intersection(*map(set, values_of_texts))
    differences = []
    for text, values in zip(texts, values_of_texts, strict=True):
        distinct = [value for value in values if value not in common or " = " not in value]
        if distinct or not text:
            differences.append(", ".join(distinct))
        else:
            differences.append("nothing else")
    return differences


def _cells(member: StudyMember, form: Callable[[float | None, float | None], str]) -> Iterator[str]:
    """Yield the estimates with their errors as text; a constant has no error."""
    answer = member.answer
    values = {**answer["derived"], **answer["estimate"]}
    for name, error in answer["standard_error"].items():
        yield form(values[name], error)


def shown(value: float | None, error: float | None) -> str:
    """Return a value with its standard error, if it has one."""
    if value is None:
        return "-"
    return " ± ".join(with_error(value, error)) if error else number(value)
