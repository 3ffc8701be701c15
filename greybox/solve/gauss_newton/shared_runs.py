"""Runs from many starts on long records: on excerpts first, and from there once for all that meet.

Nearly all runs end at a few points. Their last iterations on the whole record are alike, and the
most expensive part. A run is therefore brought to a minimum of excerpts first, a quarter of the
samples and less. Its end is rounded to a small share of a standard error, so that all runs that end
at this minimum continue from the same digits, and once. The result depends only on the start: it is
the same, bit for bit, whichever run comes first and wherever it is made.

A run that does not converge this way is made as if it were alone. So is the run from the first
start of every search, so that not everything depends on the excerpts.

20 starts on 6000 samples take a third of their time. Of 180 runs on 15 problems, most of them far
below `Strategies.short_record`, 124 end at the best minimum with it and 106 without
(`benchmarks/shared_runs.py`).
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.files.arrays import Array
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.local_solver import Runner
from greybox.solve.runs import CUT_SHORT, Outcome

# Samples of a record over those of its excerpts. An iteration on a quarter takes about 0.4 of the
# time.
FACTOR = 4
FEWER = 2  # times as many samples, at least, for excerpts to be worth a run

MOST_STORED = 64  # ends of runs on the whole record that are stored with all their states


class SharedRuns(Runner):
    """Runs on the records of one problem; those that meet on excerpts continue as one.

    Attributes
    ----------
    levels : list of GaussNewton
        Solvers on the whole records, then on excerpts from the longest to the shortest.
    """

    def __init__(self, solver: GaussNewton) -> None:
        """Build the solvers of excerpts; `solver` is that of the whole records."""
        self._alone = solver
        self.levels = [solver]
        samples, settings = solver.samples, solver.settings
        while samples > settings.short_record:
            samples = min(samples // FACTOR, settings.long_record // 2)
            excerpts = solver.on_excerpts(samples)
            # Some segments of each of many records remain, which may be nearly all of them.
            if FEWER * excerpts.samples <= self.levels[-1].samples:
                self.levels.append(excerpts)
        self._ends: list[dict[bytes, tuple[Outcome, Array | None]]] = [{} for _ in self.levels]

    def __reduce__(self) -> tuple[Callable[..., "SharedRuns"], tuple[Any, ...]]:
        """Return a recipe for the same object."""
        return SharedRuns, (self._alone,)

    @classmethod
    def of(cls, solver: GaussNewton) -> "SharedRuns | None":
        """Return the runs of a solver; None for short records, and for predictors.

        Excerpts are too short to judge the poles of a predictor.
        """
        if any(part.gains for part in solver.nlp.parts):
            return None
        shared = cls(solver)
        return shared if len(shared.levels) > 1 else None

    def run(self, start: Array) -> Outcome:
        """Solve from the parameters `start` (p,)."""
        began = time.perf_counter()
        z = self._alone.limits.nearest(self._alone.nlp.scaling.to_solver(start))
        outcome, _ = self._end(0, z)
        if not outcome.converged and outcome.status not in CUT_SHORT:
            alone = self._alone.run(start)
            outcome = replace(alone, iterations=outcome.iterations + alone.iterations)
        return replace(outcome, seconds=time.perf_counter() - began)

    def _end(self, level: int, z: Array) -> tuple[Outcome, Array | None]:
        """Return where a run from z (p,) ends on a level, by way of the shorter excerpts."""
        if level == len(self.levels) - 1:
            return self.levels[level].run_from(z)
        first, hessian = self._end(level + 1, z)
        if not first.converged:  # its cost is that of the excerpts
            return replace(first, cost=math.inf, signature=None, nodes=None), None
        z = rounded(self._alone.nlp.scaling.to_solver(first.estimate), hessian)
        outcome, hessian = self._once(level, self._alone.limits.nearest(z))
        return replace(outcome, iterations=first.iterations + outcome.iterations), hessian

    def _once(self, level: int, z: Array) -> tuple[Outcome, Array | None]:
        """Return where a run from z (p,) ends on a level; equal runs are made once."""
        ends, key = self._ends[level], z.tobytes()
        if key in ends:
            return ends[key]
        end = self.levels[level].run_from(z, near_solution=True)
        if end[0].converged:
            # Many ends mean that runs do not meet: dropping all of them costs little.
            if len(ends) >= MOST_STORED:
                ends.clear()
            ends[key] = end
        return end


def rounded(z: Array, hessian: Array | None) -> Array:
    """Return z (p,), the end of a run, rounded to digits that all runs to one minimum share.

    These are a tenth of a standard error with all other parameters held: runs end some 1e-4 of one
    apart, and a grid a thousand times as wide hardly ever comes between them. The minimum of the
    whole record is whole standard errors away. A parameter that the data hardly show stays where it
    is, to a thousandth.
    """
    if hessian is None:
        return z
    with np.errstate(divide="ignore"):
        width = np.fmin(0.1 / np.sqrt(np.maximum(np.diag(hessian), 0.0)), 1e-3)
    # A power of two is the same for standard errors that are nearly the same.
    grid = 2.0 ** np.floor(np.log2(width))
    return np.round(z / grid) * grid + 0.0  # never -0.0
