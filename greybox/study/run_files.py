"""The runs of one problem on disk: small files, each written whole, so that a search that is killed can go on.

Layout, version 1
-----------------
``runs-SERIAL-COUNT.h5``  sealed (`greybox.files.sealed_files`), with the attributes ``format``
("greybox runs"),
    ``layout``, ``fingerprint`` (of the compiled problem and its solver), ``statuses`` (JSON), and
    datasets with a row a run: ``number`` (of the start), ``start`` (r, s) and ``estimate`` (r, p),
    ``cost``, ``status`` (index of ``statuses``), ``converged``, ``iterations``, ``seconds``,
    ``stage`` (index of `STAGES`, the last where it is missing); where runs have them, ``signature``
    (r, m) and, of every part of the problem, ``nodes/0 ...`` (r, s n), the states of (s, n) as the
    JSON attribute ``shapes`` has it. A row of NaN is none. A run may be in two files, of which one
    replaces the other.
"""

import json
import math
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array
from greybox.files.sealed_files import Node, Stored, open_sealed, write_sealed
from greybox.files.text_table import printable
from greybox.solve.kept_runs import KeptRuns, KeptRunsError
from greybox.solve.outcome import IMPROVED, POLISHED, SCREENED, Outcome

Row = tuple[int, Array, Outcome]

KIND = "runs"
FORMAT = "greybox runs"
LAYOUT = 1
NAME = re.compile(r"runs-(\d{6,})-(\d+)\.h5")

# Work that is not on disk yet, at most, and its age, s: a file takes some milliseconds.
UNWRITTEN = 2.0

STAGES = (SCREENED, IMPROVED, POLISHED)
NUMBERS = ("cost", "converged", "iterations", "seconds")
KINDS = {"number": int, "status": int, "stage": int, "converged": bool, "iterations": int}


@dataclass(frozen=True, eq=False)
class _Columns:
    """Runs by columns, as a file has them, each by its name; the nodes of the first part are ``nodes/0``.

    Attributes
    ----------
    statuses : list of str
        Those that the column ``status`` counts.
    shapes : list of tuple of int
        Of the nodes of every part.
    """

    columns: Mapping[str, NDArray[Any]]
    statuses: list[str]
    shapes: list[tuple[int, ...]]

    @staticmethod
    def of(rows: Sequence[Row]) -> "_Columns":
        outcomes = [outcome for _, _, outcome in rows]
        statuses = list(dict.fromkeys(outcome.status for outcome in outcomes))
        nodes = next((outcome.nodes for outcome in outcomes if outcome.nodes is not None), ())
        columns: dict[str, NDArray[Any]] = {
            "number": np.array([number for number, _, _ in rows]),
            "start": np.array([start for _, start, _ in rows]),
            "estimate": np.array([outcome.estimate for outcome in outcomes]),
            "status": np.array([statuses.index(outcome.status) for outcome in outcomes]),
            **{
                name: np.array([getattr(outcome, name) for outcome in outcomes]) for name in NUMBERS
            },
            "stage": np.array([STAGES.index(outcome.stage) for outcome in outcomes]),
        }
        if any(outcome.signature is not None for outcome in outcomes):
            columns["signature"] = _stacked([outcome.signature for outcome in outcomes])
        for k in range(len(nodes)):
            columns[f"nodes/{k}"] = _stacked(
                [None if o.nodes is None else o.nodes[k].ravel() for o in outcomes]
            )
        return _Columns(columns, statuses, [array.shape for array in nodes])

    @staticmethod
    def joined(first: "_Columns", second: "_Columns") -> "_Columns":
        """Return the runs of both."""
        statuses = list(dict.fromkeys([*first.statuses, *second.statuses]))
        both = [each._with(statuses) for each in (first, second)]
        columns = {}
        for name in dict.fromkeys([*both[0], *both[1]]):
            width = next(each[name].shape[1:] for each in both if name in each)
            missing = (np.full((len(each["number"]), *width), math.nan) for each in both)
            columns[name] = np.concatenate(
                [each.get(name, none) for each, none in zip(both, missing, strict=True)]
            )
        return _Columns(columns, statuses, first.shapes or second.shapes)

    def _with(self, statuses: list[str]) -> dict[str, NDArray[Any]]:
        """Return the columns with the places of their statuses among others."""
        places = np.array([statuses.index(status) for status in self.statuses])
        return {**self.columns, "status": places[self.columns["status"]]}

    def __len__(self) -> int:
        return len(self.columns["number"])

    def row(self, k: int) -> tuple[Array, Outcome]:
        """Return start and outcome of a run."""
        columns = self.columns
        signature = columns["signature"][k] if "signature" in columns else None
        nodes = tuple(
            columns[f"nodes/{part}"][k].reshape(shape) for part, shape in enumerate(self.shapes)
        )
        outcome = Outcome(
            estimate=columns["estimate"][k],
            status=printable(self.statuses[int(columns["status"][k])]),
            iterations=int(columns["iterations"][k]),
            seconds=float(columns["seconds"][k]),
            converged=bool(columns["converged"][k]),
            cost=float(columns["cost"][k]),
            signature=None if signature is None or _is_none(signature) else signature,
            stage=STAGES[int(columns["stage"][k])],
            nodes=None if all(_is_none(array) for array in nodes) else nodes,
        )
        return columns["start"][k], outcome


@dataclass(frozen=True, eq=False)
class _File:
    path: Path
    runs: _Columns


