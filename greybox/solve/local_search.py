"""What a search on records tries besides its starts: the neighborhood of the best end."""

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.interruption import stop_requested
from greybox.solve.minima import same_cost
from greybox.solve.outcome import Outcome

Array = NDArray[np.float64]


def with_neighbors(
    nlp: Nlp, solver: GaussNewton, starts: Array, outcomes: list[Outcome]
) -> tuple[Array, list[Outcome]]:
    """Add runs from the neighborhood of the best end, as long as they find a lower cost."""
    converged = [outcome for outcome in outcomes if outcome.converged]
    while converged and not stop_requested():
        best = min(converged, key=lambda outcome: outcome.cost)
        points = _scaled(nlp, best.estimate)
        tried = [(point, _run(nlp, solver, point, best)) for point in points if not stop_requested()]
        better = [(p, o) for p, o in tried if o.converged and o.cost < best.cost - same_cost(nlp, best.cost)]
        if not better:
            break
        point, outcome = min(better, key=lambda pair: pair[1].cost)
        starts, outcomes, converged = np.vstack([starts, point]), [*outcomes, outcome], [outcome]
    return starts, outcomes


def _run(nlp: Nlp, solver: GaussNewton, point: Array, best: Outcome) -> Outcome:
    settings = nlp.strategies
    simulated = None
    if settings.simulated_neighbors and best.nodes is not None:
        simulated = solver.run_simulated(point, best.nodes, settings.neighbor_iterations)
    return simulated or solver.run(point, settings.neighbor_iterations)


def _scaled(nlp: Nlp, best: Array) -> list[Array]:
    """Return the point with every positive parameter made smaller and larger by the neighbor factor.

    Lags that swap places make minima whose neighborhoods take up shares of the start box that differ a hundredfold.
    """
    scale = nlp.strategies.neighbor_factor
    points = []
    for k in np.flatnonzero(nlp.lower > 0):
        for factor in (1 / scale, scale):
            point = best.copy()
            point[k] = np.clip(factor * point[k], nlp.lower[k], nlp.upper[k])
            points.append(point)
    return points
