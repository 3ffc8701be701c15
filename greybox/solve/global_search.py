"""Scatter search with filters in front of a local solver, as MATLAB's GlobalSearch, by which the paper was made.

Ugray, Lasdon, Plummer, Glover, Kelly and Martí, Scatter search and local NLP solvers: a multistart
framework for global optimization, INFORMS J. Comput. 19 (2007) 328-340. Trial points are
combinations of a reference set of good and of diverse points. Of the first fifth the best is a
start of the local solver; later each trial point is one, unless it lies near a minimum in a region
from which that was reached before (distance filter), or its cost is above a threshold (merit
filter), which is the cost at the last start and rises while points are turned down.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.executors import packed
from greybox.solve.interruption import stop_requested
from greybox.solve.ipopt import IpoptSolver, merits
from greybox.solve.kept_runs import KeptRuns, Memory
from greybox.solve.minima import Multistart, find_minima
from greybox.solve.outcome import SCREENED, Outcome
from greybox.solve.runs import Ended
from greybox.solve.time_limits import one_run

# The values of the reference, section 3 and table 1, and of MATLAB's GlobalSearch.
TRIAL_POINTS = 1000
STAGE_ONE = 0.2  # of the trial points
REFERENCES = 10  # points of the reference set, half of them good and half diverse
DISTANCE_FACTOR = 0.75  # of the largest distance from which a minimum was reached
WAIT_CYCLE = 20  # trial points that a filter turns down before it gives way
THRESHOLD_FACTOR = 0.2


def global_search(
    nlp: CompiledProblem,
    solver: IpoptSolver,
    drawn: Array,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
    kept: KeptRuns | None = None,
) -> Multistart:
    """Search from trial points, as many as were `drawn` (r, p); these are the diverse ones.

    Every trial point is a run; those that a filter turned down stay at their start.
    """
    began = time.perf_counter()
    memory = Memory() if kept is None else Memory(kept, packed(solver)[0])

    def merit(z: Array) -> float:
        return float(merits(nlp, z[:, None])[0])

    count, first = len(drawn), max(int(STAGE_ONE * len(drawn)), 1)
    trials = _ScatterSearch(nlp, drawn, merit, np.random.default_rng(seed))
    filters = _Filters()
    starts: list[Array] = []
    outcomes: list[Outcome] = []

    def solved(number: int, start: Array) -> Outcome:
        outcome = memory.recall(number, start)
        if outcome is None:
            with one_run():
                outcome = solver.run(start)
            memory.keep(number, start, outcome)
        judged = solver.judged_run(outcome)
        if judged.converged:
            filters.reached(
                nlp.scaling.to_solver(start), nlp.scaling.to_solver(judged.estimate), judged.cost
            )
        return judged

    for number, (z, value) in enumerate(itertools.islice(trials.points(), count)):
        if stop_requested():
            break
        start = np.clip(nlp.scaling.to_parameters(z), nlp.lower, nlp.upper)
        starts.append(start)
        if number >= first and filters.let_pass(z, value):
            outcomes.append(solved(number, start))
        else:
            outcomes.append(
                Outcome(start, SCREENED, 0, 0.0, converged=False, cost=value, stage=SCREENED)
            )
        if number == first - 1:
            best = min(range(first), key=lambda k: outcomes[k].cost)
            filters.threshold = outcomes[best].cost
            outcomes[best] = solved(best, starts[best])
        if progress is not None:
            progress(number + 1, count)

    ended = Ended.of(np.array(starts).reshape(-1, drawn.shape[1]), outcomes)
    runs = ended.runs()
    return Multistart(runs, find_minima(nlp, runs, ended.signatures), time.perf_counter() - began)


@dataclass
class _Filters:
    """Which trial points become starts.

    Attributes
    ----------
    minima : list of [z, cost, radius, how many trial points were turned down for it]
    """

    threshold: float = np.inf
    refused: int = 0
    minima: list[list] = field(default_factory=list)

    def let_pass(self, z: Array, value: float) -> bool:
        """Tell whether a trial point of this merit is far from the minima and good enough."""
        near = [m for m in self.minima if np.linalg.norm(z - m[0]) < DISTANCE_FACTOR * m[2]]
        for minimum in near:
            minimum[3] += 1
            if minimum[3] >= WAIT_CYCLE:  # it claims too large a region
                minimum[2], minimum[3] = minimum[2] * (1 - THRESHOLD_FACTOR), 0
        if near:
            return False
        if value <= self.threshold:
            self.threshold, self.refused = value, 0
            return True
        self.refused += 1
        if self.refused >= WAIT_CYCLE:
            self.threshold += THRESHOLD_FACTOR * (1 + abs(self.threshold))
            self.refused = 0
        return False

    def reached(self, start: Array, end: Array, cost: float) -> None:
        """Note that a minimum was reached from a start."""
        distance = float(np.linalg.norm(end - start))
        for minimum in self.minima:
            if np.linalg.norm(minimum[0] - end) <= 1e-3 * (1 + np.linalg.norm(end)):
                minimum[2] = max(minimum[2], distance)
                return
        self.minima.append([end, cost, distance, 0])


class _ScatterSearch:
    """Trial points: what was drawn, and combinations of a reference set."""

    def __init__(
        self,
        nlp: CompiledProblem,
        drawn: Array,
        merit: Callable[[Array], float],
        random: np.random.Generator,
    ) -> None:
        self._drawn = iter(nlp.scaling.to_solver(drawn))
        self._diverse = max(int(STAGE_ONE * len(drawn)), 1)
        self._low, self._high = nlp.scaling.to_solver(nlp.lower), nlp.scaling.to_solver(nlp.upper)
        self._merit = merit
        self._random = random
        self._references: list[tuple[float, Array]] = []

    def points(self) -> Iterator[tuple[Array, float]]:
        """Give trial points z (p,) and their merits, without end."""
        found = []
        for z in itertools.islice(self._drawn, self._diverse):
            found.append((self._merit(z), z))
            yield z, found[-1][0]
        self._refer(found)
        while True:
            changed = False
            pairs = list(itertools.combinations([z for _, z in self._references], 2))
            for one, other in pairs:
                for z in self._combined(one, other):
                    value = self._merit(z)
                    changed |= self._improved(value, z)
                    yield z, value
            if not changed or not pairs:
                yield from self._renewed()

    def _combined(self, one: Array, other: Array) -> Iterator[Array]:
        """Give a point beyond either of two points, and one between them."""
        half = (other - one) / 2
        for origin, sign in ((one, -1.0), (one, 1.0), (other, 1.0)):
            yield np.clip(origin + sign * self._random.random() * half, self._low, self._high)

    def _improved(self, value: float, z: Array) -> bool:
        """Put a point into the place of the worst of the reference set, if it is better and none of them."""
        worst = max(range(len(self._references)), key=lambda k: self._references[k][0])
        known = any(np.allclose(z, other, rtol=0, atol=1e-6) for _, other in self._references)
        if known or not value < self._references[worst][0]:
            return False
        self._references[worst] = (value, z)
        return True

    def _refer(self, found: list[tuple[float, Array]]) -> None:
        """Take the better half of the reference set, then, one by one, what is farthest from all in it."""
        order = sorted(range(len(found)), key=lambda k: found[k][0])
        chosen, rest = order[: REFERENCES // 2], order[REFERENCES // 2 :]
        while rest and len(chosen) < REFERENCES:
            distances = [
                min(np.linalg.norm(found[k][1] - found[c][1]) for c in chosen) for k in rest
            ]
            chosen.append(rest.pop(int(np.argmax(distances))))
        self._references = [found[k] for k in chosen]

    def _renewed(self) -> Iterator[tuple[Array, float]]:
        """Give fresh points, and refer to the good half and to the most diverse of them."""
        fresh = []
        for z in itertools.islice(self._drawn, 2 * REFERENCES):
            fresh.append((self._merit(z), z))
            yield z, fresh[-1][0]
        if not fresh:  # all that were drawn are used: what lies around the best
            good = sorted(self._references, key=lambda pair: pair[0])[0][1]
            width = np.where(np.isfinite(self._high - self._low), self._high - self._low, 1.0)
            for _ in range(2 * REFERENCES):
                z = np.clip(
                    good + 0.1 * width * self._random.normal(size=len(good)), self._low, self._high
                )
                fresh.append((self._merit(z), z))
                yield z, fresh[-1][0]
        self._refer(
            [*sorted(self._references, key=lambda pair: pair[0])[: REFERENCES // 2], *fresh]
        )
