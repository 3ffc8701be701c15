"""Files of named arrays: HDF5 (.h5), MATLAB (.mat, up to version 7 and 7.3, which is HDF5).

The same records are made of the topics of PX4 logs and of tables of text.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values
from greybox.data.files.subprocess_reader import read_in_subprocess
from greybox.data.files.wording import some
from greybox.data.headings import split_names
from greybox.data.logs.named_columns import renamed
from greybox.data.logs.readers.controller_outputs import with_holds
from greybox.data.logs.readers.messages import MessageNames, checksum_of, on_one_clock, records
from greybox.data.logs.readers.sample_times import at_sample_times
from greybox.data.logs.readers.table_columns import columns_of, devices, table
from greybox.data.record import Record, Recording
from greybox.data.time_column import clock_names, table_clock

SIGNATURE = b"\x89HDF\r\n\x1a\n"

Group = tuple[dict[str, Any], dict[str, Any]]  # numeric arrays and their units
Groups = dict[str, Group]  # of groups or structs


def read(
    path: Path,
    messages: MessageNames = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
) -> Recording:
    """Read every group or struct that has a time into a record.

    The time is a vector ``time`` (or t, tout, timestamp, time_ms ...; see
    `greybox.data.time_column`); without it, ``Ts`` is the sampling interval, s. Vectors of the same
    length are signals. Matrices with one sample per row (as MATLAB shows them, in MATLAB's files)
    give one signal per column. A record has the name of its group (``flight/ATT``), at the root or
    in the workspace that of the file. Devices whose rows come in turn, with their numbers in a
    column I or instance, have a record each: ``IMU[0]``, ``IMU[1]``.

    Of MATLAB and Simulink, a "structure with time", the matrices of the block To File, whose first
    row is the time, and structs with the fields of an iddata object are read, too; and Mission
    Planner's matrices, which have labels beside them.

    Packed numbers of netCDF (``scale_factor``, ``add_offset``, ``_FillValue``) are unpacked.

    Units are attributes ``unit`` or ``units`` of HDF5's datasets, followed by the word held or
    sampled if it is known how the signal varies between its samples; those of MATLAB's files are
    unknown.

    Parameters
    ----------
    path : Path
    messages : collection of str, optional
        Groups to read; all by default.
    stated : mapping of str to str, optional
        Columns of the only group by new name, see `greybox.logs.read`.
    rate : float, Hz, optional
        The sampling rate where there is neither a time vector nor an interval ``Ts``.

    Returns
    -------
    Recording
        One finding names cells, texts, timetables and other objects, which are left out: save their
        numbers as vectors, or as fields of a struct.

    Raises
    ------
    ValueError
        If the file is damaged, or nothing in it has a time vector.
    OSError
        If the file cannot be opened.
    """
    with open(path, "rb") as file:
        # MATLAB 7.3 puts a text before the signature of HDF5.
        head = file.read(4096)
    is_hdf5 = SIGNATURE in head
    report, groups = read_contents("hdf5" if is_hdf5 else "matlab", path)
    # MATLAB 7.3 stores matrices transposed.
    turned = is_hdf5 and head.startswith(b"MATLAB")
    for columns, _ in groups.values():
        columns.update({name: _rows(values, turned) for name, values in columns.items()})
    groups = {name: split_names(*group) for name, group in groups.items()}
    findings = [*report["findings"]]
    if not (stated or rate):
        groups, turned_matrices = _time_in_first_row(groups)
        findings += turned_matrices

    return recording(path, groups, findings, messages, None, stated, rate)


def _time_in_first_row(groups: Groups) -> tuple[Groups, list[str]]:
    """Return the groups, with one more for each matrix of Simulink's block To File, and findings.

    Such a matrix has a sample per column, and in its first row the time, which may repeat. A group
    with a time of its own has none.
    """
    result = dict(groups)
    findings = []
    for group, (columns, units) in groups.items():
        matrices = {name: x for name, x in columns.items() if _starts_with_time(x)}
        if not matrices or table_clock(columns, units) or "Ts" in columns:
            continue
        others = {name: x for name, x in columns.items() if name not in matrices}
        result[group] = (others, units)
        for name, matrix in matrices.items():
            result[name] = ({"time": matrix[0], name: matrix[1:].T}, {"time": "s"})
            findings.append(
                f"{name}: its first row was taken as the time in s, as by Simulink's To File."
            )
    return {name: group for name, group in result.items() if group[0]}, findings


def _starts_with_time(values: Array) -> bool:
    """Return whether a matrix has more columns than rows, and a first row that never falls."""
    if values.ndim != 2 or not 2 <= len(values) < values.shape[1]:
        return False
    time = values[0]
    return bool(np.isfinite(time).all() and (np.diff(time) >= 0).all() and time[-1] > time[0])


def _rows(values: Array, turned: bool) -> Array:
    """Return an array with the samples in rows."""
    if values.ndim == 2 and 1 in values.shape:
        return values.ravel()
    return values.T if turned else values


def _split(group: Group, stated: Mapping[str, str]) -> Group:
    """Return a group with the columns of its matrices, but for those that are named as a whole."""
    columns, units = group
    wanted = {text.partition(":")[0] for text in stated.values()}
    parts = {}
    labels = {}
    for name, values in columns.items():
        split = {name: values} if name in wanted else columns_of(name, values)
        parts |= split
        labels |= dict.fromkeys(split, units.get(name, ""))
    return parts, labels


def read_contents(kind: str, path: Path, *wanted: str) -> tuple[dict[str, Any], Groups]:
    """Return the report on a file, and its numeric vectors and matrices; the root has its name.

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
    report = read_in_subprocess(kind, path, *wanted)
    groups: Groups = {}
    for item in report["items"]:
        group, _, name = item["path"].rpartition("/")
        columns, units = groups.setdefault(group or path.stem, ({}, {}))
        columns[name] = item["values"]
        units[name] = item["unit"]
    return report, groups


def recording(
    path: Path,
    groups: Groups,
    problems: Sequence[str],
    messages: MessageNames = None,
    parameters: Values | None = None,
    stated: Mapping[str, str] | None = None,
    rate: float | None = None,
    *,
    rows_allowed: bool = False,
) -> Recording:
    """Make a record of every group that has a time; `problems` are those of the file.

    With the `parameters` of a vehicle, the groups are messages of its flight controller. The
    `stated` columns and the `rate` are those of the only group, see `greybox.logs.read`. With
    `rows_allowed`, a group without a time becomes a record of rows. Otherwise it is reported as a
    finding: such groups usually hold settings.
    """
    checksum = checksum_of(path)
    by_name = {}
    findings = [*problems]
    findings += [f"there is no group {name}." for name in messages or () if name not in groups]
    present = ", ".join(groups)
    groups = {n: group for n, group in groups.items() if messages is None or n in messages}
    if stated and len(groups) != 1:
        raise ValueError(
            f"{path.name} has {len(groups)} groups ({some([*groups], 6)}), but `columns` names the "
            "columns of one table: prepare(read(FILE), signals={'u': 'GROUP.NAME', ...}) makes one "
            "record of several groups."
        )

    timer = "time" if "time" in (stated or {}) else ""
    if parameters is not None:
        # Topics of PX4 may have the times of their samples, too.
        timer = "timestamp"
    # Every group has a clock of its own.
    for name, group in groups.items():
        columns, units = renamed(*_split(group, stated), stated, path.name) if stated else group
        # Rows without a time are of experiments, not of devices that log in turn.
        has_clock = bool(timer or clock_names(columns, units))
        parts = devices(name, columns) if has_clock else {name: columns}
        for device, values in parts.items():
            part, assumed = table(device, values, units, rate, timer)
            if part.time is None and part.columns and rows_allowed:
                about = (device, path.name, checksum)
                by_name[device] = Record(None, part.columns, part.units, *about)  # type: ignore[arg-type]
                continue
            clocked, restarts = on_one_clock([part])
            if parameters is not None:
                clocked = with_holds(at_sample_times(clocked), parameters)
            records_of_device, dropped = records(clocked, path.name, checksum)
            by_name.update(records_of_device)
            findings += [*assumed, *restarts, *dropped]
    if not by_name:
        raise ValueError(
            f"{path} has no numeric column besides the time: it needs one for each signal."
            if rows_allowed
            else f"{path} has no group with a vector 'time' (or t, timestamp) and vectors of its "
            f"length; it holds {present or 'no samples at all: copy it again'}."
            + (" If its samples are at equal intervals, state rate=HZ." if present else "")
            + "".join(f" {problem}" for problem in problems)
        )

    return Recording(by_name, path.name, checksum, {}, tuple(findings))
