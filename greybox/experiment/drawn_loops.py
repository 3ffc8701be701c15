"""Loops of a fitted plant: at its estimate, and at draws from the distribution of its parameters.

Begin with `drawn_loops`.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from greybox.estimate.fitted_part import FittedResponse
from greybox.estimate.result import Fit
from greybox.experiment.controller import Controller
from greybox.experiment.sampled_loop import SampledLoop, sampled_loop
from greybox.files.arrays import Array
from greybox.modeling.model import Model

DRAWS = 512  # a quantile of 2.5 % is then known to 4 % of a standard error
DRAWN = slice(1, 1 + DRAWS)  # the plants of a loop that are draws
BESIDE = slice(1 + DRAWS, None)  # those that differ in what the data do not determine


def drawn_loops(
    plant: Fit | Model,
    controller: Controller | Sequence[Controller],
    values: Mapping[str, float] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    part: int = 0,
) -> SampledLoop:
    """Return the loop of the estimate, of draws from its distribution, and of plants beside it.

    The last ones lie beside the estimate in directions of which the data say nothing. A model has
    one loop.

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is neither, and for values beside a fit.
    """
    if not isinstance(plant, (Fit, Model)):
        raise TypeError(f"{plant!r:.60} has no loop: give a Fit, or a model with its values.")
    if isinstance(plant, Model):
        row = np.array([list(plant.values(values).values())], dtype=float)
        return sampled_loop(plant, row, controller, at=at)
    if values is not None:
        raise TypeError("values were given beside a Fit, which has its own: leave them out.")
    if not plant.converged:
        raise ValueError(f"the fit {plant.name!r} has no estimate: {plant.status}.")

    model, fitted = plant.model_of(part), plant.parts[part]
    is_response = isinstance(fitted, FittedResponse)
    return sampled_loop(
        model,
        _draws(plant, [fitted.rename.get(name, name) for name in model.parameters]),
        controller,
        at=fitted.at if is_response and not at else at,
        delay_has="hold" if is_response else "nothing",
    )


def _draws(fit: Fit, names: Sequence[str]) -> Array:
    """Return values (plants, parameters): the estimate, draws from its distribution, others.

    The others lie beside the estimate in directions of which the data say nothing.
    """
    from scipy.special import chdtri, ndtri  # noqa: PLC0415  (takes a tenth of a second to import)
    from scipy.stats import qmc  # noqa: PLC0415  (takes a third of a second to import)

    known = fit.known_directions(names)
    lines = fit.by_name
    center = np.array([lines[name].value for name in names])
    variances, axes = np.linalg.eigh(known.covariance)
    root = axes * np.sqrt(np.maximum(variances, 0))
    dof = fit.fewest_degrees(names)

    shares = qmc.Sobol(len(names) + 1, rng=np.random.default_rng(0)).random(DRAWS)
    shares = np.clip(shares, 1e-9, 1 - 1e-9)
    normal = ndtri(shares[:, :-1]) @ root.T
    widening = np.sqrt(dof / chdtri(dof, shares[:, -1])) if math.isfinite(dof) else np.ones(DRAWS)
    bias = np.array([lines[name].bias for name in names])
    drawn = center - bias + normal * widening[:, None]
    beside = center + 0.1 * (known.size[:, None] * known.unseen).T

    limits = np.array([lines[name].bounds for name in names]).T
    return np.clip(np.vstack([center, drawn, beside]), *limits)
