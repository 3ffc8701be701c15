"""The runs of a search in columns: as an object a run takes half a kilobyte, and there may be a hundred thousand."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from greybox.files.arrays import Array, BoolArray, IntArray
from greybox.files.text_table import counted, one_line
from greybox.solve.outcome import SCREENED, Outcome, Run

Texts = NDArray[np.object_]

AT_ONCE = 4096  # runs that are looked at together: what fits into the cache
NAMES = tuple(field.name for field in fields(Run))
COLUMNS = ("indices", *NAMES[1:])
KINDS = {
    "index": int,
    "converged": bool,
    "iterations": int,
    "status": object,
    "reason": object,
    "stage": object,
}


@dataclass(frozen=True, eq=False)
class Runs(Sequence[Run]):
    """Runs in the order of their starts; each is a `Run` where it is asked for.

    Attributes
    ----------
    indices, iterations : (r,) arrays of int
    start, estimate : (r, p) arrays
    cost, seconds : (r,) arrays
    status, reason, stage : (r,) arrays of str
    converged : (r,) array of bool
        All as in `Run`.
    """

    indices: IntArray
    start: Array
    estimate: Array
    cost: Array
    status: Texts
    converged: BoolArray
    iterations: IntArray
    seconds: Array
    reason: Texts
    stage: Texts

    @staticmethod
    def of(runs: Iterable[Run]) -> "Runs":
        """Return runs in columns."""
        if isinstance(runs, Runs):
            return runs
        listed = list(runs)
        columns = (
            np.array([getattr(run, name) for run in listed], KINDS.get(name, float))
            for name in NAMES
        )
        return Runs(*columns)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.indices)

    @overload
    def __getitem__(self, key: int) -> Run: ...

    @overload
    def __getitem__(self, key: "slice | NDArray[Any]") -> "Runs": ...

    def __getitem__(self, key: Any) -> "Run | Runs":
        """Return a run, or those of a slice, of some places, or where an array (r,) is true."""
        if isinstance(key, slice | np.ndarray):
            return Runs(*(getattr(self, name)[key] for name in COLUMNS))
        if not -len(self) <= key < len(self):
            raise IndexError(f"run {key} of {len(self)}")
        return next(iter(self[key : key + 1 or None]))

    def __iter__(self) -> Iterator[Run]:
        """Give one run after the other."""
        for begin in range(0, len(self), AT_ONCE):
            some = self[begin : begin + AT_ONCE]
            columns = (getattr(some, name) for name in COLUMNS)
            yield from map(
                Run, *(column if column.ndim > 1 else column.tolist() for column in columns)
            )

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self), "run"), f"{np.count_nonzero(self.converged)} converged"
        )


class Ended:
    """What the runs of a search have left so far: a row for each of its starts, then for those from elsewhere.

    Attributes
    ----------
    signatures, nodes : lists
        Of every row, see `Outcome`.
    """

    def __init__(self, starts: Array) -> None:
        """Make room for the runs from these starts (r, p)."""
        self._all = _room(0, starts)
        self.signatures: list[Array | None] = [None] * len(starts)
        self.nodes: list[tuple[Array, ...] | None] = [None] * len(starts)
        self._is_there = np.zeros(len(starts), dtype=bool)

    @staticmethod
    def of(starts: Array, outcomes: Sequence[Outcome]) -> "Ended":
        """Return what runs from all of the starts (r, p) have left."""
        ended = Ended(starts)
        for row, (start, outcome) in enumerate(zip(starts, outcomes, strict=True)):
            ended.put(row, start, outcome)
        return ended

    def put(self, row: int, start: Array, outcome: Outcome) -> None:
        """Note what a run has left, in a row that is there or the next one."""
        if row == len(self._all):
            more = _room(row, start[None])
            self._all = Runs(
                *(
                    np.concatenate([getattr(each, name) for each in (self._all, more)])
                    for name in COLUMNS
                )
            )
            self.signatures, self.nodes = [*self.signatures, None], [*self.nodes, None]
            self._is_there = np.append(self._is_there, False)
        runs = self._all
        runs.start[row], runs.estimate[row], runs.cost[row] = start, outcome.estimate, outcome.cost
        runs.status[row], runs.stage[row], runs.converged[row] = (
            outcome.status,
            outcome.stage,
            outcome.converged,
        )
        runs.iterations[row], runs.seconds[row] = outcome.iterations, outcome.seconds
        self.signatures[row], self.nodes[row], self._is_there[row] = (
            outcome.signature,
            outcome.nodes,
            True,
        )

    @property
    def rows(self) -> IntArray:
        """Those that runs have filled."""
        return np.flatnonzero(self._is_there)

    def runs(self, costs: Array | None = None) -> Runs:
        """Return the runs that were made, numbered in their order, with their `costs` where these were unknown."""
        rows = self.rows
        made = self._all if len(rows) == len(self._all) else self._all[rows]
        cost = made.cost if costs is None else costs
        return replace(
            made,
            indices=np.arange(len(rows)),
            cost=cost,
            converged=made.converged & np.isfinite(cost),
        )

    def among_screened(self, made: Runs, costs: Array) -> Runs:
        """Return the runs that were made among those that were compared only, at these `costs` (r,)."""
        every, rest = self._all, np.flatnonzero(~self._is_there)
        every.status[rest] = every.stage[rest] = SCREENED
        every.cost[rest], every.cost[self.rows] = costs[rest], made.cost
        every.converged[self.rows] = made.converged
        return every


def _room(first: int, starts: Array) -> Runs:
    """Return runs from these starts (r, p) that were not made."""
    r = len(starts)
    text, number = np.full(r, "", dtype=object), np.zeros(r)
    return Runs(
        indices=np.arange(first, first + r),
        start=starts.copy(),
        estimate=starts.copy(),
        cost=number.copy(),
        status=text.copy(),
        converged=np.zeros(r, dtype=bool),
        iterations=np.zeros(r, dtype=int),
        seconds=number,
        reason=text.copy(),
        stage=text,
    )
