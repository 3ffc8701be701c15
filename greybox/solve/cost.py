"""The cost of a problem at given parameters."""

import numpy as np

from greybox.compiled.compiled_problem import AnyProblem, compile_problem
from greybox.compiled.transcription.method import Transcription
from greybox.files.named_values import Values
from greybox.modeling.model import require_known
from greybox.solve.gauss_newton.driver import GaussNewton


def cost(problem: AnyProblem, values: Values, method: Transcription | None = None) -> float:
    """Return the cost of a problem at parameter `values` by name.

    Other parameters are at their start or fixed value.

    The states of records are those of the smallest cost; NaN where there are none, for example if
    the model diverges.

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
    nlp = compile_problem(problem, method)
    require_known(values, nlp.names, "parameter", repr(problem.name))
    point = np.array([values.get(name, problem.parameters[name].start) for name in nlp.names])
    return (GaussNewton(nlp) if nlp.has_states else nlp).cost(point)
