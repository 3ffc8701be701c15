"""Where to look for other minima than the one that all runs reach.

Two poles that swap have other values with the same response, and few random starts lead there. Each
parameter is held at some values while the others move, and then released: this crosses the ridge
between two minima. It is done for many points at once, which needs the cost of responses.
"""

from typing import Any

import numpy as np

from greybox.compiled.compiled_problem import CompiledProblem
from greybox.files.arrays import Array
from greybox.solve.batched_newton import BatchedNewton
from greybox.solve.minima import RIVAL, distinct_ends, likelihood_unit
from greybox.solve.response_solver import ResponseSolver

SHARES = np.array([0.125, 0.375, 0.625, 0.875])  # of a start box, where a parameter is held


def points_beside(nlp: CompiledProblem, x: Array) -> Array:
    """Return up to two points (m, p) that fit nearly as well as the minimum x (p,), or better."""
    if not ResponseSolver.serves(nlp):
        return x[None][:0]

    p = len(x)
    boxes = [nlp.problem.parameters[name].in_box(SHARES) for name in nlp.free]
    held = np.tile(np.eye(p, dtype=bool), len(SHARES))
    z = nlp.scaling.to_solver(np.where(held, np.repeat(boxes, p, 1), x[:, None]).T).T
    low, high = (np.where(held, z, bound[:, None]) for bound in nlp.bounds)
    search = BatchedNewton.of(nlp, nlp.programs[-1])
    # Approximate ends suffice, since runs begin there: kinks of the cost are rounded off.
    limits: Any = {"max_iterations": 50, "tolerance": 1e-8, "from_near": True, "smoothing": 1e-2}
    z = search.minimize(z, bounds=(low, high), **limits).z
    z = search.minimize(z, **limits).z

    ends = np.vstack([x, nlp.estimate_at(z.T)])
    costs = nlp.costs(ends)
    ends = ends[costs <= costs[0] + RIVAL * likelihood_unit(nlp, costs[0])]
    return ends[[group[0] for group in distinct_ends(nlp, ends)[1:3]]]
