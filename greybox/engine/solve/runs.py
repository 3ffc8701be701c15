"""Runs of a search: statuses, the result of one run, and all runs in columns.

There may be 100 000 runs, and a run as an object takes half a kilobyte.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import AnyArray, Array, BoolArray, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.printed import one_line
from greybox.data.files.wording import counted

# Statuses of a run besides those of its solver: it could not begin, ended where the integration
# misleads, was cut short, made no progress without being at a minimum, ended its process every time
# it was tried, or raised an error, which follows the word.
NOT_FINITE = "not finite at the start"
TOO_COARSE = "integration too coarse"
INTERRUPTED = "interrupted"
SEARCH_OVER = "time limit of the fit"
CUT_SHORT = (INTERRUPTED, SEARCH_OVER)
STAGNATED = "stagnated"
WORKER_LOST = "worker lost"
RAISED = "error"

# Stages of a run: only its start was compared with others, it was improved in a batch, or a solver
# of single runs finished it.
SCREENED, IMPROVED, POLISHED = "screened", "improved", "polished"


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """The outcome of one start.

    Attributes
    ----------
    index : int
        Number of the start.
    start, estimate : (p,) arrays
        The start and where the run ended, in the order of the free parameters. Runs of frequency
        responses exchange the ends of blocks of parameters that share no data: in one block, the
        estimate may be where another run ended.
    cost : float
        The criterion without smoothing, at the end.
    status : str
        What the solver returned.
    converged : bool
        Whether the end is a minimum: by the cost and its derivatives there, whatever the status.
    iterations : int
    seconds : float
    reason : str
        Why it did not converge, if the model shows it: where its response is not finite.
    stage : "screened", "improved" or "polished"
        "screened": only the start was evaluated, and others were more promising. "improved": a
        batch of runs was brought to minima together. "polished": a solver of single runs had the
        last word, IPOPT for frequency responses.
    """

    index: int
    start: Array
    estimate: Array
    cost: float
    status: str
    converged: bool
    iterations: int = 0
    seconds: float = 0.0
    reason: str = ""
    stage: str = POLISHED

    def __repr__(self) -> str:
        return one_line(
            self,
            f"{self.index}",
            self.status,
            f"cost {self.cost:.6g}",
            counted(self.iterations, "iteration"),
        )


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """The result of one run of a solver; `LocalSolver.judged` may add cost and signature later.

    Attributes
    ----------
    signature : (m,) array or None
        Numbers that distinguish runs, see `Part.signature`.
    nodes : tuple of (s, n) arrays, or None
        The states at the beginning of every segment, for each part.
    stage : str
        See `Run`.
    """

    estimate: Array
    status: str
    iterations: int
    seconds: float
    converged: bool
    cost: float = math.nan
    signature: Array | None = None
    nodes: tuple[Array, ...] | None = None
    stage: str = POLISHED

    def as_run(self, index: int, start: Array) -> Run:
        """Return the run from a start (p,) that had this result."""
        converged = self.converged and math.isfinite(self.cost)
        return Run(
            index,
            start,
            self.estimate,
            self.cost,
            self.status,
            converged,
            self.iterations,
            self.seconds,
            stage=self.stage,
        )


Outcomes = list[Outcome]  # one for each start


def has_raised(status: str) -> bool:
    """Return whether a run ended by an error."""
    return status.startswith(f"{RAISED}: ")


def has_no_end(status: str) -> bool:
    """Return whether a run ended nowhere: the model may not be evaluated where it began."""
    return status == WORKER_LOST or has_raised(status)


Texts = NDArray[np.object_]

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


def spent(outcome: Outcome, earlier: Outcome | Run) -> Outcome:
    """Return an outcome with the iterations and seconds of an earlier one added."""
    return replace(
        outcome,
        iterations=earlier.iterations + outcome.iterations,
        seconds=earlier.seconds + outcome.seconds,
    )


@frozen
class Runs(Sequence[Run]):
    """Runs in the order of their starts; an item is a `Run`.

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
        """Return the number of runs."""
        return len(self.indices)

    @overload
    def __getitem__(self, key: int) -> Run: ...

    @overload
    def __getitem__(self, key: "slice | AnyArray") -> "Runs": ...

    def __getitem__(self, key: Any) -> "Run | Runs":
        """Return one run, or the runs that a slice, indices or booleans (r,) select."""
        if isinstance(key, slice | np.ndarray):
            return Runs(*(getattr(self, name)[key] for name in COLUMNS))
        if not -len(self) <= key < len(self):
            raise IndexError(f"run {key} of {len(self)}")
        return next(iter(self[key : key + 1 or None]))

    def __iter__(self) -> Iterator[Run]:
        """Yield one run after the other."""
        # As lists: reading numbers from arrays one by one takes several times as long.
        columns = (getattr(self, name) for name in COLUMNS)
        yield from map(Run, *(column if column.ndim > 1 else column.tolist() for column in columns))

    def __repr__(self) -> str:
        return one_line(
            self, counted(len(self), "run"), f"{np.count_nonzero(self.converged)} converged"
        )
