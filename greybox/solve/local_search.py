"""What a search on records tries besides its starts: a simulation of the first, and the best end's neighborhood."""

import numpy as np
from numpy.typing import NDArray

from greybox.compiled.compiled_problem import Nlp
from greybox.solve.gauss_newton.driver import GaussNewton
from greybox.solve.minima import same_cost
from greybox.solve.outcome import Outcome

Array = NDArray[np.float64]

# How far along a flat direction a run begins, as shares of the change by the neighbor factor: both ends and both
# halves, since a limit of the model may be reached on the way.
SHARES = (-1.0, -0.5, 0.5, 1.0)


def with_simulated_start(
    nlp: Nlp, solver: GaussNewton, starts: Array, outcomes: list[Outcome]
) -> tuple[Array, list[Outcome]]:
    """Add the run that begins with a simulation of the first start, where its cost is lower than all others."""
    outcome = solver.run_simulated(starts[0])
    best = min((other.cost for other in outcomes if other.converged), default=np.inf)
    if outcome is None or not outcome.converged or outcome.cost >= best - same_cost(nlp, outcome.cost):
        return starts, outcomes
    return np.vstack([starts, starts[0]]), [*outcomes, outcome]


def with_neighbors(
    nlp: Nlp, solver: GaussNewton, starts: Array, outcomes: list[Outcome]
) -> tuple[Array, list[Outcome]]:
    """Add runs from the neighborhood of the best end, as long as they find a lower cost."""
    settings = nlp.strategies
    converged = [outcome for outcome in outcomes if outcome.converged]
    while converged:
        best = min(converged, key=lambda outcome: outcome.cost)
        points = _scaled(nlp, best.estimate) if settings.scaled_neighbors else []
        points += _along_flat_directions(nlp, solver, best) if settings.flat_directions else []
        tried = [(point, _run(nlp, solver, point, best)) for point in points]
        better = [(p, o) for p, o in tried if o.converged and o.cost < best.cost - same_cost(nlp, best.cost)]
        if not better:
            break
        point, outcome = min(better, key=lambda pair: pair[1].cost)
        starts, outcomes, converged = np.vstack([starts, point]), [*outcomes, outcome], [outcome]
    return starts, outcomes


def _run(nlp: Nlp, solver: GaussNewton, point: Array, best: Outcome) -> Outcome:
    settings = nlp.strategies
    simulated = None
    if settings.simulated_neighbors:
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


def _along_flat_directions(nlp: Nlp, solver: GaussNewton, best: Outcome) -> list[Array]:
    """Return points far along what the data do not determine: a limit of the model may be reached there."""
    if best.nodes is None:
        return []
    settings = nlp.strategies
    z = nlp.scaling.to_solver(best.estimate)
    directions = solver.flat_directions(best.estimate, best.nodes, settings.neighbor_factor)[: settings.flat_count]
    points = [nlp.scaling.to_parameters(z + share * v) for v in directions for share in SHARES]
    return [np.clip(point, nlp.lower, nlp.upper) for point in points]
