"""The cost of a problem at given parameters."""

import math

import numpy as np

from greybox.data.files.arrays import Array
from greybox.data.files.named_values import Values
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem, compile_problem
from greybox.engine.compiled.transcription.method import Transcription
from greybox.engine.solve.gauss_newton.driver import GaussNewton
from greybox.modeling.model import require_known
from greybox.modeling.step_size import MOST_SUBSTEPS

# Change of a cost by twice the steps that is no reason for more of them, and the same relative to
# the cost. A tenth of a standard error changes a likelihood by .005.
NEGLIGIBLE = 1e-3
RELATIVE = 1e-7


def cost(problem: AnyProblem, values: Values, method: Transcription | None = None) -> float:
    """Return the cost of a problem at parameter `values` by name.

    Other parameters are at their start or fixed value.

    The states of records are those of the smallest cost; NaN where there are none, for example if
    the model diverges. Their steps of integration are halved until the cost no longer changes,
    unless the `method` states a number of steps.

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
    return _cost_of_states(nlp, point) if nlp.has_states else nlp.cost(point)


def _cost_of_states(nlp: CompiledProblem, point: Array) -> float:
    """Return the cost at all values (k,), with so many steps that more of them change nothing."""
    found = GaussNewton(nlp).cost(point)
    if not nlp.substeps or nlp.method.scheme.substeps is not None:
        return found

    while nlp.substeps < MOST_SUBSTEPS:
        nlp = nlp.refined(2)
        finer = GaussNewton(nlp).cost(point)
        is_same = abs(finer - found) <= NEGLIGIBLE + RELATIVE * abs(finer)
        if is_same or (math.isnan(finer) and math.isnan(found)):
            # The first of two equal ones: it is that of a fit with the usual steps.
            return found
        found = finer
    return found
