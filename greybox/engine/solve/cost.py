"""The cost of a problem at given parameters."""

import math

from greybox.data.files.named_values import Values
from greybox.data.files.public import public
from greybox.engine.compiled.compiled_problem import AnyProblem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.objective import objective


@public
def cost(problem: AnyProblem, values: Values, method: Transcription | None = None) -> float:
    """Return the cost of a problem at parameter `values` by name.

    Other parameters are at their start or fixed value.

    The states of records are those of the smallest cost; NaN where there are none, for example if
    the model diverges. Their steps of integration are halved until the cost no longer changes,
    unless the `method` states a number of steps. A criterion that bounds large errors bounds those
    at these values.

    Raises
    ------
    ValueError
        For a name that is not a parameter of the problem, or another value of a fixed one where
        data are records.

    Examples
    --------
    >>> from greybox.problems import pitch_hover
    >>> round(gb.cost(pitch_hover.problem(), pitch_hover.published["values"]), 4)
    0.5866
    """
    value = objective(problem, values, method=method).value(values)
    return math.nan if math.isinf(value) else value
