"""IPOPT, behind a comparison of the starts: each is evaluated once before the promising ones are run."""

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.compiled.response_part import SMOOTHING
from greybox.files.arrays import Array
from greybox.solve.ipopt import IpoptSolver
from greybox.solve.local_solver import Screened

VIOLATION_WEIGHT = 1e3  # of what a constraint is missed by, beside the cost


class ScreenedIpopt(IpoptSolver):
    """IPOPT on one compiled problem that tells which of many starts are promising."""

    promising = (8, 4)

    def screened(self, starts: Array) -> Screened:
        """Compare the starts (r, p) by their merits."""
        found = merits(self._nlp, self._nlp.scaling.to_solver(starts).T)
        return Screened(np.argsort(found, kind="stable"), found, starts)


def merits(nlp: CompiledProblem, z: Array) -> Array:
    """Return the smoothed costs at the columns of z (p, m), with what constraints are missed by: (m,)."""
    costs, limits = (value.full() for value in (nlp.locating or nlp.program)(z, SMOOTHING))
    found = costs.ravel() + VIOLATION_WEIGHT * np.maximum(-limits, 0).sum(axis=0)
    return np.where(np.isfinite(found), found, np.inf)
