"""Files of named arrays (HDF5, MATLAB, PX4), read in a subprocess.

A damaged file can send the HDF5 library into an endless loop, crash it or scipy's MATLAB reader, and make all of them,
and pyulog, exhaust the memory; little of that can be caught in Python. So `subprocess_main` reads the file in another
process, with a time limit and, where the system has one, a memory limit. That costs about 0.1 s per file, 0.25 s for
MATLAB.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from greybox.data.record import Recording
from greybox.logs.readers.controller_outputs import with_holds
from greybox.logs.readers.messages import on_one_clock, records
from greybox.logs.readers.table_columns import table

SCRIPT = Path(__file__).with_name("subprocess_main.py")

# Time limit: s, and more for a large file at bytes per s. On a busy machine, starting Python and scipy took 1.7 s and
# reading ran at 30 MB/s (HDF5 and MATLAB, 32 MB).
PATIENCE = 10.0
SPEED = 2e6


class Variable(NamedTuple):
    """One numeric array: the group (or struct) that it is in, its own name, its unit."""

    group: str
    name: str
    unit: str
    values: NDArray[np.float64]


class Contents(NamedTuple):
    """What a file holds: its arrays, what was wrong with it, and what it says about the vehicle."""

    variables: list[Variable]
    findings: list[str]
    about: dict[str, Any]


def contents(kind: str, path: Path, *wanted: str) -> Contents:
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
        If the file cannot be read, or not within the time limit.
    """
    line, _, raw = _run([kind, str(path.absolute()), *wanted], path).partition(b"\n")
    head = json.loads(line)
    numbers = np.frombuffer(raw, dtype="<f8")
    variables = []
    offset = 0
    for item in head["items"]:
        size = int(np.prod(item["shape"]))
        group, _, name = item["path"].rpartition("/")
        values = numbers[offset : offset + size].reshape(item["shape"])
        variables.append(Variable(group, name, item["unit"], values))
        offset += size
    return Contents(variables, head["findings"], head["about"])


def _run(arguments: list[str], path: Path) -> bytes:
    """Return what the other process writes."""
    limit = PATIENCE + path.stat().st_size / SPEED
    command = [sys.executable, "-P", "-W", "ignore", str(SCRIPT), *arguments]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # every thread of it reserves memory
    try:
        done = subprocess.run(command, capture_output=True, timeout=limit, check=False, env=environment)
    except subprocess.TimeoutExpired:
        raise ValueError(f"{path} is damaged: reading it took longer than {limit:.0f} s.") from None
    if done.returncode < 0:
        raise ValueError(f"{path} is damaged: the library that reads it crashed; export or copy it again.")
    if done.returncode:
        reason = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:] or ["for no stated reason"]
        raise ValueError(f"{path} is damaged or of another format ({reason[0]:.160}): export or copy it again.")
    return done.stdout


def recording(
    path: Path,
    found: Contents,
    messages: Collection[str] | None,
    parameters: Mapping[str, float] | None = None,
) -> Recording:
    """Make a record of every group that has a time, the root named after the file; ValueError if none has.

    With the `parameters` of a vehicle the groups are known messages of its flight controller.
    """
    with open(path, "rb") as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    columns: dict[str, dict[str, NDArray[np.float64]]] = {}
    units: dict[str, dict[str, str]] = {}
    for variable in found.variables:
        name = variable.group or path.stem
        columns.setdefault(name, {})[variable.name] = variable.values
        units.setdefault(name, {})[variable.name] = variable.unit

    made = {}
    findings = list(found.findings)
    findings += [f"there is no group {name}." for name in messages or () if name not in columns]
    for name, group in columns.items():
        if messages is not None and name not in messages:
            continue
        part, problems = table(name, group, units[name])
        clocked, restarts = on_one_clock([part] if part else [])
        clocked = clocked if parameters is None else with_holds(clocked, parameters)
        records_of_group, dropped = records(clocked, path.name, checksum)
        made.update(records_of_group)
        findings += [*problems, *restarts, *dropped]
    if not made:
        raise ValueError(
            f"{path} has no group with a vector 'time' (or t, timestamp) and vectors of its length; "
            f"it holds {', '.join(columns) or 'no vectors at all'}."
        )
    return Recording(made, path.name, checksum, {}, tuple(findings))
