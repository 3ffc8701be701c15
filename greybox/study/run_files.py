"""The runs of one problem on disk: small files, each written whole, so that a search that is killed can go on.

Layout, version 1
-----------------
``runs-SERIAL-COUNT.h5``  sealed (`greybox.data.sealed_files`), with the attributes ``format`` ("greybox runs"),
    ``layout``, ``fingerprint`` (of the compiled problem and its solver), ``statuses`` (JSON), and datasets with a row
    a run: ``number`` (of the start), ``start`` (r, s) and ``estimate`` (r, p), ``cost``, ``status`` (index of
    ``statuses``), ``converged``, ``iterations``, ``seconds``, ``stage`` (index of `STAGES`, the last where it is
    missing); where runs have them, ``signature`` (r, m) and, of every part of the problem, ``nodes/0 ...`` (r, s n),
    the states of (s, n) as the JSON attribute ``shapes`` has it. A row of NaN is none. A run may be in two files, of
    which one replaces the other.
"""

import json
import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.sealed_files import Node, Stored, open_sealed, write_sealed
from greybox.data.text_table import printable
from greybox.solve.kept_runs import KeptRuns, KeptRunsError
from greybox.solve.outcome import IMPROVED, POLISHED, SCREENED, Outcome

Array = NDArray[np.float64]
Row = tuple[int, Array, Outcome]

KIND = "runs"
FORMAT = "greybox runs"
LAYOUT = 1
NAME = re.compile(r"runs-(\d{6,})-(\d+)\.h5")

# Work that is not on disk yet, at most, and its age, s: a file takes some milliseconds.
UNWRITTEN = 2.0

STAGES = (SCREENED, IMPROVED, POLISHED)
NUMBERS = ("cost", "converged", "iterations", "seconds")


@dataclass
class _File:
    path: Path
    rows: list[Row]


