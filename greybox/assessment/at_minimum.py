"""The second of the three steps of a fit: the estimate at the best minimum, with its errors."""

import math
import platform
from dataclasses import replace

import casadi as ca
import numpy as np

from greybox.assessment.checks.evidence import Evidence
from greybox.assessment.fitted_values import fitted_part
from greybox.assessment.quantities import parameter_values, quantities
from greybox.assessment.result import Fit
from greybox.data.files.arrays import Array
from greybox.data.files.version import __version__
from greybox.engine.covariance.accuracy import Accuracy
from greybox.engine.covariance.covariance import accuracy_at, directions_beside, known_directions
from greybox.engine.covariance.known_directions import KnownDirections
from greybox.engine.covariance.prior_shares import prior_shares
from greybox.engine.solve.minima import agreeing_runs, best_unfinished
from greybox.engine.solve.search import Search
from greybox.modeling.formulation.prior_part import stated_priors
from greybox.modeling.one_thread import one_thread_at_a_time


@one_thread_at_a_time
def estimate_at_minimum(search: Search) -> Evidence:
    """Return the estimate at the best minimum, its covariance, and all values that follow.

    The values of a failed search are NaN: the end of a run that did not converge is no estimate.
    """
    nlp, found = search.nlp, search.found
    accuracy = Accuracy.unknown(nlp)
    if found.minima:
        best = found.minima[0].estimate
        trajectories = search.solver.profile(best, found.nodes).trajectories
        accuracy = accuracy_at(nlp, best, trajectories)

    values = nlp.all_values(accuracy.x)
    estimate = dict(zip(nlp.names, values.tolist(), strict=True))
    lines, covariance, slopes = quantities(accuracy)
    # Values, not the compiled parts: a fit must be small, and readable without its model.
    parts = tuple(
        fitted_part(part, trajectory, values, dict(part.problem.local_values(estimate)))
        for part, trajectory in zip(nlp.parts, accuracy.trajectories, strict=True)
    )
    at = np.array([line.value for line in lines[: len(slopes)]])
    unfinished = None if found.minima else best_unfinished(found.runs)

    fit = Fit(
        name=nlp.problem.name,
        parts=parts,
        quantities=lines,
        covariance=covariance,
        dof=accuracy.dof,
        cost=found.minima[0].cost if found.minima else math.nan,
        runs=found.runs,
        minima=found.minima,
        agreeing=len(agreeing_runs(nlp, found.runs, found.minima)),
        warnings=(),
        seed=search.seed,
        starts=search.starts,
        seconds=0.0,
        versions={
            "greybox": __version__,
            "casadi": ca.CasadiMeta.version(),
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        models=tuple(part.model for part in nlp.problem.parts),
        white=accuracy.white,
        independent=accuracy.independent,
        directions=_directions(search, accuracy, at, slopes),
        priors={n: pair for p in stated_priors(nlp.problem) for n, pair in p.stated.items()},
        prior_share=prior_shares(accuracy),
        best_effort=unfinished and parameter_values(nlp, unfinished.estimate),
    )
    return Evidence(search, accuracy, fit)


def _directions(
    search: Search, accuracy: Accuracy, at: Array, slopes: Array
) -> KnownDirections | None:
    """Return the directions that the data determine, at values `at` (k,), and the others."""
    directions = known_directions(accuracy, at, slopes)
    if directions is None or not directions.unseen.any():
        return directions

    # Where two values are equal, the data seem to determine their sum and their product alike. A
    # second point shows which combination is determined everywhere.
    elsewhere = directions_beside(
        search.nlp,
        accuracy.x,
        accuracy.at_bound,
        lambda x: search.solver.profile(x, search.found.nodes).trajectories,
    )
    return replace(directions, elsewhere=elsewhere)
