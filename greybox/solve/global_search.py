"""Scatter search with filters before a local solver, as in MATLAB's GlobalSearch, which the paper used.

Ugray, Lasdon, Plummer, Glover, Kelly and Martí, Scatter search and local NLP solvers: a multistart
framework for global optimization, INFORMS J. Comput. 19 (2007) 328-340. Trial points are
combinations of a reference set of good and of diverse points. The local solver starts from the best
of the first fifth. Later it starts from each trial point, unless the point lies in a region from
which a minimum was reached before (distance filter), or its cost is above a threshold (merit
filter): the cost at the last start, raised while points are refused.
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
STAGE_ONE = 0.2  # share of the trial points
REFERENCES = 10  # points of the reference set, half of them good and half diverse
WAIT_CYCLE = 20  # trial points that a filter refuses before it gives way
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
    """Search from as many trial points as were `drawn` (r, p), of which some are used as diverse points.

    Every trial point is a run; one that a filter refused stays at its start.
    """
    began = time.perf_counter()
    memory = Memory() if kept is None else Memory(kept, packed(solver)[0])

    def merit(z: Array) -> float:
        return float(merits(nlp, z[:, None])[0])

    count, first = len(drawn), max(int(STAGE_ONE * len(drawn)), 1)
    trials = ScatterSearch(nlp, drawn, merit, np.random.default_rng(seed))
    filters = Filters()
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
            filters.reached(nlp.scaling.to_solver(start), nlp.scaling.to_solver(judged.estimate))
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
class Region:
    """The region of a minimum: its center z (p,), radius, and the number of trial points refused in it."""

    center: Array
    radius: float
    refused: int = 0


@dataclass
class Filters:
    """Which trial points become starts."""

    threshold: float = np.inf
    refused: int = 0
    regions: list[Region] = field(default_factory=list)

    def let_pass(self, z: Array, value: float) -> bool:
        """Tell whether a trial point of this merit is far from the minima and good enough."""
        near = [r for r in self.regions if np.linalg.norm(z - r.center) < 0.75 * r.radius]
        for region in near:
            region.refused += 1
            if region.refused >= WAIT_CYCLE:  # the region is too large
                region.radius *= 1 - THRESHOLD_FACTOR
                region.refused = 0
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

    def reached(self, start: Array, end: Array) -> None:
        """Extend the region of a minimum that was reached from a start."""
        distance = float(np.linalg.norm(end - start))
        for region in self.regions:
            if np.linalg.norm(region.center - end) <= 1e-3 * (1 + np.linalg.norm(end)):
                region.radius = max(region.radius, distance)
                return
        self.regions.append(Region(end, distance))


class ScatterSearch:
    """Trial points: drawn ones, and combinations of a reference set."""

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
        """Yield trial points z (p,) and their merits, without end."""
        points = []
        for z in itertools.islice(self._drawn, self._diverse):
            points.append((self._merit(z), z))
            yield z, points[-1][0]
        self._references = _reference_set(points)
        while True:
            changed = False
            pairs = list(itertools.combinations([z for _, z in self._references], 2))
            for first, second in pairs:
                for z in self._combined(first, second):
                    value = self._merit(z)
                    changed |= self._improved(value, z)
                    yield z, value
            if not changed or not pairs:
                yield from self._renewed()

    def _combined(self, first: Array, second: Array) -> Iterator[Array]:
        """Yield a point beyond either of two points, and one between them."""
        half = (second - first) / 2
        for origin, sign in ((first, -1.0), (first, 1.0), (second, 1.0)):
            yield np.clip(origin + sign * self._random.random() * half, self._low, self._high)

    def _improved(self, value: float, z: Array) -> bool:
        """Replace the worst point of the reference set by a better one, unless the set contains it."""
        worst = max(range(len(self._references)), key=lambda k: self._references[k][0])
        is_member = any(np.allclose(z, point, rtol=0, atol=1e-6) for _, point in self._references)
        if is_member or not value < self._references[worst][0]:
            return False
        self._references[worst] = (value, z)
        return True

    def _renewed(self) -> Iterator[tuple[Array, float]]:
        """Yield new points, and keep the best ones and the most diverse of the new ones as references."""
        best = sorted(self._references, key=lambda pair: pair[0])[: REFERENCES // 2]
        points = list(itertools.islice(self._drawn, 2 * REFERENCES))
        if not points:  # all drawn points are used: points around the best one follow
            width = np.where(np.isfinite(self._high - self._low), self._high - self._low, 1.0)
            for _ in range(2 * REFERENCES):
                z = best[0][1] + 0.1 * width * self._random.normal(size=len(width))
                points.append(np.clip(z, self._low, self._high))
        renewed = []
        for z in points:
            renewed.append((self._merit(z), z))
            yield z, renewed[-1][0]
        self._references = _reference_set([*best, *renewed])


def _reference_set(points: list[tuple[float, Array]]) -> list[tuple[float, Array]]:
    """Return the best points, then one by one the point that is farthest from all chosen ones."""
    order = sorted(range(len(points)), key=lambda k: points[k][0])
    chosen, remaining = order[: REFERENCES // 2], order[REFERENCES // 2 :]
    while remaining and len(chosen) < REFERENCES:
        distances = [
            min(np.linalg.norm(points[k][1] - points[c][1]) for c in chosen) for k in remaining
        ]
        chosen.append(remaining.pop(int(np.argmax(distances))))
    return [points[k] for k in chosen]
