"""Loops of a fitted plant: at its estimate, and at draws from the distribution of its parameters.

Begin with `drawn_loops`.
"""

import numpy as np

from greybox.assessment.draws import drawn_values
from greybox.assessment.fitted_part import FittedResponse
from greybox.assessment.result import Fit
from greybox.data.files.named_values import Values, places_of
from greybox.modeling.model import Model
from greybox.modeling.parameter import lower_and_upper
from greybox.workflows.experiment.controller import Controllers
from greybox.workflows.experiment.sampled_loop import SampledLoop, sampled_loop

DRAWS = 512  # a quantile of 2.5 % is then known to 4 % of a standard error
DRAWN = slice(1, 1 + DRAWS)  # the plants of a loop that are draws
BESIDE = slice(DRAWN.stop, None)  # those that differ in what the data do not determine


def drawn_loops(
    plant: Fit | Model,
    controller: Controllers,
    values: Values | None = None,
    *,
    at: Values | None,
    part: int,
) -> SampledLoop:
    """Return the loops of the estimate, of draws from its distribution, and of plants near it.

    The last ones differ from the estimate in directions on which the data contain no information. A
    model has one loop.

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is neither, and for values given with a fit.
    """
    if not isinstance(plant, Fit | Model):
        raise TypeError(
            f"a {type(plant).__name__} has no loop here: give a Fit, a model with its values, or "
            "the FrequencyResponse of a broken loop; gb.interop.from_control(...) makes models and "
            "responses of objects of python-control."
        )
    if isinstance(plant, Model):
        return sampled_loop(plant, np.array([[*plant.values(values).values()]]), controller, at=at)
    if values is not None:
        raise TypeError("values were given with a Fit, which has its own: leave them out.")
    plant.require_estimate()

    model, fitted = plant.model_of(part), plant.parts[part]
    names = [*map(fitted.outside, model.parameters)]
    known = plant.known_directions(plant.names)
    limits = lower_and_upper(plant.by_name[name] for name in plant.names)
    beside = np.clip(known.at + 0.1 * (known.size[:, None] * known.unseen).T, *limits)
    plants = np.vstack([known.at, drawn_values(plant, DRAWS, names), beside])
    has_hold = isinstance(fitted, FittedResponse) and not fitted.data.divided_hold
    return sampled_loop(
        model,
        plants[:, places_of(names, plant.names)],
        controller,
        at=at or fitted.at,
        has_hold=has_hold,
    )
