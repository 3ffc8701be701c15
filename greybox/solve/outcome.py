"""The result of one run of a solver: an `Outcome` for the search, a `Run` for the user."""

import math
from dataclasses import dataclass

from greybox.files.arrays import Array
from greybox.files.text_table import counted, one_line

# Statuses of a run besides those of its solver: it could not begin, ended where the integration
# misleads, was cut short, made no progress without being at a minimum, or ended its process every
# time it was tried.
NOT_FINITE = "not finite at the start"
TOO_COARSE = "integration too coarse"
INTERRUPTED = "interrupted"
SEARCH_OVER = "time limit of the fit"
RUN_OVER = "time limit of a start"
CUT_SHORT = (INTERRUPTED, SEARCH_OVER, RUN_OVER)
STAGNATED = "stagnated"
WORKER_LOST = "worker lost"

# Stages of a run: only its start was compared with others, it was improved in a batch, or a solver
# of single runs had the last word.
SCREENED, IMPROVED, POLISHED = "screened", "improved", "polished"


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
    """The result of one run of a solver; `LocalSolver.judged` evaluates cost and signature of all runs later.

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
