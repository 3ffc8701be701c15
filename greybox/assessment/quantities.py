"""The quantities of an answer: parameters, ties and derived quantities, with their errors."""

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from greybox.assessment.result import Quantity
from greybox.data.files.arrays import Array
from greybox.data.files.named_values import attributes
from greybox.engine.compiled.compiled_problem import AnyProblem, CompiledProblem
from greybox.engine.covariance.accuracy import Accuracy, degrees, propagate
from greybox.modeling.formulation.problem import Problem
from greybox.modeling.one_thread import one_thread_at_a_time
from greybox.modeling.symbolic_reading import entries_by_name


class Formula(NamedTuple):
    """A quantity that follows from the parameters of a part; `function` takes these by name."""

    name: str
    kind: Literal["tied", "derived"]
    unit: str
    about: str
    part: Problem
    function: Callable[[Any], Any]


@one_thread_at_a_time
def quantities(accuracy: Accuracy) -> tuple[tuple[Quantity, ...], Array, Array]:
    """Return all quantities, then the covariance and slopes (m, k) of the parameters.

    Parameters are free, fixed or tied; slopes are derivatives with respect to all values (k,). The
    errors of tied and derived quantities are of first order. NaN where the data do not determine a
    quantity.
    """
    nlp = accuracy.nlp
    x = nlp.all_values(accuracy.x)
    derived = formulas(nlp.problem)
    # Exact derivatives: finite differences would limit the errors of ratios of close values.
    function = quantity_function(nlp, [*nlp.names, *(formula.name for formula in derived)])
    values = function(x).full().ravel()
    nominal_output = 0  # CasADi's Jacobian takes the output, too, but does not use it
    slopes = function.jacobian()(x, nominal_output).full()

    # Errors are propagated once for all quantities.
    errors = propagate(accuracy, slopes)
    dof = degrees(accuracy, slopes)
    bias = slopes @ accuracy.bias
    systematic = np.linalg.norm(slopes @ accuracy.systematic, axis=1)

    # Free parameters come first: `Fit.free` and all matrices of a fit rely on this order.
    declarations = [_declaration(accuracy, name) for name in nlp.names]
    declarations += [_declaration_of_formula(accuracy, formula) for formula in derived]
    result = []
    for k, declaration in enumerate(declarations):
        quantity = Quantity(
            value=float(values[k]),
            standard_error=float(errors[k]),
            dof=float(dof[k]),
            bias=float(bias[k]),
            systematic=float(systematic[k]),
            **declaration,
        )
        result.append(quantity)

    parameter_slopes = slopes[[quantity.kind != "derived" for quantity in result]]
    covariance = parameter_slopes @ accuracy.covariance @ parameter_slopes.T
    # The covariance within the determined directions is finite, and too small, for the others.
    unknown = np.isnan(errors[: len(covariance)])
    covariance[unknown | unknown[:, None]] = np.nan
    return tuple(result), covariance, parameter_slopes


def _declaration(accuracy: Accuracy, name: str) -> dict[str, Any]:
    """Return the fields of the `Quantity` of a free or fixed parameter that need no numbers."""
    parameter = accuracy.nlp.problem.parameters[name]
    fields = attributes(parameter, "unit", "about", "bounds", "box", "has_computed_bounds")
    fields["name"] = name
    fields["kind"] = "fixed" if parameter.fixed else "free"
    fields["at_bound"] = name in accuracy.at_bound
    return fields


def _declaration_of_formula(accuracy: Accuracy, formula: Formula) -> dict[str, Any]:
    """Return the fields of the `Quantity` of a formula that need no numbers."""
    fields = attributes(formula, "name", "kind", "unit", "about")
    # Active limits are labels. That of a tied parameter is "the lower bound 0 of the tied a2".
    bound = f"of the tied {formula.name}"
    fields["at_bound"] = any(label.endswith(bound) for label in accuracy.active)
    return fields


def parameter_values(nlp: CompiledProblem, x: Array) -> dict[str, float]:
    """Return free, fixed and tied parameters by name, where the free ones are `x` (p,)."""
    tied = [formula.name for formula in formulas(nlp.problem) if formula.kind == "tied"]
    names = [*nlp.names, *tied]
    values = quantity_function(nlp, names)(nlp.all_values(x)).full()
    return dict(zip(names, values.ravel().tolist(), strict=True))


@one_thread_at_a_time
def quantity_function(nlp: CompiledProblem, names: Sequence[str]) -> ca.Function:
    """Return the named parameters and formulas as a function of all values (k,)."""
    x = ca.SX.sym("x", len(nlp.names))
    parameters = entries_by_name(nlp.names, x)
    expressions = dict(parameters)
    for formula in formulas(nlp.problem):
        values_of_part = formula.part.local_values(parameters)
        expressions[formula.name] = ca.SX(formula.function(values_of_part))
    stacked = ca.vertcat(*(expressions[name] for name in names))
    return ca.Function("quantities", [x], [ca.densify(stacked)])


def formulas(problem: AnyProblem) -> list[Formula]:
    """Return the tied parameters of a problem, then its derived quantities.

    The name of a derived quantity includes that of its part where the part renames or ties.
    """
    formulas_by_name: dict[str, Formula] = {}
    for part in problem.parts:
        for name in part.tied:
            declared = part.model.parameters[name]
            label = part.outside(name)
            # The values of a part include its tied parameters.
            function = itemgetter(name)
            formula = Formula(label, "tied", declared.unit, declared.about, part, function)
            formulas_by_name.setdefault(label, formula)

    used_names = {*problem.parameters, *formulas_by_name}
    for part in problem.parts:
        differs = bool(part.rename or part.tied) and len(problem.parts) > 1
        for name, function in part.model.derived.items():
            # Parts that name or tie parameters alike have the same derived quantity: it is one
            # line.
            label = f"{name} ({part.name})" if differs or name in used_names else name
            formulas_by_name.setdefault(label, Formula(label, "derived", "", "", part, function))

    return list(formulas_by_name.values())