class _Known(Mapping[int, tuple[Array, Outcome]]):
    """Runs in columns by their numbers; of those in two files the later one."""

    def __init__(self, parts: Sequence[_Columns]) -> None:
        self._parts = parts
        self._numbers = np.concatenate(
            [np.zeros(0, dtype=int), *(part.columns["number"] for part in parts)]
        )
        self._order = np.argsort(self._numbers, kind="stable")
        self._sorted = self._numbers[self._order]
        self._ends = np.cumsum([len(part) for part in parts])

    def __getitem__(self, number: int) -> tuple[Array, Outcome]:
        at = int(np.searchsorted(self._sorted, number, side="right")) - 1
        if at < 0 or self._sorted[at] != number:
            raise KeyError(number)
        place = int(self._order[at])
        part = int(np.searchsorted(self._ends, place, side="right"))
        return self._parts[part].row(place - int(self._ends[part]) + len(self._parts[part]))

    def __iter__(self) -> Iterator[int]:
        return iter(np.unique(self._sorted).tolist())

    def __len__(self) -> int:
        return len(np.unique(self._sorted))


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
        return _Known([file.runs for file in self._files])

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

        A file that is no longer than the new one becomes a part of it: n runs are in log2(n) files
        at most.

        Raises
        ------
        OSError
            If the file cannot be written; the others are as they were.
        """
        self._written_at = time.monotonic()
        if not self._unwritten:
            return
        runs, replaced = _Columns.of(self._unwritten), 0
        for file in reversed(self._files):
            if len(file.runs) > len(runs):
                break
            runs = _Columns.joined(file.runs, runs)
            replaced += 1
        self._serial += 1
        path = self._folder / f"runs-{self._serial:06d}-{len(runs)}.h5"
        write_sealed(path, KIND, lambda file: _fill(file, runs, self.fingerprint))
        self._unwritten = []
        kept = self._files[: len(self._files) - replaced]
        for file in self._files[len(kept) :]:
            file.path.unlink(missing_ok=True)
        self._files = [*kept, _File(path, runs)]

    @property
    def count(self) -> int:
        """How many runs are on disk."""
        return sum(len(file.runs) for file in self._files)

    def remove(self) -> None:
        """Remove all runs, and what a killed process left of them."""
        self._files, self._unwritten = [], []
        for path in (
            *(path for _, path in _paths(self._folder)),
            *self._folder.glob(".runs-*.part"),
        ):
            path.unlink(missing_ok=True)


def count_runs(folder: Path) -> int:
    """Return how many runs are in a folder, by the names of the files; a little more while one replaces another."""
    return sum(int(NAME.fullmatch(path.name)[2]) for _, path in _paths(folder))  # type: ignore[index]


def _paths(folder: Path) -> list[tuple[int, Path]]:
    found = ((NAME.fullmatch(path.name), path) for path in folder.iterdir())
    return sorted((int(match[1]), path) for match, path in found if match)


def _fill(file: Node, runs: _Columns, fingerprint: str) -> None:
    attributes = {
        "format": FORMAT,
        "layout": LAYOUT,
        "fingerprint": fingerprint,
        "statuses": json.dumps(runs.statuses),
    }
    file.attrs.update({**attributes, "shapes": json.dumps(runs.shapes)})
    for name, column in runs.columns.items():
        file[name] = column


def _stacked(arrays: Sequence[Array | None]) -> Array:
    """Stack arrays of one shape; None is NaN."""
    shape = next(array.shape for array in arrays if array is not None)
    return np.array([np.full(shape, math.nan) if array is None else array for array in arrays])


def _read(path: Path, fingerprint: str) -> _Columns:
    with open_sealed(path, KIND) as file:
        if file.attrs["format"] != FORMAT:
            raise ValueError(f"its format is {printable(str(file.attrs['format']))!r:.60}")
        layout = int(file.attrs["layout"])
        own = file.attrs["fingerprint"]
        runs = _columns(file) if layout <= LAYOUT else None
    if runs is None:
        raise ValueError(
            f"{path} has layout {layout} and this version reads up to {LAYOUT}: install a newer greybox."
        )
    if own != fingerprint:
        raise ValueError(
            f"{path} was made for another problem, with other options, or by another version of greybox or CasADi: "
            "give what the study was begun with, or begin another one."
        )
    return runs


def _columns(file: Stored) -> _Columns:
    statuses = json.loads(file.attrs["statuses"])
    if not (isinstance(statuses, list) and all(isinstance(status, str) for status in statuses)):
        raise ValueError("its statuses are no texts")
    columns = {name: file[name][()] for name in ("number", "start", "estimate", "status", *NUMBERS)}
    count = len(columns["number"])
    columns["stage"] = file["stage"][()] if "stage" in file else np.full(count, len(STAGES) - 1)
    if "signature" in file:
        columns["signature"] = file["signature"][()]
    shapes = [tuple(shape) for shape in json.loads(file.attrs["shapes"])]
    for k, shape in enumerate(shapes):
        columns[f"nodes/{k}"] = file[f"nodes/{k}"][()].reshape(count, math.prod(shape))
    if any(len(column) != count for column in columns.values()):
        raise ValueError("its columns differ in length")
    if columns["start"].ndim != 2 or columns["estimate"].ndim != 2:
        raise ValueError("starts and estimates are no rows of numbers")
    columns |= {name: columns[name].astype(kind) for name, kind in KINDS.items()}
    for name, texts in (("status", statuses), ("stage", STAGES)):
        if count and not (columns[name].min() >= 0 and columns[name].max() < len(texts)):
            raise ValueError(f"a {name} is none of those that it names")
    return _Columns(columns, statuses, shapes)


def _is_none(array: Array) -> bool:
    return array.size > 0 and bool(np.isnan(array).all())
