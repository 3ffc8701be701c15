"""Replicates of a problem: data that are drawn anew, and the runner that refits them.

Seed and number of a replicate determine its random numbers. A run is this number, so that the
result does not depend on how many workers there are.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.frozen_values import frozen
from greybox.engine.compiled.compiled_problem import CompiledProblem
from greybox.engine.solve.local_solver import Runner
from greybox.engine.solve.runs import Outcome


@frozen
class Draws:
    """How the data of replicates are drawn.

    Attributes
    ----------
    seed : int
    parts : tuple of DrawnResponse or of DrawnRecord
    constants : (c,) array
        Constants of the problem.
    root : (c, r) array
        A square root of their covariance.
    about : str
        Description of the draws.
    """

    seed: int
    parts: tuple[Any, ...]
    constants: Array
    root: Array
    about: str

    def of(self, number: int) -> tuple[Array, Iterator[Any]]:
        """Return the constants (c,) of a replicate, and yield the data of its parts."""
        random = np.random.default_rng([self.seed, number])
        constants = self.constants + self.root @ random.standard_normal(self.root.shape[1])
        return constants, (part.drawn(random) for part in self.parts)


@frozen
class Replicates(Runner):
    """The runner that refits replicates of a compiled problem.

    Attributes
    ----------
    nlp : CompiledProblem
    draws : Draws
    start : (p,) array
        The estimate, from which every replicate is solved.
    """

    nlp: CompiledProblem
    draws: Draws
    start: Array

    def without_end(self, start: Array, status: str) -> Outcome:
        """Return the outcome of a refit that ended nowhere: it has no estimate (p,)."""
        return replace(
            super().without_end(start, status), estimate=np.full(len(self.start), np.nan)
        )
