"""What a search on records tries beside its starts: a simulation of the first, and the neighborhood of the best end."""

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.ipopt import Outcome
from greybox.solve.minima import same_cost

Array = NDArray[np.float64]
HOP = 4.0  # a parameter is made so many times larger or smaller
FLAT, SLIDES = 3, (-1.0, -0.5, 0.5, 1.0)  # directions that the data do not determine, and how far along them
ITERATIONS = 40


def simulated_first(
    nlp: Nlp, solver: GaussNewton, starts: Array, outcomes: list[Outcome]
) -> tuple[Array, list[Outcome]]:
    """Add the run that begins with a simulation of the first start, where it ends better than all others."""
    outcome = solver.run_simulated(starts[0])
    best = min((other.cost for other in outcomes if other.converged), default=np.inf)
    if outcome is None or not outcome.converged or outcome.cost >= best - same_cost(nlp, outcome.cost):
        return starts, outcomes
    return np.vstack([starts, starts[0]]), [*outcomes, outcome]


def hopped(nlp: Nlp, solver: GaussNewton, starts: Array, outcomes: list[Outcome]) -> tuple[Array, list[Outcome]]:
    """Add runs from the neighborhood of the best end, as long as they end better."""
    ended = [outcome for outcome in outcomes if outcome.converged]
    while ended:
        best = min(ended, key=lambda outcome: outcome.cost)
        points = [*_scaled(nlp, best.estimate), *_slid(nlp, solver, best)]
        tried = [(point, _run(solver, point, best)) for point in points]
        better = [(p, o) for p, o in tried if o.converged and o.cost < best.cost - same_cost(nlp, best.cost)]
        if not better:
            break
        point, outcome = min(better, key=lambda pair: pair[1].cost)
        starts, outcomes, ended = np.vstack([starts, point]), [*outcomes, outcome], [outcome]
    return starts, outcomes


def _run(solver: GaussNewton, point: Array, best: Outcome) -> Outcome:
    return solver.run_simulated(point, best.nodes, ITERATIONS) or solver.run(point, ITERATIONS)


def _scaled(nlp: Nlp, best: Array) -> list[Array]:
    """Return the point with every positive parameter HOP times smaller and larger.

    Lags that swap places make minima whose neighborhoods take up shares of the start box that differ a hundredfold.
    """
    points = []
    for k in np.flatnonzero(nlp.lower > 0):
        for factor in (1 / HOP, HOP):
            point = best.copy()
            point[k] = np.clip(factor * point[k], nlp.lower[k], nlp.upper[k])
            points.append(point)
    return points


def _slid(nlp: Nlp, solver: GaussNewton, best: Outcome) -> list[Array]:
    """Return points far along what the data do not determine: a limit of the model may be reached there."""
    if best.nodes is None:
        return []
    z = nlp.scaling.to_solver(best.estimate)
    slides = [share * v for v in solver.flat(best.estimate, best.nodes, HOP)[:FLAT] for share in SLIDES]
    return [np.clip(nlp.scaling.to_parameters(z + slide), nlp.lower, nlp.upper) for slide in slides]
