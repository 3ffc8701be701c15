"""What one run of a solver leaves: an outcome for the search, a `Run` for the user."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from greybox.data.text_table import counted, one_line

Array = NDArray[np.float64]


NOT_FINITE = "not finite at the start"  # status of a run that could not begin
TOO_COARSE = "integration too coarse"  # status of a run that ended at an alias
INTERRUPTED = "interrupted"  # status of the run that was at hand when Ctrl-C was pressed
WORKER_LOST = "worker lost"  # status of a run that ended the process it was made in, as often as it was tried


@dataclass(frozen=True, eq=False)
class Run:
    """The outcome of one start.

    Attributes
    ----------
    index : int
        Number of the start.
    start, estimate : (p,) arrays
        Where the run began and ended, in the order of the free parameters.
    cost : float
        The criterion without smoothing, at the end.
    status : str
        What the solver returned.
    converged : bool
        True when the solver reports a solution and the cost is finite.
    iterations : int
    seconds : float
    reason : str
        Why it did not converge, as far as the model tells: where its response is not finite.
    """

    index: int
    start: Array
    estimate: Array
    cost: float
    status: str
    converged: bool
    iterations: int
    seconds: float
    reason: str = ""

    def __repr__(self) -> str:
        return one_line(
            self, f"{self.index}", self.status, f"cost {self.cost:.6g}", counted(self.iterations, "iteration")
        )


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a solver leaves of one run; see `LocalSolver.judged` for what is evaluated later, for all runs at once.

    Attributes
    ----------
    signature : (m,) array or None
        By which runs are told apart, see `Part.signature`.
    nodes : tuple of (s, n) arrays, or None
        The states at the beginning of every segment, for each part.
    """

    estimate: Array
    status: str
    iterations: int
    seconds: float
    converged: bool
    cost: float = math.nan
    signature: Array | None = None
    nodes: tuple[Array, ...] | None = None
