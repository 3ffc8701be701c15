"""What one run of a solver leaves: an outcome for the search, a `Run` for the user."""

import math
from dataclasses import dataclass

from greybox.files.arrays import Array
from greybox.files.text_table import counted, one_line

NOT_FINITE = "not finite at the start"  # status of a run that could not begin
TOO_COARSE = "integration too coarse"  # status of a run that ended at an alias
INTERRUPTED = "interrupted"  # status of the run that was at hand when Ctrl-C was pressed
SEARCH_OVER = (
    "time limit of the fit"  # status of the run that was at hand when the time of its search was up
)
RUN_OVER = "time limit of a start"  # status of a run that took longer than its start may
CUT_SHORT = (INTERRUPTED, SEARCH_OVER, RUN_OVER)
STAGNATED = (
    "stagnated"  # status of a run whose cost did not fall any more, without being at a minimum
)
# How far a run was taken: its start was compared with others, a batch of runs was brought to minima
# together, or a solver confirmed that it ended at one, or tried to.
SCREENED, IMPROVED, POLISHED = "screened", "improved", "polished"

WORKER_LOST = (
    "worker lost"  # status of a run that ended the process it was made in, as often as it was tried
)


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """The outcome of one start.

    Attributes
    ----------
    index : int
        Number of the start.
    start, estimate : (p,) arrays
        The start and where the run ended, in the order of the free parameters.
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
    stage : "screened", "improved" or "polished"
        How far it was taken: only its start was evaluated, and others were more promising; it was
        brought to a minimum together with others; or a solver of single runs had the last word,
        IPOPT for frequency responses.
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
    """What a solver leaves of one run; see `LocalSolver.judged` for what is evaluated later, for all runs at once.

    Attributes
    ----------
    signature : (m,) array or None
        By which runs are told apart, see `Part.signature`.
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
