"""The result of a multistart: every run, and the distinct minima."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.data.files.arrays import Array, IntArray
from greybox.data.files.frozen_values import frozen
from greybox.data.files.printed import one_line
from greybox.data.files.wording import counted
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.compiled.response_part import ResponsePart
from greybox.engine.solve.runs import SCREENED, TOO_COARSE, Run, Runs
from greybox.modeling.formulation.frequency_criteria import cost_of_zero

AT_ONCE = 4096  # runs that are processed together: as many as fit into the cache

RIVAL = 3.0  # units up to which another minimum is a rival: it is twenty times less likely

Signatures = Sequence[NDArray[np.floating] | None] | NDArray[np.floating]
"""Signatures of the responses of all runs, see `Part.signature`."""


@frozen
class Minimum:
    """One distinct minimum: a cost and a model response that a group of runs shares.

    Attributes
    ----------
    cost : float
        Without smoothing.
    estimate : (p,) array
        The best run's estimate.
    runs : tuple of int
        Indices of the runs that ended here, best first.
    variants : int
        How many clearly different parameter vectors give this same response (two lags that swap are
        two).
    """

    cost: float
    estimate: Array
    runs: tuple[int, ...]
    variants: int

    def __repr__(self) -> str:
        return one_line(
            self,
            f"cost {self.cost:.6g}",
            counted(len(self.runs), "run"),
            counted(self.variants, "variant"),
        )


@frozen
class Multistart:
    """All runs of a problem, in the order of their starts, and its minima, best first.

    `nodes` are the best run's states at the beginning of every segment, (s, n) for each record.
    Where no run converged, `ends` has those of all runs.
    """

    runs: Runs
    minima: tuple[Minimum, ...]
    nodes: tuple[Array, ...] | None = None
    ends: tuple[tuple[Array, ...] | None, ...] = ()

    @property
    def converged(self) -> int:
        """How many runs converged."""
        return int(np.count_nonzero(self.runs.converged))

    @property
    def brought(self) -> Runs:
        """The runs that were not only screened, whether they arrived at a minimum or not."""
        return self.runs[self.runs.stage != SCREENED]

    @property
    def failures(self) -> str:
        """The statuses of the runs that did not converge, with counts."""
        brought = self.brought
        named = (
            f"{r.status} ({r.reason})" if r.reason else r.status
            for r in brought[~brought.converged]
        )
        counts = Counter(named)
        return ", ".join(f"{count} × {status}" for status, count in counts.most_common())

    def __repr__(self) -> str:
        return one_line(
            self,
            f"{self.converged} of {counted(len(self.brought), 'run')} converged",
            counted(len(self.minima), "minimum", "minima"),
        )


def best_unfinished(runs: Sequence[Run]) -> Run | None:
    """Return the run with the lowest finite cost of those that did not converge, if any."""
    # A run on too coarse an integration has a cost that no finer one would have.
    runs = Runs.of(runs)
    ended = runs[~runs.converged & (runs.status != TOO_COARSE) & np.isfinite(runs.cost)]
    # A start that was only screened has not been run: it is the last choice.
    tried = ended[ended.stage != SCREENED] or ended
    return tried[np.argmin(tried.cost)] if tried else None


def agreeing_runs(
    nlp: CompiledProblem, runs: Sequence[Run], minima: Sequence[Minimum]
) -> tuple[int, ...]:
    """Return the indices of runs whose cost the data cannot distinguish from the lowest.

    None agree if the lowest is nearly that of a response of zero: such a model explains nothing,
    wherever the runs began.

    The costs differ by at most a tenth of a unit of log-likelihood.
    """
    if not minima:
        return ()
    best = minima[0].cost
    responses = nlp.parts_of(ResponsePart)
    zero = sum(part.weight * cost_of_zero(part.criterion, part.data) for part in responses)
    if len(responses) == len(nlp.parts) and explains_nothing(best, zero):
        return ()
    limit = best + 0.1 * likelihood_unit(nlp, best)
    # Only the costs are compared: the data cannot distinguish these ends, whatever their responses.
    columns = Runs.of(runs)
    close = columns.indices[columns.converged & (columns.cost <= limit)]
    return tuple(sorted({*close.tolist(), *minima[0].runs}))


def likelihood_unit(nlp: CompiledProblem, best: float) -> float:
    """Return the difference of costs near the lowest that is a unit of log-likelihood.

    With unknown noise the cost of n real numbers is proportional to the noise or its square, and
    the log-likelihood to n log(cost): a unit of it is cost / n.
    """
    if any(part.is_likelihood for part in nlp.parts):
        return 1.0
    return abs(best) / max(nlp.numbers, 1)


def explains_nothing(cost: Any, zero: float) -> Any:
    """Return whether a cost (any shape) is that of a response of zero, to a percent."""
    return cost >= 0.99 * zero


def find_minima(
    nlp: CompiledProblem, runs: Sequence[Run], signatures: Signatures
) -> tuple[Minimum, ...]:
    """Group the converged runs by cost and model response, best first.

    Two runs are at one minimum when their costs and their responses agree, whatever the parameters.
    `signatures` are those of the responses of all starts (`Part.signature`), in their order.
    """
    columns = Runs.of(runs)
    order = np.flatnonzero(columns.converged)
    if not order.size:
        return ()
    order = order[np.argsort(columns.cost[order], kind="stable")]
    costs, indices = columns.cost[order], columns.indices[order]
    z = nlp.scaling.to_solver(columns.estimate[order])
    ungrouped = np.ones(len(order), dtype=bool)
    minima = []
    while ungrouped.any():
        k = np.argmax(ungrouped)
        cost = float(costs[k])

        # Responses decide, since different parameters may have one response: their differences are
        # relative to the data or the response.
        candidates = np.flatnonzero(ungrouped & (costs - cost <= same_cost(nlp, cost)))
        distances = _differences(signatures, indices[k], indices[candidates])
        near = candidates[(distances <= 1e-2) | (candidates == k)]
        ungrouped[near] = False

        # Where equivalent parameter vectors have the same cost but for rounding, the first start
        # decides between them: the last bit of the cost would choose another one on another
        # processor.
        ties = near[costs[near] <= cost + 1e-9 * max(abs(cost), 1.0)]
        first = ties[np.argmin(indices[ties])]
        near = near[np.argsort(_are_apart(z[near], z[first]), kind="stable")]
        minima.append(minimum_of(nlp, columns[order[near]]))
    return tuple(minima)


def minimum_of(nlp: CompiledProblem, runs: Runs) -> Minimum:
    """Return the minimum that these runs share, best first."""
    variants = len(distinct_ends(nlp, runs.estimate))
    return Minimum(float(runs.cost[0]), runs.estimate[0], tuple(runs.indices.tolist()), variants)


def _differences(signatures: Signatures, of: int, indices: IntArray) -> Array:
    """Return the root mean square differences of responses from that of one run, relative to it."""
    reference = np.asarray(signatures[of], dtype=float)
    size = np.maximum(np.abs(reference), 1.0)  # signatures come in units of the measured signals
    # One by one: the responses of 100 000 runs would fill the memory.
    return np.array(
        [np.sqrt(np.mean(((signatures[index] - reference) / size) ** 2)) for index in indices]
    )


def same_cost(nlp: CompiledProblem, cost: float) -> float:
    """Return the difference of two costs up to which they count as the same."""
    if any(part.is_likelihood for part in nlp.parts):
        # A tenth of a standard error changes a negative log-likelihood by 5e-3.
        return 1e-2 + 1e-7 * abs(cost)
    # The smoothing moves costs by up to 6e-5 of themselves.
    return 1e-4 * max(cost, 5e-4 * nlp.numbers)


def _are_apart(z: Array, reference: Array) -> NDArray[np.bool_]:
    """Return which points (r, p) are more than 5 % of their size from a reference (p,)."""
    distance = np.abs(z - reference)
    return np.any(distance > 0.05 * np.maximum(np.abs(z), np.abs(reference)) + 1e-6, axis=1)


def distinct_ends(nlp: CompiledProblem, ends: Array) -> list[IntArray]:
    """Group clearly different parameter vectors (r, p) by rows, in their order."""
    z = nlp.scaling.to_solver(ends)
    # Each pass takes the rows that are like the first of those that remain.
    groups = []
    remaining = np.arange(len(z))
    while remaining.size:
        apart = _are_apart(z[remaining], z[remaining[0]])
        groups.append(remaining[~apart])
        remaining = remaining[apart]
    return groups