class RunFiles(KeptRuns):
    """The runs of one problem in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: list[_File] = []
        self._serial = 0
        self._unwritten: list[Row] = []
        self._written_at = time.monotonic()
        self.fingerprint = ""

    def known(self, fingerprint: str) -> Mapping[int, tuple[Array, Outcome]]:
        """Return the runs in the folder, by the number of their start.

        Raises
        ------
        KeptRunsError
            If they were made for another problem, or a file is damaged.
        """
        self.fingerprint = fingerprint
        self._files = []
        for serial, path in _paths(self._folder):
            self._serial = serial
            try:
                self._files.append(_File(path, _read(path, fingerprint)))
            except ValueError as error:
                raise KeptRunsError(str(error)) from error
        return {number: (start, outcome) for file in self._files for number, start, outcome in file.rows}

    def add(self, number: int, start: Array, outcome: Outcome) -> None:
        """Keep a run."""
        self._unwritten.append((number, start, outcome))
        self.look()

    def look(self) -> None:
        """Write what is older, or took longer, than `UNWRITTEN`."""
        age = time.monotonic() - self._written_at
        work = sum(outcome.seconds for _, _, outcome in self._unwritten)
        if max(age, work) >= UNWRITTEN:
            self.write()

    def write(self) -> None:
        """Write all runs that are not on disk yet.

        A file that is no longer than the new one becomes a part of it: n runs are in log2(n) files at most.

        Raises
        ------
        OSError
            If the file cannot be written; the others are as they were.
        """
        self._written_at = time.monotonic()
        if not self._unwritten:
            return
        rows, replaced = self._unwritten, 0
        for file in reversed(self._files):
            if len(file.rows) > len(rows):
                break
            rows = [*file.rows, *rows]
            replaced += 1
        self._serial += 1
        path = self._folder / f"runs-{self._serial:06d}-{len(rows)}.h5"
        write_sealed(path, KIND, lambda file: _fill(file, rows, self.fingerprint))
        self._unwritten = []
        kept = self._files[: len(self._files) - replaced]
        for file in self._files[len(kept) :]:
            file.path.unlink(missing_ok=True)
        self._files = [*kept, _File(path, rows)]

    @property
    def count(self) -> int:
        """How many runs are on disk."""
        return sum(len(file.rows) for file in self._files)

    def remove(self) -> None:
        """Remove all runs, and what a killed process left of them."""
        self._files, self._unwritten = [], []
        for path in (*(path for _, path in _paths(self._folder)), *self._folder.glob(".runs-*.part")):
            path.unlink(missing_ok=True)


def count_runs(folder: Path) -> int:
    """Return how many runs are in a folder, by the names of the files; a little more while one replaces another."""
    return sum(int(NAME.fullmatch(path.name)[2]) for _, path in _paths(folder))  # type: ignore[index]


def _paths(folder: Path) -> list[tuple[int, Path]]:
    found = ((NAME.fullmatch(path.name), path) for path in folder.iterdir())
    return sorted((int(match[1]), path) for match, path in found if match)


def _fill(file: Node, rows: Sequence[Row], fingerprint: str) -> None:
    outcomes = [outcome for _, _, outcome in rows]
    statuses = list(dict.fromkeys(outcome.status for outcome in outcomes))
    nodes = next((outcome.nodes for outcome in outcomes if outcome.nodes is not None), ())
    attributes = {"format": FORMAT, "layout": LAYOUT, "fingerprint": fingerprint, "statuses": json.dumps(statuses)}
    file.attrs.update({**attributes, "shapes": json.dumps([array.shape for array in nodes])})
    file["number"] = np.array([number for number, _, _ in rows])
    file["start"] = np.array([start for _, start, _ in rows])
    file["estimate"] = np.array([outcome.estimate for outcome in outcomes])
    file["status"] = np.array([statuses.index(outcome.status) for outcome in outcomes])
    for name in NUMBERS:
        file[name] = np.array([getattr(outcome, name) for outcome in outcomes])
    file["stage"] = np.array([STAGES.index(outcome.stage) for outcome in outcomes])
    if any(outcome.signature is not None for outcome in outcomes):
        file["signature"] = _stacked([outcome.signature for outcome in outcomes])
    for k in range(len(nodes)):
        file[f"nodes/{k}"] = _stacked([None if o.nodes is None else o.nodes[k].ravel() for o in outcomes])


def _stacked(arrays: Sequence[Array | None]) -> Array:
    """Stack arrays of one shape; None is NaN."""
    shape = next(array.shape for array in arrays if array is not None)
    return np.array([np.full(shape, math.nan) if array is None else array for array in arrays])


def _read(path: Path, fingerprint: str) -> list[Row]:
    with open_sealed(path, KIND) as file:
        if file.attrs["format"] != FORMAT:
            raise ValueError(f"its format is {printable(str(file.attrs['format']))!r:.60}")
        layout = int(file.attrs["layout"])
        own = file.attrs["fingerprint"]
        rows = _rows(file) if layout <= LAYOUT else []
    if layout > LAYOUT:
        raise ValueError(f"{path} has layout {layout} and this version reads up to {LAYOUT}: install a newer greybox.")
    if own != fingerprint:
        raise ValueError(
            f"{path} was made for another problem, with other options, or by another version of greybox or CasADi: "
            "give what the study was begun with, or begin another one."
        )
    return rows


def _rows(file: Stored) -> list[Row]:
    statuses = json.loads(file.attrs["statuses"])
    if not (isinstance(statuses, list) and all(isinstance(status, str) for status in statuses)):
        raise ValueError("its statuses are no texts")
    columns = {name: file[name][()] for name in ("number", "start", "estimate", "status", *NUMBERS)}
    count = len(columns["number"])
    columns["stage"] = file["stage"][()] if "stage" in file else np.full(count, len(STAGES) - 1)
    signature = file["signature"][()] if "signature" in file else None
    shapes = json.loads(file.attrs["shapes"])
    nodes = [file[f"nodes/{k}"][()].reshape(count, *shape) for k, shape in enumerate(shapes)]
    detail = [array for array in (signature, *nodes) if array is not None]
    if any(len(column) != count for column in (*columns.values(), *detail)):
        raise ValueError("its columns differ in length")
    if columns["start"].ndim != 2 or columns["estimate"].ndim != 2:
        raise ValueError("starts and estimates are no rows of numbers")
    return [_row(k, columns, statuses, signature, nodes) for k in range(count)]


def _row(k: int, columns: Mapping[str, Array], statuses: list[str], signature: Any, nodes: list[Array]) -> Row:
    own = tuple(array[k] for array in nodes)
    return (
        int(columns["number"][k]),
        columns["start"][k],
        Outcome(
            estimate=columns["estimate"][k],
            status=printable(statuses[int(columns["status"][k])]),
            iterations=int(columns["iterations"][k]),
            seconds=float(columns["seconds"][k]),
            converged=bool(columns["converged"][k]),
            cost=float(columns["cost"][k]),
            signature=None if signature is None or _is_none(signature[k]) else signature[k],
            stage=STAGES[int(columns["stage"][k])],
            nodes=None if not own or all(_is_none(array) for array in own) else own,
        ),
    )


def _is_none(array: Array) -> bool:
    return array.size > 0 and bool(np.isnan(array).all())
