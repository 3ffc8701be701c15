"""Loops of a fitted plant at its estimate, and at draws from the distribution of its parameters.

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

DRAWS = 512  # the quantile of 2.5 % then has an error of 4 % of a standard error
# The plants of a loop are the estimate, draws, and plants beside it, which differ from the estimate
# in directions that the data do not determine.
DRAWN = slice(1, 1 + DRAWS)
BESIDE = slice(DRAWN.stop, None)


def drawn_loops(
    plant: Fit | Model,
    controller: Controllers,
    values: Values | None = None,
    *,
    at: Values | None,
    part: int,
) -> SampledLoop:
    """Return the loops of the estimate, of draws from its distribution, and of plants beside it.

    The last ones differ from the estimate in directions on which the data contain no information. A
    model with given values has only one loop. `part` is the number of the part of the fit to which
    the plant belongs.

    Raises
    ------
    ValueError
        If the fit has no estimate or no covariance, or the controllers do not fit the model.
    TypeError
        For a plant that is neither a fit nor a model, and if values are given with a fit.
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

    model = plant.model_of(part)
    fitted = plant.parts[part]
    names = [*map(fitted.outside, model.parameters)]
    known = plant.known_directions(plant.names)
    lower, upper = lower_and_upper(plant.by_name[name] for name in plant.names)
    # A tenth of the size of each parameter along every undetermined direction.
    steps = 0.1 * (known.size[:, None] * known.unseen).T
    beside = np.clip(known.at + steps, lower, upper)
    plants = np.vstack([known.at, drawn_values(plant, DRAWS, names), beside])
    has_hold = isinstance(fitted, FittedResponse) and not fitted.data.divided_hold
    return sampled_loop(
        model,
        plants[:, places_of(names, plant.names)],
        controller,
        at=at or fitted.at,
        has_hold=has_hold,
    )
