"""IPOPT, behind a comparison of the starts: each is evaluated once before the promising ones are run."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.compiled.response_part import SMOOTHING
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.local_solver import Screened

Array = NDArray[np.float64]

VIOLATION_WEIGHT = 1e3  # of what a constraint is missed by, beside the cost


class ScreenedIpopt(IpoptSolver):
    """IPOPT on one compiled problem that tells which of many starts are promising."""

    promising = (8, 4)

    def __reduce__(self) -> tuple[Callable[..., "ScreenedIpopt"], tuple[Any, ...]]:
        """Return what builds the same solver."""
        return type(self), (self._nlp, dict(self._options))

    def refined(self, nlp: Nlp) -> "ScreenedIpopt":
        """Return the solver of another problem with the same options."""
        return type(self)(nlp, self._options)

    def screened(self, starts: Array) -> Screened:
        """Compare the starts (r, p) by their merits."""
        found = merits(self._nlp, self._nlp.scaling.to_solver(starts).T)
        return Screened(np.argsort(found, kind="stable"), found, starts)


def merits(nlp: Nlp, z: Array) -> Array:
    """Return the smoothed costs at the columns of z (p, m), with what constraints are missed by: (m,)."""
    count = z.shape[1]
    program = (nlp.locating or nlp.program).map(count)
    costs, limits = (np.asarray(value) for value in program(z, np.full((1, count), SMOOTHING)))
    found = costs.ravel() + VIOLATION_WEIGHT * np.maximum(-limits, 0).sum(axis=0)
    return np.where(np.isfinite(found), found, np.inf)
