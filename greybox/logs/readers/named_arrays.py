"""Makes records of the groups in files of named arrays: HDF5, MATLAB, PX4."""

import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from greybox.data.record import Recording
from greybox.files.arrays import Array
from greybox.files.subprocess_reader import read_in_subprocess
from greybox.logs.named_columns import renamed
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.messages import on_one_clock, records
from greybox.logs.readers.table_columns import table


class Variable(NamedTuple):
    """One numeric array: the group (or struct) that it is in, its own name, its unit."""

    group: str
    name: str
    unit: str
    values: Array


class Contents(NamedTuple):
    """The contents of a file: its arrays, its defects, and facts about the vehicle."""

    variables: list[Variable]
    findings: list[str]
    about: dict[str, Any]


def read_contents(kind: str, path: Path, *wanted: str) -> Contents:
    """Read all numeric vectors and matrices of a file.

    Parameters
    ----------
    kind : str
        ``"hdf5"``, ``"matlab"`` or ``"ulog"``.
    path : Path
    *wanted : str
        Topics of a PX4 log; all by default.

    Raises
    ------
    ValueError
        If the file cannot be read, or not within the limits of time and memory.
    """
    head, arrays = read_in_subprocess(kind, path, *wanted)
    variables = []
    for item, values in zip(head["items"], arrays, strict=True):
        group, _, name = item["path"].rpartition("/")
        variables.append(Variable(group, name, item["unit"], values))
    return Contents(variables, head["findings"], head["about"])


def recording(
    path: Path,
    contents: Contents,
    messages: Collection[str] | None,
    parameters: Mapping[str, float] | None = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Make a record of every group that has a time; the root is named after the file.

    With the `parameters` of a vehicle, the groups are messages of its flight controller. The
    `stated` columns and the `rate` are those of the only group, see `greybox.logs.read`.
    """
    with open(path, "rb") as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    columns: dict[str, dict[str, Array]] = {}
    units: dict[str, dict[str, str]] = {}
    for variable in contents.variables:
        name = variable.group or path.stem
        columns.setdefault(name, {})[variable.name] = variable.values
        units.setdefault(name, {})[variable.name] = variable.unit

    by_name = {}
    findings = list(contents.findings)
    findings += [f"there is no group {name}." for name in messages or () if name not in columns]
    # Groups without a time, such as settings, are findings, not errors.
    groups = {n: group for n, group in columns.items() if messages is None or n in messages}
    if stated and len(groups) != 1:
        raise ValueError(
            f"{path.name} has {len(groups)} groups, but `columns` names the columns of one table."
        )

    # Every group has a clock of its own.
    for name, group in groups.items():
        labels = units[name]
        if stated:
            group, labels = renamed(group, labels, stated, path.name)  # noqa: PLW2901
        part, problems = table(name, group, labels, rate)
        clocked, restarts = on_one_clock([part] if part else [])
        clocked = clocked if parameters is None else with_holds(clocked, parameters)
        records_of_group, dropped = records(clocked, path.name, checksum)
        by_name.update(records_of_group)
        findings += [*problems, *restarts, *dropped]
    if not by_name:
        raise ValueError(
            f"{path} has no group with a vector 'time' (or t, timestamp) and vectors of its "
            f"length; it holds {', '.join(columns) or 'no vectors at all'}."
        )

    return Recording(by_name, path.name, checksum, {}, tuple(findings))
